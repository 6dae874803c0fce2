"""What is still to go to a goal beyond known ground, from where a plan may end."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from hal.raster import cells_of
from mapping.grid import ElevationGrid
from planning.graph.closing import closed
from planning.graph.fields import FIELD_SPREAD, OBSTACLE_FACE
from planning.graph.flags import FIELD
from planning.graph.graph import TraversalGraph
from planning.search.heap import ZERO, pop, push

WAY_CELL = 0.2
"""Raster on which the way through unknown ground and sight are judged [m]."""
KEEP_OFF = 0.15
"""That way keeps this far from known obstacles [m]: less than half the body, so that a gap of half a metre stays
open."""
AROUND_NODE = 0.4
"""[m] around a place that the robot can come to the ground is known."""
IN_FIELD = 11.0
"""What a metre of the way to go counts in a stepfield with high posts."""
LEAVES_WITHIN = 0.8
"""[m] from a frontier node to ground that nobody saw, at most: half a body and a ring (`planning.graph.describe`)."""


class OpenGround(NamedTuple):
    """Raster of what known obstacles leave open, and where the goal lies on it; one cell of free ground around the
    map, because who leaves it may go around everything."""

    origin: tuple[float, float]
    """x, y [m] of cell [0, 0]."""
    blocked: NDArray[np.bool_]
    """(rows, cols)"""
    goal: NDArray[np.float64]
    """(rows, cols) straight way to the goal [m] from the cells at it, or from those around a map that it is not on;
    infinite elsewhere."""
    rim: NDArray[np.bool_]
    """(rows, cols) off the map."""


def open_ground(grid: ElevationGrid, goal: tuple[float, float]) -> OpenGround:
    """For ways to the goal x, y [m]."""
    x0, y0, x1, y1 = grid.extent
    ox, oy = x0 - WAY_CELL, y0 - WAY_CELL
    shape = (math.ceil((y1 - oy) / WAY_CELL) + 2, math.ceil((x1 - ox) / WAY_CELL) + 2)
    blocked = np.zeros(shape, np.bool_)
    holes = np.zeros_like(grid.trusted) if grid.holes is None else grid.holes
    _block(grid.height, grid.trusted, holes, grid.resolution, WAY_CELL, WAY_CELL, blocked)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] * WAY_CELL
    straight = np.hypot(x + ox - goal[0], y + oy - goal[1])
    rim = np.ones(shape, np.bool_)
    rim[1:-1, 1:-1] = False
    inside = x0 <= goal[0] <= x1 and y0 <= goal[1] <= y1
    # the goal may stand close to something
    seeds = straight <= 1.5 * WAY_CELL if inside else rim
    return OpenGround((ox, oy), blocked & ~seeds, np.where(seeds, straight, np.inf), rim)


def way_to_go(
    grid: ElevationGrid,
    points: NDArray[np.float64],
    goal: tuple[float, float],
    reached: NDArray[np.float64] | None = None,
    fields: NDArray[np.bool_] | None = None,
    ground: OpenGround | None = None,
) -> NDArray[np.float64]:
    """(n,) length [m] of the shortest way from points (n, >= 2) to the goal x, y that known obstacles leave open,
    infinite where there is none. Ground off the map is open.

    A metre in `fields` (rows, cols of the grid) counts `IN_FIELD` times, and so does ground between parts of them that
    was not seen, where these are less than `FIELD_SPREAD` apart: most likely they go on there. What lies on one side of
    them alone may be the way around.

    `reached`: (k, >= 2) places that the robot can come to, such as the nodes of its graph. The way then does not lead
    back over the ground around them: where it would leave it again, another place is nearer. `ground`: `open_ground`
    of this grid and goal, where it is at hand.
    """
    origin, blocked, begin, rim = ground or open_ground(grid, goal)
    known = np.zeros(blocked.shape, np.bool_)
    if reached is not None:
        known[_cells_of(reached, origin, blocked.shape)] = True
        known = ndimage.binary_dilation(known, np.ones((3, 3)), round(AROUND_NODE / WAY_CELL))
    dear = np.ones(blocked.shape)
    if fields is not None and fields.any():
        span = round(FIELD_SPREAD / grid.resolution)
        whole = closed(np.pad(fields, span).astype(np.float32), span)[span:-span, span:-span] > 0.0
        fields = fields | (whole & ~grid.trusted)
        # the raster's cells whose middle lies in a field
        rows, cols = (
            cells_of(
                np.arange(float(blocked.shape[k])) * WAY_CELL + origin[1 - k],
                grid.extent[1 - k],
                grid.resolution,
            )
            for k in (0, 1)
        )
        on = np.outer((rows >= 0) & (rows < fields.shape[0]), (cols >= 0) & (cols < fields.shape[1]))
        dear[on & fields.take(rows, 0, mode="clip").take(cols, 1, mode="clip")] = IN_FIELD
    way = _flood(blocked, begin.copy(), rim, known, dear)
    # a node may stand nearer to an obstacle than KEEP_OFF: the best of the cells around it
    near = ndimage.minimum_filter(way, 3, mode="constant", cval=np.inf)
    line = np.hypot(points[:, 0] - goal[0], points[:, 1] - goal[1])
    return np.asarray(np.maximum(near[_cells_of(points, origin, blocked.shape)], line))


def fields_of(graph: TraversalGraph) -> NDArray[np.bool_] | None:
    """(rows, cols) of the graph's map: what lies in a stepfield with high posts; None where the graph knows no map."""
    return None if graph.cells is None else graph.cells.flags & FIELD > 0


def _cells_of(
    points: NDArray[np.float64], origin: tuple[float, float], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of points (n, >= 2) [m] on the raster, clipped."""
    col, row = (cells_of(points[:, k], origin[k], WAY_CELL) for k in (0, 1))
    return np.clip(row, 1, shape[0] - 2), np.clip(col, 1, shape[1] - 2)


@njit(cache=True)
def _block(height, trusted, holes, res, dx, dy, blocked):
    """Mark raster cells within `KEEP_OFF` of a face or of a hole that is too wide; dx, dy: cell [0, 0] of the grid seen
    from the raster's [m]."""
    rows, cols = height.shape
    for r in range(rows):
        for c in range(cols):
            face = holes[r, c]
            for k in range(1, 3):
                if not trusted[r, c]:
                    break
                if (
                    r + k < rows
                    and trusted[r + k, c]
                    and abs(height[r + k, c] - height[r, c]) > OBSTACLE_FACE
                ):
                    face = True
                if (
                    c + k < cols
                    and trusted[r, c + k]
                    and abs(height[r, c + k] - height[r, c]) > OBSTACLE_FACE
                ):
                    face = True
            if not face:
                continue
            x = (c + 0.5) * res + dx
            y = (r + 0.5) * res + dy
            for j in range(math.ceil((y - KEEP_OFF) / WAY_CELL), math.floor((y + KEEP_OFF) / WAY_CELL) + 1):
                for i in range(
                    math.ceil((x - KEEP_OFF) / WAY_CELL), math.floor((x + KEEP_OFF) / WAY_CELL) + 1
                ):
                    if (i * WAY_CELL - x) ** 2 + (j * WAY_CELL - y) ** 2 <= KEEP_OFF**2:
                        blocked[j, i] = True


@njit(cache=True)
def _flood(blocked, way, free, known, dear):
    """Dijkstra over the eight neighbours from the finite cells of `way`; cells in `free` are never blocked. It comes no
    farther than `LEAVES_WITHIN` into cells in `known`. `dear`: what a metre counts."""
    rows, cols = way.shape
    deep = np.zeros(way.shape)
    most = 9 * rows * cols
    f, s, e, n = np.empty(most), np.empty(most, np.int64), np.empty(most, np.int8), 0
    for r in range(rows):
        for c in range(cols):
            if way[r, c] < np.inf:
                n = push(f, s, e, n, way[r, c], r * cols + c, ZERO)
    while n:
        d, r, c = f[0], s[0] // cols, s[0] % cols
        n = pop(f, s, e, n)
        if d > way[r, c]:
            continue
        for a in range(max(0, r - 1), min(rows, r + 2)):
            for b in range(max(0, c - 1), min(cols, c + 2)):
                step = WAY_CELL * math.hypot(a - r, b - c)
                depth = deep[r, c] + step if known[a, b] else 0.0
                if (blocked[a, b] and not free[a, b]) or depth > LEAVES_WITHIN:
                    continue
                new = d + step * 0.5 * (dear[r, c] + dear[a, b])
                if new < way[a, b]:
                    way[a, b], deep[a, b] = new, depth
                    n = push(f, s, e, n, new, a * cols + b, ZERO)
    return way
