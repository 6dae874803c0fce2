"""World-fixed tile store: a map of a building costs memory only where it was seen.

Cell (i, j) is centred on `(j * resolution, i * resolution)` in the `map` frame: row i grows with y, column j with x.
A tile holds `size` x `size` cells. All tiles live in one growing flat pool, so kernels address any cell with one
integer. A small dense directory maps tile coordinates to pool slots. Tiles far from the robot may lie on a shelf (on
the disk); whoever reads or writes them brings them back."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.elevation.exchange import PLANTS as PLANTS  # its values of `source` are all told here
from mapping.elevation.exchange import MapError
from mapping.elevation.shelf import Shelf
from mapping.elevation.tile_kernels import differences, gather, locate, take_back

UNKNOWN, CONTACT, LIDAR, BRIDGED, ASSUMED = 0, 1, 2, 3, 4
"""Where a height comes from. `BRIDGED` and `ASSUMED` (bridged, not trusted) exist in read-outs only, never in the
store. `PLANTS`: ground under leaves, as high as the ground around; `upper` is the top of the leaves."""

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

FRESH_CELL = np.array([(np.nan, np.nan, np.nan, np.nan, np.inf, 0, 0, 0, UNKNOWN, 0, 0)], dtype=CELL)[0]

SENT = np.dtype([("height", "<f4"), ("upper", "<f4"), ("state", "u1")])
"""What the last delta said about a cell."""
AWAY = -2
"""In the directory: the tile lies on the shelf. -1: there is none."""
FRESH_SENT = np.array([(np.nan, np.nan, 0)], dtype=SENT)[0]

AT_ONCE = 16
"""Tiles put away in one scan, 3 MB. With 1000 at once the robot stood for 2.4 s on its way, on a loaded machine."""
TRUSTED_SENT = 16
"""`state` of a cell that the last delta called trusted."""

SAVED = ("height", "variance", "below", "upper", "count", "source")
"""Fields that make up a stored map; the others start fresh."""

WIDEST_MAP = 2048
"""Tile rows or columns that a map may span: 5 km with tiles of 64 cells of 0.04 m. Anything wider is an input error."""


class Layers(NamedTuple):
    """Dense read-out of cells, (rows, cols) each; see `CELL`."""

    height: NDArray[np.float32]
    variance: NDArray[np.float32]
    upper: NDArray[np.float32]
    points: NDArray[np.uint8]
    source: NDArray[np.uint8]


def _grown(pool: NDArray[Any], rows: int) -> NDArray[Any]:
    """A pool with more rows; the new ones are zero, and take memory and time where they are first written only."""
    out = np.zeros((rows, *pool.shape[1:]), pool.dtype)
    out[: len(pool)] = pool
    return out


class TileStore:
    """Pool of tiles with a directory. The slots in use are the first `used` ones."""

    def __init__(self, size: int, folder: Path | None = None) -> None:
        """`size`: cells of a tile's side; folder: on whose disk tiles are put away, None: nowhere."""
        if size < 8 or size & (size - 1):
            raise ValueError(f"tile size must be a power of two of at least 8 cells, got {size}")
        self.size = size
        self.shift = size.bit_length() - 1
        n = size * size
        self._record = np.empty(1, [("cells", CELL, n), ("sent", SENT, n), ("level", "<f4", n)])
        self.put_on(folder)
        self.clear()

    def put_on(self, folder: Path | None) -> None:
        """Where tiles are put away from now on; while none is."""
        self.folder = folder
        self.shelf = Shelf(folder)
        self._middle: tuple[int, int] | None = None

    def clear(self) -> None:
        """Forget every tile."""
        self.used = 0
        self.tiles = np.zeros((0, 2), dtype=np.int32)
        self.touched = np.zeros(0, dtype=np.uint8)
        self.cells = np.zeros(0, dtype=CELL)
        self.sent = np.zeros(0, dtype=SENT)
        self.mark = np.zeros(0, dtype=np.int32)
        self.level = np.zeros(0, dtype=np.float32)
        """Heights of the prior map [m], see `keep_level`; empty without one."""
        self.directory = np.full((1, 1), -1, dtype=np.int32)
        self.first = np.zeros(2, dtype=np.int64)
        self.shelf.clear()
        self._away: dict[tuple[int, int], tuple[int, int]] = {}
        """Known and trusted cells of each tile on the shelf."""
        self.reserve(16)

    def keep_level(self) -> None:
        """Remember the heights that the LiDAR cells have now as `level`."""
        held = self.cells[: self._span(self.used).start]
        self.level = np.zeros(self.cells.size, np.float32)
        self.level[: held.size] = np.where(held["source"] == LIDAR, held["height"], np.nan)

    def reserve(self, capacity: int) -> None:
        """Make room for that many tiles at once. Their cells are initialised when they are allocated, so a moving
        robot does not wait for a thousand tiles."""
        have = self.touched.size
        if capacity <= have:
            return
        capacity = max(capacity, 2 * have)
        cells = capacity * self.size * self.size
        self.cells, self.sent, self.mark = (
            _grown(pool, cells) for pool in (self.cells, self.sent, self.mark)
        )
        if self.level.size:
            self.level = _grown(self.level, cells)
        self.touched, self.tiles = _grown(self.touched, capacity), _grown(self.tiles, capacity)

    def stay_near(self, row: int, col: int, near: int, far: int, most: int = AT_ONCE) -> None:
        """Bring back the tiles up to `near` rows and columns from a tile. Put away tiles beyond `far` whose changes
        were read, at most `most` per call."""
        if (not self.shelf.open and not len(self.shelf)) or self._middle == (row, col):
            return
        self.bring(row - near, col - near, row + near, col + near)
        away = np.abs(self.tiles[: self.used] - (row, col)).max(axis=1) > far
        slots = np.flatnonzero(away & (self.touched[: self.used] == 0))[::-1]
        self._middle = (row, col) if len(slots) <= most else None
        for slot in slots[:most].tolist():
            if not self._put_away(slot):
                return

    def bring(self, row_lo: int, col_lo: int, row_hi: int, col_hi: int) -> None:
        """Bring back what is on the shelf of these tile rows and columns (both ends in)."""
        if not len(self.shelf):
            return
        r0, c0 = (max(0, lo - int(f)) for lo, f in zip((row_lo, col_lo), self.first, strict=True))
        part = self.directory[
            r0 : max(0, row_hi + 1 - int(self.first[0])), c0 : max(0, col_hi + 1 - int(self.first[1]))
        ]
        for r, c in np.argwhere(part == AWAY).tolist():
            self.allocate(r0 + r + int(self.first[0]), c0 + c + int(self.first[1]))
        self._middle = None

    def counts(self) -> tuple[int, int, int]:
        """Tiles; cells with a source; cells that the last delta called trusted: in the pool and on the shelf."""
        n = self._span(self.used).start
        known = int(np.count_nonzero(self.cells["source"][:n])) + sum(k for k, _ in self._away.values())
        trusted = int(np.count_nonzero(self.sent["state"][:n] >= TRUSTED_SENT))
        return self.used + len(self._away), known, trusted + sum(k for _, k in self._away.values())

    def _put_away(self, slot: int) -> bool:
        """Move a tile from the pool to the shelf; the last tile takes its slot. False if the disk does not take it."""
        here, record = self._span(slot), self._record
        record["cells"], record["sent"] = self.cells[here], self.sent[here]
        record["level"] = self.level[here] if self.level.size else np.nan
        row, col = (int(k) for k in self.tiles[slot])
        if not self.shelf.put((row, col), record):
            return False
        trusted = np.count_nonzero(record["sent"]["state"] >= TRUSTED_SENT)
        self._away[row, col] = int(np.count_nonzero(record["cells"]["source"])), int(trusted)
        last = self.used - 1
        there = self._span(last)
        for pool in (self.cells, self.sent, self.level):
            pool[here] = pool[there]
        self._enter(row, col, AWAY)
        if last != slot:
            self._enter(int(self.tiles[last, 0]), int(self.tiles[last, 1]), slot)
        self.tiles[slot], self.touched[slot] = self.tiles[last], self.touched[last]
        self.touched[last], self.used = 0, last
        return True

    def _take_back(self, row: int, col: int, slot: int) -> None:
        here, record = self._span(slot), self._record
        record["cells"], record["sent"], record["level"] = FRESH_CELL, FRESH_SENT, np.nan
        self.shelf.take((row, col), record)
        del self._away[row, col]
        self.cells[here], self.sent[here] = record["cells"][0], record["sent"][0]
        if self.level.size:
            self.level[here] = record["level"][0]

    def _span(self, slot: int) -> slice:
        n = self.size * self.size
        return slice(slot * n, (slot + 1) * n)

    def _enter(self, row: int, col: int, slot: int) -> None:
        self.directory[row - int(self.first[0]), col - int(self.first[1])] = slot

    def cover(self, row_lo: int, col_lo: int, row_hi: int, col_hi: int) -> None:
        """Grow the directory so that it holds these tile rows and columns (both ends included). Raises MapError
        beyond WIDEST_MAP."""
        if not self.used and self.directory.size == 1:  # the map begins where the robot is, not at the origin
            self.first = np.array([row_lo, col_lo], dtype=np.int64)
        r0, c0 = int(self.first[0]), int(self.first[1])
        r1, c1 = r0 + self.directory.shape[0] - 1, c0 + self.directory.shape[1] - 1
        if row_lo >= r0 and col_lo >= c0 and row_hi <= r1 and col_hi <= c1:
            return
        # a margin of 8 tiles each time: a moving robot grows the directory rarely
        nr0, nr1 = (r0 if row_lo >= r0 else row_lo - 8), (r1 if row_hi <= r1 else row_hi + 8)
        nc0, nc1 = (c0 if col_lo >= c0 else col_lo - 8), (c1 if col_hi <= c1 else col_hi + 8)
        if max(nr1 - nr0, nc1 - nc0) > WIDEST_MAP:
            raise MapError(
                f"tile ({row_lo}, {col_lo}) is more than {WIDEST_MAP} tiles away from what the map holds: is the "
                "pose right?"
            )
        grown = np.full((nr1 - nr0 + 1, nc1 - nc0 + 1), -1, dtype=np.int32)
        grown[r0 - nr0 : r1 - nr0 + 1, c0 - nc0 : c1 - nc0 + 1] = self.directory
        self.directory = grown
        self.first = np.array([nr0, nc0], dtype=np.int64)

    def slot(self, row: int, col: int) -> int:
        """Pool slot of a tile, -1 when it was never allocated, AWAY on the shelf."""
        r, c = row - int(self.first[0]), col - int(self.first[1])
        inside = 0 <= r < self.directory.shape[0] and 0 <= c < self.directory.shape[1]
        return int(self.directory[r, c]) if inside else -1

    def allocate(self, row: int, col: int) -> int:
        """Pool slot of a tile, made or brought back when needed."""
        held = self.slot(row, col)
        if held >= 0:
            return held
        self.cover(row, col, row, col)
        self.reserve(self.used + 1)
        slot = self.used
        self.used += 1
        self.tiles[slot] = row, col
        self._enter(row, col, slot)
        here = self._span(slot)
        self.cells[here], self.sent[here], self.level[here] = FRESH_CELL, FRESH_SENT, np.nan
        if held == AWAY:
            self._take_back(row, col, slot)
        return slot

    def locate(self, i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.int64]:
        """Pool indices (n,) of cells (i, j), allocating the tiles they lie in."""
        out = np.empty(i.size, dtype=np.int64)
        if i.size == 0:
            return out
        s = self.shift
        self.cover(int(i.min()) >> s, int(j.min()) >> s, int(i.max()) >> s, int(j.max()) >> s)
        done = locate(i, j, self.directory, self.first, s, out, 0)
        while done < i.size:
            self.allocate(int(i[done]) >> s, int(j[done]) >> s)
            done = locate(i, j, self.directory, self.first, s, out, done)
        return out

    def where(self, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n, 2) row and column of cells (n,) of the pool."""
        tile, within = np.divmod(cell, self.size**2)
        return np.asarray(
            self.tiles[tile] * self.size + np.column_stack(np.divmod(within, self.size)), np.int64
        )

    def changed(self, cell: NDArray[np.int64]) -> None:
        """These cells (n,) of the pool were written: the next delta reads the tiles that they lie in."""
        self.touched[cell >> (2 * self.shift)] = 1

    def touch(self, source: int) -> None:
        """The tiles of the pool with a cell of this source count as changed."""
        cells = self.cells["source"][: self._span(self.used).start].reshape(-1, self.size**2)
        self.touched[: self.used] |= (cells == source).any(axis=1)

    def tile(self, slot: int) -> NDArray[np.void]:
        """(size, size) view of one tile's cells."""
        return self.cells[self._span(slot)].reshape(self.size, self.size)

    def look_at(self, row: int, col: int) -> NDArray[np.void]:
        """(size, size) cells of a tile, to be read before the next call; one on the shelf stays there."""
        slot = self.slot(row, col)
        if slot >= 0:
            return self.tile(slot)
        self._record["cells"] = FRESH_CELL
        self.shelf.get((row, col), self._record)
        return self._record["cells"].reshape(self.size, self.size)

    def read(self, i0: int, j0: int, out: Layers) -> None:
        """Copy what the cells from (i0, j0) on hold into `out`; those of absent tiles are fresh."""
        rows, cols = out.height.shape
        s = self.shift
        self.bring(i0 >> s, j0 >> s, (i0 + rows - 1) >> s, (j0 + cols - 1) >> s)
        gather(self.cells, self.directory, self.first, self.shift, i0, j0, *out)

    def take_back(
        self,
        i0: int,
        j0: int,
        layers: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
        source: NDArray[np.uint8],
        count: int,
        now: int,
    ) -> None:
        """Write height, variance and upper bound, (rows, cols) each, into the cells from (i0, j0) on, as seen at
        `now` [ms], LiDAR cells with `count` points. source: UNKNOWN, CONTACT or LIDAR. An unknown cell without a
        finite upper bound stays as it is."""
        wanted = (source != UNKNOWN) | np.isfinite(layers[2])
        rows, cols = source.shape
        for row in range(i0 >> self.shift, ((i0 + rows - 1) >> self.shift) + 1):
            for col in range(j0 >> self.shift, ((j0 + cols - 1) >> self.shift) + 1):
                r, c = row * self.size - i0, col * self.size - j0
                if wanted[max(0, r) : r + self.size, max(0, c) : c + self.size].any():
                    self.allocate(row, col)
        where = (self.directory, self.first, self.shift, i0, j0)
        take_back(self.cells, self.touched, *where, *layers, source, wanted, count, LIDAR, now)

    def differences(
        self,
        i0: int,
        j0: int,
        height: NDArray[np.float32],
        upper: NDArray[np.float32],
        state: NDArray[np.uint8],
        step: float,
    ) -> list[tuple[int, int, int, int]]:
        """Rectangles (first row, row after the last, first column, column after the last) within a read-out whose
        corner is cell (i0, j0). They hold every cell that reads differently from what was last sent, at most one per
        `size` rows. They count as sent from now on.

        A cell differs by its state, by more than `step` [m] in height, or, if the height is unknown, by more than ten
        steps in the upper bound. Cells of absent tiles never differ."""
        bands = -(-height.shape[0] // self.size)
        boxes = np.empty((bands, 4), dtype=np.int64)
        differences(
            self.sent, self.directory, self.first, self.shift, i0, j0, height, upper, state, step, boxes
        )
        return [(int(r0), int(r1), int(c0), int(c1)) for r0, r1, c0, c1 in boxes if r1 > r0]

    def seen(self, box: tuple[int, int, int, int]) -> NDArray[np.int32]:
        """`seen` of the cells of a box made of whole tiles; PRIOR where no height was ever agreed with."""
        i0, j0, rows, cols = box
        s = self.shift
        self.bring(i0 >> s, j0 >> s, (i0 + rows - 1) >> s, (j0 + cols - 1) >> s)
        out = np.full((rows, cols), PRIOR, np.int32)
        for slot, (row, col) in enumerate((self.tiles[: self.used] * self.size - (i0, j0)).tolist()):
            if 0 <= row < rows and 0 <= col < cols:
                cells = self.tile(slot)
                part = out[row : row + self.size, col : col + self.size]
                part[...] = np.where(np.isfinite(cells["height"]), cells["seen"], PRIOR)
        return out

    @property
    def keys(self) -> NDArray[np.int64]:
        """(n, 2) row and column of every tile, in the pool or on the shelf, in order."""
        held = np.concatenate([self.tiles[: self.used], np.array(self.shelf.keys, np.int32).reshape(-1, 2)])
        return held[np.lexsort(held.T[::-1])].astype(np.int64)

    def bounds(self) -> tuple[int, int, int, int] | None:
        """i0, j0, rows, cols of the cells of all tiles, None for an empty store."""
        keys = self.keys if len(self.shelf) else self.tiles[: self.used]
        if not len(keys):
            return None
        lo, hi = keys.min(axis=0) * self.size, (keys.max(axis=0) + 1) * self.size
        return int(lo[0]), int(lo[1]), int(hi[0] - lo[0]), int(hi[1] - lo[1])

    @property
    def nbytes(self) -> int:
        """Memory held by the pool [bytes]."""
        pool = (self.cells, self.sent, self.mark, self.level, self.directory)
        return sum(array.nbytes for array in pool)
