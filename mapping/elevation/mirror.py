"""A reader's copy of the map: tiles grown from patches, read as windows. Memory follows the ground that was seen, not
the bounding box."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapping.elevation.exchange import LARGEST_PATCH, PATCH_LAYERS, MapError, MapPatch
from mapping.elevation.shelf import Key, Shelf
from mapping.grid import ElevationGrid

TILE_SIDE = 64
"""Cells of a tile's side."""
VIEW_STEP = 8 * TILE_SIDE
"""A view moves by so many cells: it stays the same while a robot drives 20 m."""
BLOCK_SIDE = 8
"""Tiles of the side of a block of a map that is sent in several patches."""
WHOLE_CELLS = 6_250_000
"""Cells of a map that people and their tools get in one patch: 100 x 100 m of 4 cm."""
PART_CELLS = 600_000
"""The same for our own processes, which put patches together again. No stage stands still for longer than 0.1 s."""
EMPTY = "no map yet: no patch was received"
_UNSEEN_CELL = np.array([np.nan, np.nan, 0.0, np.nan, 0.0], np.float32)
"""A fresh cell, in the order of PATCH_LAYERS."""


@dataclass(frozen=True, slots=True)
class CellWindow:
    """A rectangle of lattice cells."""

    row: int
    col: int
    rows: int
    cols: int

    def within(self, other: CellWindow) -> CellWindow:
        """The part inside of another; without rows or columns where there is none."""
        row, col = max(self.row, other.row), max(self.col, other.col)
        rows = min(self.row + self.rows, other.row + other.rows) - row
        cols = min(self.col + self.cols, other.col + other.cols) - col
        return CellWindow(row, col, max(0, rows), max(0, cols))

    def seen_from(self, other: CellWindow) -> tuple[slice, slice]:
        """Its rows and columns in an array of the cells of another one."""
        row, col = self.row - other.row, self.col - other.col
        return slice(row, row + self.rows), slice(col, col + self.cols)

    def and_all_of(self, other: CellWindow) -> CellWindow:
        """The smallest one that holds both."""
        row, col = min(self.row, other.row), min(self.col, other.col)
        rows = max(self.row + self.rows, other.row + other.rows) - row
        return CellWindow(row, col, rows, max(self.col + self.cols, other.col + other.cols) - col)

    def on_tiles(self) -> CellWindow:
        """Grown to whole tiles."""
        row, col = self.row // TILE_SIDE * TILE_SIDE, self.col // TILE_SIDE * TILE_SIDE
        rows, cols = (
            -(-(self.row + self.rows) // TILE_SIDE) * TILE_SIDE,
            -(-(self.col + self.cols) // TILE_SIDE) * TILE_SIDE,
        )
        return CellWindow(row, col, rows - row, cols - col)

    @property
    def tiles(self) -> Iterator[Key]:
        """Row and column of each tile that it touches."""
        for row in range(self.row // TILE_SIDE, -(-(self.row + self.rows) // TILE_SIDE)):
            for col in range(self.col // TILE_SIDE, -(-(self.col + self.cols) // TILE_SIDE)):
                yield row, col


def blocks_of(keys: NDArray[np.integer], side: int, most: int = PART_CELLS) -> Iterator[CellWindow]:
    """Windows that hold all tiles (n, 2) of `side` cells: one if it has at most `most` cells, else blocks of 8 x 8
    tiles, each cut to its tiles."""
    whole = _window(keys, side)
    if whole.rows * whole.cols <= most:
        yield whole
        return
    block = keys // BLOCK_SIDE
    for place in np.unique(block, axis=0):
        yield _window(keys[(block == place).all(axis=1)], side)


def _window(keys: NDArray[np.integer], side: int) -> CellWindow:
    row, col = (int(k) * side for k in keys.min(axis=0))
    rows, cols = ((int(k) + 1) * side for k in keys.max(axis=0))
    return CellWindow(row, col, rows - row, cols - col)


class MapMirror:
    """Patches in, windows out. `grid` is what planning works on."""

    def __init__(self, folder: Path | None = None) -> None:
        """folder: on whose disk far tiles are put away; None: all stay in memory."""
        self.resolution = 0.0
        """[m]; 0 until the first patch."""
        self.epoch = -1
        self.stamp = 0
        self._tiles: dict[Key, NDArray[np.float32]] = {}
        """(5, TILE_SIDE, TILE_SIDE) each, in the order of PATCH_LAYERS."""
        self.shelf = Shelf(folder)
        self._kept: CellWindow | None = None

    @property
    def known(self) -> bool:
        """A patch was received."""
        return len(self) > 0

    def __contains__(self, key: Key) -> bool:
        """Whether something of a tile was received."""
        return key in self._tiles or key in self.shelf

    def __len__(self) -> int:
        """Tiles of which something was received."""
        return len(self._tiles) + len(self.shelf)

    @property
    def trouble(self) -> str:
        """What is wrong with the disk that tiles are put on; words for the operator."""
        return self.shelf.trouble

    @property
    def nbytes(self) -> int:
        """Memory of the tiles [bytes]."""
        return sum(tile.nbytes for tile in self._tiles.values())

    def put_on(self, folder: Path) -> None:
        """Put far tiles on this disk from now on; while there are none."""
        self.shelf = Shelf(folder)

    def apply(self, patch: MapPatch) -> CellWindow:
        """Take a patch in; returns the cells that it wrote. A new epoch or resolution starts over.

        A patch of an older epoch is ignored (empty window). Raises MapError for a patch off the lattice.
        """
        window = window_of(patch)
        if patch.epoch < self.epoch:
            return CellWindow(window.row, window.col, 0, 0)
        if patch.epoch > self.epoch or abs(patch.resolution - self.resolution) > 1e-9:
            self.epoch, self.resolution = patch.epoch, patch.resolution
            self._tiles.clear()
            self.shelf.clear()
        for key in window.tiles:
            here = CellWindow(key[0] * TILE_SIDE, key[1] * TILE_SIDE, TILE_SIDE, TILE_SIDE)
            both, tile = window.within(here), self._own(key)
            there, these = both.seen_from(here), both.seen_from(window)
            for layer, name in zip(tile, PATCH_LAYERS, strict=True):
                layer[there] = patch.layers[name][these]
        self.stamp = max(self.stamp, patch.stamp)
        return window

    def tile(self, key: Key) -> NDArray[np.float32] | None:
        """(5, TILE_SIDE, TILE_SIDE) layers of a tile in the order of PATCH_LAYERS, None where nothing was seen. Read
        only."""
        if key in self.shelf:
            out = fresh_tile()
            self.shelf.get(key, out)
            return out
        return self._tiles.get(key)

    def bounds(self) -> CellWindow:
        """The box around all tiles. Raises MapError before the first patch."""
        return _window(self._keys(), TILE_SIDE)

    def view(self, xy: tuple[float, float], over: MapPatch | None = None) -> CellWindow:
        """The part of the map (and of `over`) around x, y [m] that is planned on: the seen ground of 5 x 5 steps of
        512 cells. It has no rows or columns if nothing was seen there. Raises MapError before the first patch."""
        if not self.known:
            raise MapError(EMPTY)
        if not all(map(math.isfinite, xy)):
            return CellWindow(0, 0, 0, 0)
        row, col = (round(v / self.resolution) // VIEW_STEP - 2 for v in (xy[1], xy[0]))
        around = CellWindow(row * VIEW_STEP, col * VIEW_STEP, 5 * VIEW_STEP, 5 * VIEW_STEP)
        # What was seen elsewhere must not widen it: in a street with corners all of the square would be planned on.
        keys = list(self._within(around))
        seen = _window(np.array(keys, np.int64), TILE_SIDE) if keys else None
        if over is not None:
            on_top = window_of(over).on_tiles().within(around)
            if on_top.rows and on_top.cols:
                seen = on_top if seen is None else seen.and_all_of(on_top)
        return CellWindow(0, 0, 0, 0) if seen is None else seen

    def read(self, window: CellWindow, names: Sequence[str] = PATCH_LAYERS) -> MapPatch:
        """Layers of the cells of a window. Raises MapError where it is too large for one patch."""
        if window.rows * window.cols > LARGEST_PATCH:
            sides = " x ".join(f"{n * self.resolution:.0f}" for n in (window.rows, window.cols))
            raise MapError(f"the map is too large to be read as a whole: {sides} m")
        at = [PATCH_LAYERS.index(name) for name in names]
        layers = {
            name: np.full((window.rows, window.cols), _UNSEEN_CELL[k])
            for name, k in zip(names, at, strict=True)
        }
        for key in self._within(window):
            tile = self.tile(key)
            assert tile is not None
            here = CellWindow(key[0] * TILE_SIDE, key[1] * TILE_SIDE, TILE_SIDE, TILE_SIDE)
            both = here.within(window)
            there, these = both.seen_from(window), both.seen_from(here)
            for name, k in zip(names, at, strict=True):
                layers[name][there] = tile[k][these]
        origin = (window.col * self.resolution, window.row * self.resolution)
        return MapPatch(origin, self.resolution, self.stamp, self.epoch, layers)

    def patch(self) -> MapPatch:
        """Everything received, as one patch. Raises MapError before the first patch, and where that is too large."""
        return self.read(self.bounds())

    def windows(self) -> list[CellWindow]:
        """Few windows that hold everything received. Raises MapError before the first patch."""
        return list(blocks_of(self._keys(), TILE_SIDE))

    def grid(self, window: CellWindow | None = None, over: MapPatch | None = None) -> ElevationGrid:
        """A window for planning with `over` laid on it; None: the whole map. Unknown heights are filled from the
        nearest known cell and untrusted; some are virtual ground. Raises MapError as `read`."""
        window = self.bounds() if window is None else window
        patch = self.read(window, ("elevation", "variance", "trusted", "upper_bound", "source"))
        if over is not None:
            for name, layer in patch.layers.items():
                copy(over.layers[name], window_of(over), layer, window)
        return patch.grid(filled=True)

    def stay_within(self, window: CellWindow) -> None:
        """Put the tiles outside of a window away and bring those inside back, where there is a disk."""
        if window == self._kept or not (self.shelf.open or len(self.shelf)):
            return
        self._kept = window
        inside = set(window.tiles)
        for key in [key for key in self.shelf.keys if key in inside]:
            self._own(key)
        for key in [key for key in self._tiles if key not in inside]:
            if not self.shelf.put(key, self._tiles[key]):
                return
            del self._tiles[key]

    def _own(self, key: Key) -> NDArray[np.float32]:
        """A tile to be written to."""
        if key not in self._tiles:
            self._tiles[key] = fresh_tile()
            if key in self.shelf:
                self.shelf.take(key, self._tiles[key])
            self._kept = None
        return self._tiles[key]

    def _keys(self) -> NDArray[np.int64]:
        if not self.known:
            raise MapError(EMPTY)
        return np.array(sorted([*self._tiles, *self.shelf.keys]), np.int64)

    def _within(self, window: CellWindow) -> Iterator[Key]:
        """Tiles of a window of which something was seen."""
        return (key for key in window.tiles if key in self)


def fresh_tile() -> NDArray[np.float32]:
    """(5, TILE_SIDE, TILE_SIDE) of which nothing was seen."""
    return np.ascontiguousarray(
        np.broadcast_to(_UNSEEN_CELL[:, None, None], (len(_UNSEEN_CELL), TILE_SIDE, TILE_SIDE))
    )


def window_of(patch: MapPatch) -> CellWindow:
    """The cells of a patch. Raises MapError where it does not lie on the lattice."""
    row, col = patch.cell
    off = max(abs(patch.origin[1] - row * patch.resolution), abs(patch.origin[0] - col * patch.resolution))
    if not off < 1e-3 * patch.resolution:
        raise MapError(f"patch origin {patch.origin} is not a multiple of its resolution {patch.resolution}")
    return CellWindow(row, col, *patch.shape)


def copy(source: NDArray, of: CellWindow, target: NDArray, to: CellWindow) -> None:
    """Write the cells of window `of` into those of window `to`, where both have them."""
    both = of.within(to)
    target[both.seen_from(to)] = source[both.seen_from(of)]
