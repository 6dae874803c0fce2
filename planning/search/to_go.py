"""What is still to go to a goal beyond known ground, from where a plan may end. Ground that nobody saw counts as free:
what is left can hardly be cheaper."""

from __future__ import annotations

import heapq
import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.closing import closed
from planning.graph.fields import SPREAD
from planning.graph.flags import FIELD, VIRTUAL
from planning.graph.graph import TraversalGraph

CELL = 0.2
"""Raster of the way through unknown ground [m]."""
KEEP_OFF = 0.2
"""That way keeps this far from known obstacles [m]: a little less than half the body, for it must not be too long."""
OBSTACLE = 0.25
"""A face this high [m] is an obstacle whatever the controller: what is lower may still be crossed further on."""
CLOSED = 1e3
"""Added where known obstacles close every way to the goal [m]: such a frontier comes last."""
IN_FIELD = 11.0
"""What a metre of the way to go counts in a stepfield with high posts."""


def way_to_go(
    grid: ElevationGrid,
    points: NDArray[np.float64],
    goal: tuple[float, float],
    fields: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """(n,) length [m] of the shortest way from points (n, >= 2) to the goal x, y that known obstacles leave open.

    Never less than the straight line. Ground off the map is free. `CLOSED` is added where there is no way. A metre in
    `fields` (rows, cols of the grid) counts `IN_FIELD` times, and so does ground between parts of them that was not
    seen, where these are less than `SPREAD` apart: most likely they go on there. What lies on one side of them alone
    may be the way around.
    """
    x0, y0, x1, y1 = grid.extent
    # one cell of free ground around the map: who leaves it may go around everything
    ox, oy = x0 - CELL, y0 - CELL
    shape = (math.ceil((y1 - oy) / CELL) + 2, math.ceil((x1 - ox) / CELL) + 2)
    blocked = np.zeros(shape, np.bool_)
    _block(grid.height, grid.trusted, grid.resolution, CELL, CELL, blocked)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] * CELL
    straight = np.hypot(x + ox - goal[0], y + oy - goal[1])
    rim = np.ones(shape, np.bool_)
    rim[1:-1, 1:-1] = False
    inside = x0 <= goal[0] <= x1 and y0 <= goal[1] <= y1
    # the goal may stand close to something
    seeds = straight <= 1.5 * CELL if inside else rim
    dear = np.ones(shape)
    if fields is not None and fields.any():
        span = round(SPREAD / grid.resolution)
        whole = closed(np.pad(fields, span).astype(np.float32), span)[span:-span, span:-span] > 0.0
        fields = fields | (whole & ~grid.trusted)
        # the raster's cells whose middle lies in a field
        row = np.floor((y[:, 0] + oy - y0) / grid.resolution + 0.5).astype(np.int64)
        col = np.floor((x[0] + ox - x0) / grid.resolution + 0.5).astype(np.int64)
        on = np.outer((row >= 0) & (row < fields.shape[0]), (col >= 0) & (col < fields.shape[1]))
        middle = fields.take(row, 0, mode="clip").take(col, 1, mode="clip")
        dear[on & middle] = IN_FIELD
    way = _flood(blocked & ~seeds, np.where(seeds, straight, np.inf), rim, dear)
    col = np.clip(np.floor((points[:, 0] - ox) / CELL + 0.5).astype(np.int64), 1, shape[1] - 2)
    row = np.clip(np.floor((points[:, 1] - oy) / CELL + 0.5).astype(np.int64), 1, shape[0] - 2)
    # a node may stand nearer to an obstacle than KEEP_OFF: the best of the cells around it
    near = np.min([way[row + i, col + j] for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
    line = np.hypot(points[:, 0] - goal[0], points[:, 1] - goal[1])
    return np.where(np.isfinite(near), np.maximum(near, line), line + CLOSED)


def through_virtual(
    graph: TraversalGraph, ends: NDArray[np.bool_], to_go: NDArray[np.float64], price: float
) -> NDArray[np.float64]:
    """(n,) least way [m] from each node over the graph to one of `ends` (n,) and from there `to_go` (n,) [m]; inf where
    none is reached.

    Virtual ground outside of stepfields counts as free, as what lies beyond a frontier does, other ground with its risk
    at `price` and what it crosses.
    """
    flags = flags_at(graph, graph.nodes)
    hidden = flags & (VIRTUAL | FIELD) == VIRTUAL
    source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
    length = np.hypot(*(graph.nodes[source, :2] - graph.nodes[graph.indices, :2]).T)
    free = hidden[source] | hidden[graph.indices]
    cost = np.where(free, length, graph.costs(price, back=True))  # asked from the ends on
    return least_way(graph.indptr, graph.indices.astype(np.int64), cost, np.where(ends, to_go, np.inf))


def in_field(graph: TraversalGraph, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) which of points (n, >= 2) [m] lie in a stepfield with high posts."""
    return flags_at(graph, points) & FIELD > 0


def flags_at(graph: TraversalGraph, points: NDArray[np.float64]) -> NDArray[np.uint16]:
    """(n,) flags of the cells below points (n, >= 2) [m]; 0 where the graph knows no map."""
    c = graph.cells
    if c is None:
        return np.zeros(len(points), np.uint16)
    col, row = (np.floor((points[:, k] - c.origin[k]) / c.res + 0.5).astype(np.int64) for k in (0, 1))
    rows, cols = c.flags.shape
    return np.asarray(c.flags[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)])


@njit(cache=True)
def least_way(indptr, indices, cost, way):
    """Dijkstra from the finite ones of `way` (n,), which become the least over the edges' `cost` (nnz,)."""
    heap = [(0.0, 0) for _ in range(0)]
    for i in range(len(way)):
        if way[i] < np.inf:
            heapq.heappush(heap, (way[i], i))
    while heap:
        d, i = heapq.heappop(heap)
        if d > way[i]:
            continue
        for out in range(indptr[i], indptr[i + 1]):
            k = indices[out]
            if d + cost[out] < way[k]:
                way[k] = d + cost[out]
                heapq.heappush(heap, (way[k], k))
    return way


@njit(cache=True)
def _block(height, trusted, res, dx, dy, blocked):
    """Mark raster cells within `KEEP_OFF` of a face; dx, dy: cell [0, 0] of the grid seen from the raster's [m]."""
    rows, cols = height.shape
    for r in range(rows):
        for c in range(cols):
            if not trusted[r, c]:
                continue
            face = False
            for k in range(1, 3):
                if r + k < rows and trusted[r + k, c] and abs(height[r + k, c] - height[r, c]) > OBSTACLE:
                    face = True
                if c + k < cols and trusted[r, c + k] and abs(height[r, c + k] - height[r, c]) > OBSTACLE:
                    face = True
            if not face:
                continue
            x = (c + 0.5) * res + dx
            y = (r + 0.5) * res + dy
            for j in range(math.ceil((y - KEEP_OFF) / CELL), math.floor((y + KEEP_OFF) / CELL) + 1):
                for i in range(math.ceil((x - KEEP_OFF) / CELL), math.floor((x + KEEP_OFF) / CELL) + 1):
                    if (i * CELL - x) ** 2 + (j * CELL - y) ** 2 <= KEEP_OFF**2:
                        blocked[j, i] = True


@njit(cache=True)
def _flood(blocked, way, free, dear):
    """Dijkstra over the eight neighbours from the finite cells of `way`; cells in `free` are never blocked. `dear`:
    what a metre counts there."""
    rows, cols = way.shape
    heap = [(0.0, 0, 0) for _ in range(0)]
    for r in range(rows):
        for c in range(cols):
            if way[r, c] < np.inf:
                heapq.heappush(heap, (way[r, c], r, c))
    while heap:
        d, r, c = heapq.heappop(heap)
        if d > way[r, c]:
            continue
        for a in range(max(0, r - 1), min(rows, r + 2)):
            for b in range(max(0, c - 1), min(cols, c + 2)):
                if blocked[a, b] and not free[a, b]:
                    continue
                new = d + CELL * math.hypot(a - r, b - c) * 0.5 * (dear[r, c] + dear[a, b])
                if new < way[a, b]:
                    way[a, b] = new
                    heapq.heappush(heap, (new, a, b))
    return way
