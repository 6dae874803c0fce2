"""World-fixed tile store: a map of a building costs memory only where it was seen.

Cell (i, j) is centred on `(j * resolution, i * resolution)` in the `map` frame: row i grows with y, column j with x.
A tile holds `size` x `size` cells; all tiles live in one growing flat pool, so kernels address any cell with one
integer. A small dense directory maps tile coordinates to pool slots.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.elevation.exchange import MapError

UNKNOWN, CONTACT, LIDAR, BRIDGED, ASSUMED = 0, 1, 2, 3, 4
"""Where a height comes from. `BRIDGED` and `ASSUMED` (bridged, not trusted) exist in read-outs only, never in the store."""

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

PRIOR = -1
"""`seen` of a cell that comes from a prior map and was not seen since."""

FRESH = np.array([(np.nan, np.nan, np.nan, np.nan, np.inf, 0, 0, 0, UNKNOWN, 0, 0)], dtype=CELL)[0]

SENT = np.dtype([("height", "<f4"), ("upper", "<f4"), ("state", "u1")])
"""What the last delta said about a cell."""
FRESH_SENT = np.array([(np.nan, np.nan, 0)], dtype=SENT)[0]

SAVED = ("height", "variance", "below", "upper", "count", "source")
"""Fields that make up a stored map; the others start fresh."""

WIDEST = 2048
"""Tile rows or columns that a map may span: 5 km with tiles of 64 cells of 0.04 m. What lies further apart is an error of somebody's."""


class Layers(NamedTuple):
    """Dense read-out of cells, (rows, cols) each; see `CELL`."""

    height: NDArray[np.float32]
    variance: NDArray[np.float32]
    upper: NDArray[np.float32]
    points: NDArray[np.uint8]
    source: NDArray[np.uint8]


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
        self.reserve(16)

    def reserve(self, capacity: int) -> None:
        """Make room for that many tiles at once."""
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
        """Grow the directory so that it holds the tile rows and columns given (both ends in). Raises MapError beyond WIDEST."""
        if not self.used and self.directory.size == 1:  # the map begins where the robot is, not at the origin
            self.first = np.array([row_lo, col_lo], dtype=np.int64)
        r0, c0 = int(self.first[0]), int(self.first[1])
        r1, c1 = r0 + self.directory.shape[0] - 1, c0 + self.directory.shape[1] - 1
        if row_lo >= r0 and col_lo >= c0 and row_hi <= r1 and col_hi <= c1:
            return
        # a margin of 8 tiles each time: a moving robot grows the directory rarely
        nr0, nr1 = (r0 if row_lo >= r0 else row_lo - 8), (r1 if row_hi <= r1 else row_hi + 8)
        nc0, nc1 = (c0 if col_lo >= c0 else col_lo - 8), (c1 if col_hi <= c1 else col_hi + 8)
        if max(nr1 - nr0, nc1 - nc0) > WIDEST:
            raise MapError(
                f"tile ({row_lo}, {col_lo}) is more than {WIDEST} tiles away from what the map holds: is the pose right?"
            )
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
        self.reserve(self.used + 1)
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
        done = _locate(i, j, self.directory, self.first, s, out, 0)
        while done < i.size:
            self.allocate(int(i[done]) >> s, int(j[done]) >> s)
            done = _locate(i, j, self.directory, self.first, s, out, done)
        return out

    def tile(self, slot: int) -> NDArray[np.void]:
        """(size, size) view of one tile's cells."""
        n = self.size * self.size
        return self.cells[slot * n : (slot + 1) * n].reshape(self.size, self.size)

    def read(self, i0: int, j0: int, out: Layers) -> None:
        """Copy what the cells from (i0, j0) on hold into `out`; those of absent tiles are fresh."""
        _gather(self.cells, self.directory, self.first, self.shift, i0, j0, *out)

    def differences(
        self,
        i0: int,
        j0: int,
        height: NDArray[np.float32],
        upper: NDArray[np.float32],
        state: NDArray[np.uint8],
        step: float,
    ) -> list[tuple[int, int, int, int]]:
        """Rectangles (first row, row after the last, first column, column after the last) within a read-out whose corner
        is cell (i0, j0), that hold every cell which reads differently from what was last sent, at most one per `size` rows.
        They count as sent from now on.

        A cell differs by its state, by more than `step` [m] in height, or, where the height is unknown, by more than ten
        steps in the upper bound. Cells of absent tiles never differ.
        """
        bands = -(-height.shape[0] // self.size)
        boxes = np.empty((bands, 4), dtype=np.int64)
        _differences(
            self.sent, self.directory, self.first, self.shift, i0, j0, height, upper, state, step, boxes
        )
        return [(int(r0), int(r1), int(c0), int(c1)) for r0, r1, c0, c1 in boxes if r1 > r0]

    def seen(self, box: tuple[int, int, int, int]) -> NDArray[np.int32]:
        """`seen` of the cells of a box made of whole tiles (see `bounds`); PRIOR where no height was ever agreed with."""
        i0, j0, rows, cols = box
        out = np.full((rows, cols), PRIOR, np.int32)
        for slot, (row, col) in enumerate(self.tiles[: self.used] * self.size - (i0, j0)):
            cells = self.tile(slot)
            part = out[row : row + self.size, col : col + self.size]
            part[...] = np.where(np.isfinite(cells["height"]), cells["seen"], PRIOR)
        return out

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


@njit(cache=True)
def _locate(i, j, directory, first, shift, out, begin):  # pragma: no cover - compiled
    """Fill `out` with pool indices from `begin` on; returns the first cell whose tile is absent, or their number."""
    mask = (1 << shift) - 1
    area = 2 * shift
    for k in range(begin, i.size):
        row, col = i[k] >> shift, j[k] >> shift
        slot = directory[row - first[0], col - first[1]]
        if slot < 0:
            return k
        out[k] = (np.int64(slot) << area) + ((i[k] & mask) << shift) + (j[k] & mask)
    return i.size


@njit(cache=True)
def base_of(directory, first, shift, row, col):  # pragma: no cover - compiled
    """Pool index of the first cell of a tile, -1 when it is absent."""
    r, c = row - first[0], col - first[1]
    if 0 <= r < directory.shape[0] and 0 <= c < directory.shape[1] and directory[r, c] >= 0:
        return np.int64(directory[r, c]) << (2 * shift)
    return np.int64(-1)


@njit(cache=True)
def _gather(
    cells, directory, first, shift, i0, j0, height, variance, upper, count, source
):  # pragma: no cover - compiled
    """See `TileStore.read`."""
    rows, cols = height.shape
    mask = (1 << shift) - 1
    for r in range(rows):
        i = i0 + r
        c = 0
        while c < cols:
            j = j0 + c
            end = min(cols, c + mask + 1 - (j & mask))
            base = base_of(directory, first, shift, i >> shift, j >> shift)
            if base < 0:
                for k in range(c, end):
                    height[r, k] = variance[r, k] = np.nan
                    upper[r, k] = np.inf
                    count[r, k] = source[r, k] = 0
            else:
                at = base + ((i & mask) << shift) + (j & mask) - c
                for k in range(c, end):
                    cell = cells[at + k]
                    height[r, k] = cell.height
                    variance[r, k] = cell.variance
                    upper[r, k] = cell.upper
                    count[r, k] = cell.count
                    source[r, k] = cell.source
            c = end


@njit(cache=True)
def _differences(
    sent, directory, first, shift, i0, j0, height, upper, state, step, boxes
):  # pragma: no cover - compiled
    """See `TileStore.differences`; an empty box has no rows."""
    rows, cols = height.shape
    size = 1 << shift
    mask = size - 1
    for band in range(boxes.shape[0]):
        top, bottom, left, right = rows, 0, cols, 0
        for write in range(2):  # find the rectangle, then keep it
            r0, r1 = (top, bottom) if write else (band * size, min((band + 1) * size, rows))
            for r in range(r0, r1):
                i = i0 + r
                c, stop = (left, right) if write else (0, cols)
                while c < stop:
                    j = j0 + c
                    end = min(stop, c + size - (j & mask))
                    base = base_of(directory, first, shift, i >> shift, j >> shift)
                    at = base + ((i & mask) << shift) + (j & mask) - c
                    if base >= 0:
                        for k in range(c, end):
                            old = sent[at + k]
                            h, u = height[r, k], upper[r, k]
                            if write:
                                old.height, old.upper, old.state = h, u, state[r, k]
                                continue
                            differs = state[r, k] != old.state or abs(h - old.height) > step
                            if not differs and h != h:
                                was = old.upper
                                differs = abs(u - was) > 10.0 * step or (u == u) != (was == was)
                            if differs:
                                top, bottom = min(top, r), max(bottom, r + 1)
                                left, right = min(left, k), max(right, k + 1)
                    c = end
        boxes[band, 0], boxes[band, 1], boxes[band, 2], boxes[band, 3] = top, bottom, left, right
