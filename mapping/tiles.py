"""World-fixed tile store: a map of a building costs memory only where it was seen.

Cell (i, j) is centred on `(j * resolution, i * resolution)` in the `map` frame: row i grows with y, column j with x.
A tile holds `size` x `size` cells; all tiles live in one growing pool of flat arrays, so kernels address any cell with
one integer. A small dense directory maps tile coordinates to pool slots.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

UNKNOWN, CONTACT, LIDAR, BRIDGED = 0, 1, 2, 3
"""Where a height comes from. `BRIDGED` exists in read-outs only, never in the store."""

LAYERS: dict[str, tuple[type, float]] = {
    "height": (np.float32, np.nan),
    "variance": (np.float32, np.nan),
    "count": (np.uint16, 0),
    "seen": (np.int32, 0),
    "source": (np.uint8, UNKNOWN),
    "alt": (np.float32, np.nan),
    "streak": (np.uint8, 0),
    "below": (np.float32, np.nan),
    "upper": (np.float32, np.inf),
    "passes": (np.uint8, 0),
    "sent_height": (np.float32, np.nan),
    "sent_source": (np.uint8, UNKNOWN),
    "sent_upper": (np.float32, np.nan),
    "mark": (np.int32, 0),
}
"""Name -> dtype, value in a fresh cell. height [m] and variance [m^2] of the surface; count of points that agreed;
seen [ms since the map's first scan] last agreement; alt [m] the height that contradicts it and its streak of scans;
below [m] the ground that was there before something came to stand on it; upper [m] lowest ray that passed over a cell
without a LiDAR height; passes: scans that looked through the cell; sent_*: what the last patch said; mark: scratch."""

SAVED = ("height", "variance", "count", "seen", "source", "below", "upper")
"""Layers that make up a stored map; the others start fresh."""


class TileStore:
    """Pool of tiles with a directory. Slots are never freed: `clear` starts over."""

    def __init__(self, size: int) -> None:
        if size < 8 or size & (size - 1):
            raise ValueError(f"tile size must be a power of two of at least 8 cells, got {size}")
        self.size = size
        self.shift = size.bit_length() - 1
        self.clear()

    def clear(self) -> None:
        """Forget every tile."""
        self.used = 0
        self.tiles = np.zeros((0, 2), dtype=np.int32)
        self.touched = np.zeros(0, dtype=np.uint8)
        self.layers: dict[str, NDArray] = {n: np.zeros(0, dtype=d) for n, (d, _) in LAYERS.items()}
        self.directory = np.full((1, 1), -1, dtype=np.int32)
        self.first = np.zeros(2, dtype=np.int64)
        self._reserve(16)

    def __getitem__(self, name: str) -> NDArray:
        """Flat pool array of a layer, (capacity * size * size,). Valid until the next allocation."""
        return self.layers[name]

    def _reserve(self, capacity: int) -> None:
        have = self.touched.size
        if capacity <= have:
            return
        capacity = max(capacity, 2 * have)
        cells = (capacity - have) * self.size * self.size
        for name, (dtype, fresh) in LAYERS.items():
            self.layers[name] = np.concatenate([self.layers[name], np.full(cells, fresh, dtype=dtype)])
        self.touched = np.concatenate([self.touched, np.zeros(capacity - have, dtype=np.uint8)])
        self.tiles = np.concatenate([self.tiles, np.zeros((capacity - have, 2), dtype=np.int32)])

    def cover(self, row_lo: int, col_lo: int, row_hi: int, col_hi: int) -> None:
        """Grow the directory so that it holds the tile rows and columns given (both ends in)."""
        r0, c0 = int(self.first[0]), int(self.first[1])
        r1, c1 = r0 + self.directory.shape[0] - 1, c0 + self.directory.shape[1] - 1
        if row_lo >= r0 and col_lo >= c0 and row_hi <= r1 and col_hi <= c1:
            return
        # a margin of 8 tiles each time: a moving robot grows the directory rarely
        nr0, nr1 = (r0 if row_lo >= r0 else row_lo - 8), (r1 if row_hi <= r1 else row_hi + 8)
        nc0, nc1 = (c0 if col_lo >= c0 else col_lo - 8), (c1 if col_hi <= c1 else col_hi + 8)
        grown = np.full((nr1 - nr0 + 1, nc1 - nc0 + 1), -1, dtype=np.int32)
        grown[r0 - nr0 : r1 - nr0 + 1, c0 - nc0 : c1 - nc0 + 1] = self.directory
        self.directory = grown
        self.first = np.array([nr0, nc0], dtype=np.int64)

    def slot(self, row: int, col: int) -> int:
        """Pool slot of a tile, -1 when it was never allocated."""
        r, c = row - int(self.first[0]), col - int(self.first[1])
        inside = 0 <= r < self.directory.shape[0] and 0 <= c < self.directory.shape[1]
        return int(self.directory[r, c]) if inside else -1

    def allocate(self, row: int, col: int) -> int:
        """Pool slot of a tile, made when needed."""
        slot = self.slot(row, col)
        if slot >= 0:
            return slot
        self.cover(row, col, row, col)
        self._reserve(self.used + 1)
        slot = self.used
        self.used += 1
        self.tiles[slot] = row, col
        self.directory[row - int(self.first[0]), col - int(self.first[1])] = slot
        return slot

    def locate(self, i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.int64]:
        """Pool indices (n,) of cells (i, j), allocating the tiles they lie in."""
        out = np.empty(i.size, dtype=np.int64)
        if i.size == 0:
            return out
        s = self.shift
        self.cover(int(i.min()) >> s, int(j.min()) >> s, int(i.max()) >> s, int(j.max()) >> s)
        while True:
            row, col = _locate(i, j, self.directory, self.first, s, out)
            if row == _DONE:
                return out
            self.allocate(row, col)

    def tile_view(self, name: str, slot: int) -> NDArray:
        """(size, size) view of one tile's layer."""
        n = self.size * self.size
        return self.layers[name][slot * n : (slot + 1) * n].reshape(self.size, self.size)

    def read(self, name: str, i0: int, j0: int, rows: int, cols: int) -> NDArray:
        """Dense copy (rows, cols) of a layer; cells of absent tiles hold the fresh value."""
        dtype, fresh = LAYERS[name]
        out: NDArray = np.full((rows, cols), fresh, dtype=dtype)
        for slot, dst, src in self._overlaps(i0, j0, rows, cols):
            out[dst] = self.tile_view(name, slot)[src]
        return out

    def write(self, name: str, i0: int, j0: int, block: NDArray) -> None:
        """Store a dense block; parts over absent tiles are dropped."""
        for slot, dst, src in self._overlaps(i0, j0, *block.shape):
            self.tile_view(name, slot)[src] = block[dst]

    def _overlaps(self, i0: int, j0: int, rows: int, cols: int):
        s = self.size
        for tr in range(i0 >> self.shift, ((i0 + rows - 1) >> self.shift) + 1):
            for tc in range(j0 >> self.shift, ((j0 + cols - 1) >> self.shift) + 1):
                slot = self.slot(tr, tc)
                if slot < 0:
                    continue
                a, b = max(i0, tr * s), min(i0 + rows, (tr + 1) * s)
                c, d = max(j0, tc * s), min(j0 + cols, (tc + 1) * s)
                yield (
                    slot,
                    (slice(a - i0, b - i0), slice(c - j0, d - j0)),
                    (slice(a - tr * s, b - tr * s), slice(c - tc * s, d - tc * s)),
                )

    def bounds(self) -> tuple[int, int, int, int] | None:
        """i0, j0, rows, cols of the cells of all tiles, None for an empty store."""
        if self.used == 0:
            return None
        lo = self.tiles[: self.used].min(axis=0) * self.size
        hi = (self.tiles[: self.used].max(axis=0) + 1) * self.size
        return int(lo[0]), int(lo[1]), int(hi[0] - lo[0]), int(hi[1] - lo[1])

    @property
    def nbytes(self) -> int:
        """Memory held by the pool [bytes]."""
        return sum(a.nbytes for a in self.layers.values()) + self.directory.nbytes


_DONE = -(2**40)


@njit(cache=True)
def _locate(i, j, directory, first, shift, out):  # pragma: no cover - compiled
    """Fill `out` with pool indices; returns the first absent tile (row, col), or _DONE."""
    mask = (1 << shift) - 1
    area = 2 * shift
    for k in range(i.size):
        row, col = i[k] >> shift, j[k] >> shift
        slot = directory[row - first[0], col - first[1]]
        if slot < 0:
            return row, col
        out[k] = (np.int64(slot) << area) + ((i[k] & mask) << shift) + (j[k] & mask)
    return _DONE, _DONE
