"""The fence as walls in the map that is planned on: every planner goes around them as around any other wall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.safety.geofence import Fence, Geofence
from mapping.grid import ElevationGrid

WALL_HEIGHT = 2.0
"""[m] over the ground: nothing drives over it."""
WALL_ROOM = 0.12
"""[m] on both sides of a side: the gate stops a body 0.06 m before it, and a robot strays from its path by a few
centimetres."""
Cells = NDArray[np.bool_]


def wall_up(grid: ElevationGrid, fence: Fence) -> None:
    """Change the grid in place: its cells within `WALL_ROOM` of a side, and all of what the robot keeps out of, become
    walls that are known."""
    for polygon in fence.polygons:
        r0, c0, r1, c1 = _box(polygon, grid.resolution, grid.origin)
        r0, c0, r1, c1 = max(r0, 0), max(c0, 0), min(r1, grid.shape[0]), min(c1, grid.shape[1])
        if r0 >= r1 or c0 >= c1:
            continue
        part = np.s_[r0:r1, c0:c1]
        wall = _wall(grid, polygon, r0, c0, (r1 - r0, c1 - c0))
        height = grid.height[part]
        height[wall] = np.nan_to_num(height[wall]) + WALL_HEIGHT
        grid.trusted[part][wall] = True
        for mask in (grid.virtual, grid.plants, grid.holes):
            if mask is not None:
                mask[part][wall] = False
        if grid.variance is not None:
            grid.variance[part][wall] = 1e-4


def windows(fence: Fence, resolution: float) -> list[tuple[int, int, int, int]]:
    """Lattice cells (first row, first column, row and column after the last) that `wall_up` may change."""
    return [_box(polygon, resolution) for polygon in fence.polygons]


def _box(
    polygon: Geofence, resolution: float, origin: tuple[float, float] = (0.0, 0.0)
) -> tuple[int, int, int, int]:
    """First row, first column, row and column after the last that its walls may lie in; cell [0, 0] is at `origin`
    [m]."""
    xy = np.array(polygon.corners) - origin
    c0, r0 = np.floor((xy.min(axis=0) - WALL_ROOM) / resolution).astype(int) - 1
    c1, r1 = np.ceil((xy.max(axis=0) + WALL_ROOM) / resolution).astype(int) + 2
    return int(r0), int(c0), int(r1), int(c1)


def _wall(grid: ElevationGrid, polygon: Geofence, r0: int, c0: int, shape: tuple[int, int]) -> Cells:
    """Which cells of the box are wall."""
    wall = np.zeros(shape, np.bool_)
    res = grid.resolution
    reach = WALL_ROOM + 0.5 * np.sqrt(2.0) * res
    corners = (np.array(polygon.corners) - grid.origin) / res - (c0, r0)
    k = int(np.ceil(reach / res))
    near = np.argwhere(np.hypot(*np.mgrid[-k : k + 1, -k : k + 1]) * res <= reach) - k
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = np.linspace(0.0, 1.0, max(2, int(np.ceil(2.0 * np.hypot(*(b - a)))) + 1))
        x, y = (np.rint(a + along[:, None] * (b - a)).astype(np.int64)).T
        on = (x >= -k) & (y >= -k) & (x < shape[1] + k) & (y < shape[0] + k)
        cells = np.unique(np.column_stack([y[on], x[on]]), axis=0)
        rows, cols = (cells[:, None, :] + near[None, :, :]).reshape(-1, 2).T
        inside = (rows >= 0) & (cols >= 0) & (rows < shape[0]) & (cols < shape[1])
        wall[rows[inside], cols[inside]] = True
    if polygon.keep_out:
        wall |= _filled(corners, shape)
    return wall


def _filled(corners: NDArray[np.float64], shape: tuple[int, int]) -> Cells:
    """Which cell centres lie in the polygon: left of an odd number of its sides."""
    crossed = np.zeros((shape[0], shape[1] + 1), np.int32)
    rows = np.arange(shape[0])
    for (x0, y0), (x1, y1) in zip(np.roll(corners, 1, axis=0), corners, strict=True):
        at = rows[(y0 > rows) != (y1 > rows)]
        x = x0 + (at - y0) / (y1 - y0) * (x1 - x0) if len(at) else at
        crossed[at, np.clip(np.ceil(x), 0, shape[1]).astype(np.int64)] += 1
    odd: Cells = np.cumsum(crossed[:, :-1], axis=1) % 2 == 1
    return odd
