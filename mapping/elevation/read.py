"""Reading the map out: dense layers with bridged gaps, and the deltas since the last read."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.safety.monitors import HOLE_WIDTH
from mapping.elevation import bridging
from mapping.elevation.bridging import OVER, bridge, bridge_rule, trust
from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import HOLE, LARGEST_PATCH, PATCH_LAYERS, MapError, MapPatch
from mapping.elevation.holes import WIDE, Crossing, mark_holes
from mapping.elevation.mirror import blocks_of
from mapping.elevation.plants import TALLEST_PLANT
from mapping.elevation.tiles import ASSUMED, BRIDGED, PLANTS, Layers, TileStore
from mapping.elevation.touched import TouchedWalls

_BLOCK_TILES = 12
"""Tiles per side of the blocks that deltas are worked out in: bounds the memory of one step, and holds what a LiDAR of
10 m range touches, so that a driving robot pays for the margin around a block once."""

EMPTY = "the map is empty: nothing was seen yet"

Box = tuple[int, int, int, int]
"""Lattice row and column of the first cell, rows, columns."""


class MapReader:
    """Turns the tiles of one store into patches."""

    def __init__(self, store: TileStore, params: ElevationConfig, crossing: Crossing) -> None:
        self.store = store
        self.params = p = params
        self._crossing = crossing
        self.granted = True
        """Gaps beside the wheels are bridged that no ray proves; see `ElevationMap.grant`."""
        self.walls = TouchedWalls(round(1e3 * p.touched_fade), p.body_size[1])
        self._rules = [
            bridge_rule(
                p.resolution, p.bridge_gap, p.bridge_step, p.bridge_slope, p.bridge_bound, p.hole, blind, p.bridge_trust
            )
            for blind in (0.0, p.blind_gap)
        ]  # fmt: skip
        self._floats, self._bytes = _Scratch(np.float32), _Scratch(np.uint8)
        self._result = _Scratch(np.float32)
        self._border = int(bridging.RIM_WIDTH / p.resolution) + 2
        """Cells around the tiles that are read with them: more than the rim of a hole is wide."""
        self._pad = int(np.ceil((max(p.bridge_gap, p.blind_gap) + 2 * p.bridge_gap) / p.resolution)) + 1

    def read(self, box: Box, stamp: int, epoch: int) -> MapPatch:
        """Cells of `box`, bridged."""
        layers = self._layers(box, np.empty((len(PATCH_LAYERS), *box[2:]), np.float32))
        return self._patch(box, stamp, epoch, dict(zip(PATCH_LAYERS, layers, strict=True)))

    def _patch(self, box: Box, stamp: int, epoch: int, layers: dict[str, NDArray[np.float32]]) -> MapPatch:
        r = self.params.resolution
        return MapPatch((box[1] * r, box[0] * r), r, stamp, epoch, layers)

    def _layers(self, box: Box, out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Into `out` (5, rows, cols), as PATCH_LAYERS. The margin around it covers a bridge and what its slope is
        judged by, as far as there are tiles: a bridge ends on known cells."""
        p, pad = self.params, self._pad
        i0, j0, rows, cols = box
        i, j, tile_rows, tile_cols = self.store.bounds() or (i0, j0, 0, 0)
        top, left = min(i0, max(i0 - pad, i - self._border)), min(j0, max(j0 - pad, j - self._border))
        bottom = max(i0 + rows, min(i0 + rows + pad, i + tile_rows + self._border))
        right = max(j0 + cols, min(j0 + cols + pad, j + tile_cols + self._border))
        wide = bottom - top, right - left
        height, variance, upper, bound, level, gap = self._floats.take(6, *wide)
        small = self._bytes.take(5, *wide)
        count, source, marks = small[0], small[1], small[2:]
        self.store.read(top, left, Layers(height, variance, upper, count, source))
        trusted = trust(
            height, variance, upper, count, source,
            p.trust_sigma**2, p.trust_count, p.alone_count, p.gate_min, p.hole, bound,
        )  # fmt: skip
        bridge(height, source, trusted, bound, self._rules[self.granted], level, gap, marks)
        if HOLE_WIDTH.active:
            mark_holes(height, source, trusted, count, bound, p.resolution, *self._crossing, gap)
        _compose(height, variance, upper, source, trusted, i0 - top, j0 - left, p.trust_sigma**2, out)
        self.walls.paint(i0, j0, out, p.trust_sigma**2)
        return out

    def take_changes(self, stamp: int, epoch: int, most: int) -> list[MapPatch]:
        """Patches of what reads differently from what the last ones said; at most one per row of tiles and block. No
        further block is begun after `most` cells: what it holds still counts as changed."""
        s = self.store
        slots = np.flatnonzero(s.touched[: s.used])
        if slots.size == 0:
            return []
        pad = self._pad  # bridging carries a change that far
        patches: list[MapPatch] = []
        tiles = s.tiles[slots].astype(np.int64)
        bounds = s.bounds()
        assert bounds is not None
        block = (tiles - tiles.min(axis=0)) // _BLOCK_TILES
        for place in np.unique(block, axis=0):
            if sum(patch.layers["elevation"].size for patch in patches) >= most:
                break
            here = (block == place).all(axis=1)
            inside = tiles[here]
            s.touched[slots[here]] = 0
            row, col = inside.min(axis=0) * s.size - pad
            end = (inside.max(axis=0) + 1) * s.size + pad
            # Where there are no tiles nothing reads differently. Rows are left out by whole bands, or other cells
            # would share a patch.
            row, col = row + max(0, bounds[0] - row) // s.size * s.size, max(col, bounds[1])
            rows, cols = np.minimum(end, (bounds[0] + bounds[2], bounds[1] + bounds[3])) - (row, col)
            patches += self._changes((int(row), int(col), int(rows), int(cols)), stamp, epoch)
        return patches

    def read_all(self, stamp: int, epoch: int) -> MapPatch:
        """The whole map. Raises MapError while it is empty, and where it is larger than LARGEST_PATCH."""
        box = self.store.bounds()
        if box is None:
            raise MapError(EMPTY)
        if box[2] * box[3] > LARGEST_PATCH:
            sides = " x ".join(f"{n * self.params.resolution:.0f}" for n in box[2:])
            raise MapError(f"the map is too large to be read as a whole: {sides} m")
        return self.read(box, stamp, epoch)

    def boxes(self, most: int) -> Iterator[Box]:
        """The whole map as few boxes, one if that has at most so many cells. Raises MapError while it is empty."""
        keys = self.store.keys
        if not len(keys):
            raise MapError(EMPTY)
        return ((w.row, w.col, w.rows, w.cols) for w in blocks_of(keys, self.store.size, most))

    def _changes(self, box: Box, stamp: int, epoch: int) -> list[MapPatch]:
        """Patches of what differs from the last ones sent, within a box."""
        whole = self._layers(box, self._result.take(len(PATCH_LAYERS), *box[2:]))
        elevation, _, trusted, upper, source = whole
        state = (source + 16 * trusted).astype(np.uint8)
        patches = []
        for top, bottom, left, right in self.store.differences(
            box[0], box[1], elevation, upper, state, self.params.patch_step
        ):
            cut = whole[:, top:bottom, left:right].copy()
            part = box[0] + top, box[1] + left, bottom - top, right - left
            patches.append(self._patch(part, stamp, epoch, dict(zip(PATCH_LAYERS, cut, strict=True))))
        return patches


class _Scratch:
    """Memory that is used again: fresh pages cost more than the work done in them."""

    def __init__(self, dtype: type) -> None:
        self._flat: NDArray[Any] = np.empty(0, dtype=dtype)

    def take(self, *shape: int) -> NDArray[Any]:
        """An array of this shape with anything in it."""
        n = math.prod(shape)
        if self._flat.size < n:
            self._flat = np.empty(n, dtype=self._flat.dtype)
        return self._flat[:n].reshape(shape)


@njit(cache=True)
def _compose(height, variance, upper, source, trusted, top, left, sigma2, out):  # pragma: no cover - compiled
    """Layers (5, rows, cols) in the order of PATCH_LAYERS from wider read-outs after `bridge`, which they begin `top`
    rows and `left` columns in."""
    for r in range(out.shape[1]):
        for c in range(out.shape[2]):
            a, b = r + top, c + left
            h, s, u = height[a, b], source[a, b], upper[a, b]
            out[0, r, c] = h
            out[1, r, c] = variance[a, b] if s < OVER or s == WIDE else np.float32(sigma2)
            out[2, r, c] = trusted[a, b]
            if s == PLANTS:
                out[3, r, c] = min(
                    u, h + np.float32(TALLEST_PLANT)
                )  # no ray told its top where the map came back from a reader
            else:
                out[3, r, c] = h if h == h else (u if u < np.inf else np.nan)
            if s == WIDE:
                out[4, r, c] = HOLE
            else:
                out[4, r, c] = s if s < OVER else (ASSUMED if s == bridging.ASSUMED else BRIDGED)
