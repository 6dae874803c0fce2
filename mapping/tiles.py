"""World-fixed tile store: a map of a building costs memory only where it was seen.

Cell (i, j) is centred on `(j * resolution, i * resolution)` in the `map` frame: row i grows with y, column j with x.
A tile holds `size` x `size` cells; all tiles live in one growing flat pool, so kernels address any cell with one
integer. A small dense directory maps tile coordinates to pool slots.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

UNKNOWN, CONTACT, LIDAR, BRIDGED = 0, 1, 2, 3
"""Where a height comes from. `BRIDGED` exists in read-outs only, never in the store."""

CELL = np.dtype(
    [
        ("height", "<f4"),
        ("variance", "<f4"),
        ("alt", "<f4"),
        ("below", "<f4"),
        ("upper", "<f4"),
        ("seen", "<i4"),
        ("alt_seen", "<i4"),
        ("count", "u1"),
        ("source", "u1"),
        ("streak", "u1"),
        ("passes", "u1"),
    ]
)
"""One cell, 32 bytes, so that fusing touches one cache line per cell.

height [m] and variance [m^2] of the surface; alt [m]: a height that contradicts it; below [m]: the ground that was
there before something came to stand on it; upper [m]: lowest ray that passed over a cell without a LiDAR height; seen
and alt_seen [ms since the map's first scan]: last agreement with either height; count: points that agreed; source;
streak: scans in a row that said `alt`; passes: clean-ups that looked through the cell."""

FRESH = np.array([(np.nan, np.nan, np.nan, np.nan, np.inf, 0, 0, 0, UNKNOWN, 0, 0)], dtype=CELL)[0]

SENT = np.dtype([("height", "<f4"), ("upper", "<f4"), ("state", "u1")])
"""What the last delta said about a cell."""
FRESH_SENT = np.array([(np.nan, np.nan, 0)], dtype=SENT)[0]

SAVED = ("height", "variance", "below", "upper", "seen", "count", "source")
"""Fields that make up a stored map; the others start fresh."""


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
        self.cells = np.zeros(0, dtype=CELL)
        self.sent = np.zeros(0, dtype=SENT)
        self.mark = np.zeros(0, dtype=np.int32)
        self.directory = np.full((1, 1), -1, dtype=np.int32)
        self.first = np.zeros(2, dtype=np.int64)
        self._reserve(16)

    def _reserve(self, capacity: int) -> None:
        have = self.touched.size
        if capacity <= have:
            return
        capacity = max(capacity, 2 * have)
        cells = (capacity - have) * self.size * self.size
        self.cells = np.concatenate([self.cells, np.full(cells, FRESH, dtype=CELL)])
        self.sent = np.concatenate([self.sent, np.full(cells, FRESH_SENT, dtype=SENT)])
        self.mark = np.concatenate([self.mark, np.zeros(cells, dtype=np.int32)])
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

    def tile(self, slot: int) -> NDArray[np.void]:
        """(size, size) view of one tile's cells."""
        n = self.size * self.size
        return self.cells[slot * n : (slot + 1) * n].reshape(self.size, self.size)

    def read(self, i0: int, j0: int, rows: int, cols: int) -> NDArray[np.void]:
        """Dense copy (rows, cols) of cells; those of absent tiles are fresh."""
        out: NDArray = np.full((rows, cols), FRESH, dtype=CELL)
        for slot, dst, src in self._overlaps(i0, j0, rows, cols):
            out[dst] = self.tile(slot)[src]
        return out

    def swap_sent(
        self, i0: int, j0: int, block: NDArray[np.void] | None, shape: tuple[int, int]
    ) -> NDArray[np.void]:
        """Dense copy (rows, cols) of what was last sent; `block` replaces it when given."""
        n = self.size * self.size
        out: NDArray = np.full(shape, FRESH_SENT, dtype=SENT)
        for slot, dst, src in self._overlaps(i0, j0, *shape):
            tile = self.sent[slot * n : (slot + 1) * n].reshape(self.size, self.size)
            out[dst] = tile[src]
            if block is not None:
                tile[src] = block[dst]
        return out

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
        return self.cells.nbytes + self.sent.nbytes + self.mark.nbytes + self.directory.nbytes


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
