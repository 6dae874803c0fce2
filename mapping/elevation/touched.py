"""What the robot touched and no ray shows: walls that lie over the measured map until they fade.

They exist in read-outs only, as bridged cells do. Rays that pass through a pane of glass cannot erase them. Once they
are gone the map reads as it was measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.elevation.exchange import TOUCHED, MapPatch
from mapping.elevation.tiles import TileStore

WALL_DEPTH = 0.10
"""[m] along the motion that met it: two cells and a half, so that it has no hole in any direction."""
WALL_RISE = 0.2
"""[m] above base_link: higher than any step."""


@dataclass(frozen=True, slots=True, eq=False)
class _Wall:
    i: NDArray[np.int64]
    j: NDArray[np.int64]
    height: NDArray[np.float32]
    until: int
    """[ms] of the map's time."""


class TouchedWalls:
    """The walls of one map. Times in ms lived through."""

    def __init__(self, fade: int, width: float) -> None:
        """`fade`: after so long [ms] a wall is forgotten; `width`: of the body [m]."""
        self._fade, self._half = fade, width / 2
        self._walls: list[_Wall] = []

    def __len__(self) -> int:
        return len(self._walls)

    def add(
        self, store: TileStore, place: tuple[float, float, float], yaw: float, resolution: float, now: int
    ) -> None:
        """Add a wall across `yaw` [rad] as wide as the body, the middle of its face at x, y [m] of `place`; z is that
        of base_link."""
        x, y, z = place
        c, s = math.cos(yaw), math.sin(yaw)
        reach = math.hypot(WALL_DEPTH, self._half)
        low, high = (np.floor((np.array([y, x]) + sign * reach) / resolution).astype(int) for sign in (-1, 1))
        i, j = (v.ravel() for v in np.mgrid[low[0] : high[0] + 2, low[1] : high[1] + 2])
        dx, dy = j * resolution - x, i * resolution - y
        along, across = c * dx + s * dy, c * dy - s * dx
        inside = (along >= 0.0) & (along <= WALL_DEPTH) & (np.abs(across) <= self._half)
        height = np.full(np.count_nonzero(inside), z + WALL_RISE, np.float32)
        self._enter(
            store, _Wall(i[inside].astype(np.int64), j[inside].astype(np.int64), height, now + self._fade)
        )

    def restore(self, store: TileStore, patch: MapPatch, now: int) -> None:
        """What a reader still has of them."""
        row, col = np.nonzero(patch.layers["source"] == TOUCHED)
        if len(row):
            i, j = row + patch.cell[0], col + patch.cell[1]
            height = patch.layers["elevation"][row, col].astype(np.float32)
            self._enter(store, _Wall(i.astype(np.int64), j.astype(np.int64), height, now + self._fade))

    def _enter(self, store: TileStore, wall: _Wall) -> None:
        self._walls.append(wall)
        self._changed(store, wall)

    def fade(self, store: TileStore, now: int) -> None:
        """Forget those whose time is over."""
        for wall in [w for w in self._walls if now >= w.until]:
            self._walls.remove(wall)
            self._changed(store, wall)

    def clear(self, store: TileStore) -> int:
        """Forget all of them; returns how many."""
        count = len(self._walls)
        for wall in self._walls:
            self._changed(store, wall)
        self._walls = []
        return count

    def paint(self, row: int, col: int, layers: NDArray[np.float32], variance: float) -> None:
        """Into `layers` (5, rows, cols) as PATCH_LAYERS, which begin at lattice row and column."""
        for wall in self._walls:
            r, c = wall.i - row, wall.j - col
            inside = (r >= 0) & (r < layers.shape[1]) & (c >= 0) & (c < layers.shape[2])
            r, c, height = r[inside], c[inside], wall.height[inside]
            for layer, value in enumerate((height, variance, 1.0, height, TOUCHED)):
                layers[layer, r, c] = value

    @staticmethod
    def _changed(store: TileStore, wall: _Wall) -> None:
        store.changed(store.locate(wall.i, wall.j))
