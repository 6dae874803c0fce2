"""What a place shows of the ground that nobody saw: the map as a coarse raster, and rays over it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from mapping.grid import ElevationGrid
from planning.graph.flags import FACE, UNSEEN_RAW, VIRTUAL
from planning.graph.graph import TraversalGraph
from planning.search.to_go import WAY_CELL

Array = NDArray[np.float64]
SIGHT_RANGE = 4.0
"""[m] A LiDAR on the back sees ground densely enough for the map within this distance."""
SIGHT_RAYS = 72
HIDING_HEIGHT = 0.4
"""[m] A face whose upper side is so much above the place hides the ground behind it."""
UNREACHED_RANGE = 0.6
"""[m] Seen ground farther than this from every node is ground that no way leads to."""
LEAST_EDGE = 1.0
"""[m] A shorter edge of the seen ground, where no way leads to, is not told."""
JOINED_CELLS = np.ones((3, 3), np.bool_)
"""Diagonals included."""


@dataclass(slots=True)
class Sight:
    """The area, or the map and `SIGHT_RANGE` around it, in cells of `WAY_CELL`."""

    origin: tuple[float, float]
    """Lower left corner [m]."""
    unseen: NDArray[np.bool_]
    """(rows, cols) inside the area, and nobody saw it."""
    seen: NDArray[np.bool_]
    """(rows, cols) inside the area, and ground."""
    top: NDArray[np.float32]
    """(rows, cols) upper side of the faces there [m]; -inf where there is none."""
    taken: NDArray[np.bool_]
    """(rows, cols) unseen, and shown by a place that was chosen."""

    @classmethod
    def of(cls, graph: TraversalGraph, grid: ElevationGrid, area: Array | None) -> Sight:
        """From the flags that the graph has of its map."""
        assert graph.cells is not None
        flags, res = graph.cells.flags, graph.cells.res
        x0, y0 = graph.cells.origin
        rows, cols = flags.shape
        low = np.array([x0, y0]) - SIGHT_RANGE
        high = np.array([x0 + cols * res, y0 + rows * res]) + SIGHT_RANGE
        if area is not None:
            low, high = np.maximum(low, area.min(axis=0)), np.minimum(high, area.max(axis=0))
        shape = tuple(np.maximum(np.ceil((high - low) / WAY_CELL).astype(int), 1)[::-1])
        origin = (float(low[0]), float(low[1]))
        seen, top = np.zeros(shape, np.bool_), np.full(shape, -np.inf, np.float32)
        _reduce(flags, grid.height, x0 - 0.5 * res, y0 - 0.5 * res, res, *origin, seen, top)
        inside = np.ones(shape, np.bool_)
        if area is not None:
            y, x = np.mgrid[0 : shape[0], 0 : shape[1]] * WAY_CELL + 0.5 * WAY_CELL
            inside = _inside(x + origin[0], y + origin[1], area)
        ground = seen & ~np.isfinite(top)
        return cls(origin, inside & ~seen, inside & ground, top, np.zeros(shape, np.bool_))

    def cells(self, xy: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Row and column of places (n, 2), clipped, and which lie on the raster."""
        c, r = (np.floor((xy[:, k] - self.origin[k]) / WAY_CELL).astype(np.int64) for k in (0, 1))
        on = (r >= 0) & (c >= 0) & (r < self.seen.shape[0]) & (c < self.seen.shape[1])
        return np.clip(r, 0, self.seen.shape[0] - 1), np.clip(c, 0, self.seen.shape[1] - 1), on

    def holds(self, xy: Array) -> NDArray[np.bool_]:
        """(n,) which places lie in the area."""
        r, c, on = self.cells(xy)
        return np.asarray(on & (self.seen | self.unseen | np.isfinite(self.top))[r, c])

    def near(self, nodes: Array, reach: float) -> NDArray[np.bool_]:
        """(rows, cols) which cells lie within `reach` [m] of a node."""
        out = np.zeros(self.seen.shape, np.bool_)
        _mark(np.ascontiguousarray(nodes[:, :2]), *self.origin, reach, out)
        return out

    def shown(self, places: Array) -> Array:
        """(n,) [m^2] of unseen ground, not taken yet, that places (n, 3) show."""
        return np.asarray(_shown(places, self.unseen, self.taken, self.top, *self.origin))

    def take(self, place: Array) -> None:
        """What a place (3,) shows is taken."""
        _look(place, self.unseen, self.taken, self.top, *self.origin, True)

    def seen_near(self, nodes: Array) -> float:
        """[m^2] seen and within reach of the robot."""
        return float((self.seen & self.near(nodes, 0.5)).sum()) * WAY_CELL**2

    def hidden(self, shown: float, bounded: bool) -> float:
        """[m^2] that may be seen yet: what the places show, and in an area all unseen ground joined to it."""
        if not bounded:
            return shown
        return float(joined(self.taken, self.unseen).sum()) * WAY_CELL**2

    def unreachable(self, nodes: Array) -> Array:
        """(m, 2) middles [m] of edges between seen ground far from every node and unseen ground."""
        edge = np.zeros(self.seen.shape, np.bool_)
        edge[:-1] |= self.unseen[1:]
        edge[1:] |= self.unseen[:-1]
        edge[:, :-1] |= self.unseen[:, 1:]
        edge[:, 1:] |= self.unseen[:, :-1]
        edge &= self.seen & ~self.near(nodes, UNREACHED_RANGE)
        found = []
        names, count = ndimage.label(edge, JOINED_CELLS)
        for k in range(1, count + 1):
            rc = np.argwhere(names == k)
            if len(rc) * WAY_CELL >= LEAST_EDGE:
                r, c = rc[len(rc) // 2]
                found.append((self.origin[0] + (c + 0.5) * WAY_CELL, self.origin[1] + (r + 0.5) * WAY_CELL))
        return np.array(found).reshape(-1, 2)


def joined(some: NDArray[np.bool_], ground: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """`some` of the ground (rows, cols) and what is joined to it there, diagonals included."""
    return np.asarray(ndimage.binary_propagation(some, JOINED_CELLS, ground))


def _inside(x: Array, y: Array, corners: Array) -> NDArray[np.bool_]:
    """Whether places lie in a polygon (n, 2), by the parity of edges to the right of them."""
    out = np.zeros(x.shape, np.bool_)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if ay != by:
            out ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return out


@njit(cache=True)
def _reduce(flags, height, x0, y0, res, ox, oy, seen, top):
    """Cells of the map into those of the raster: seen where more than half of them were, `top` of faces."""
    rows, cols = seen.shape
    count = np.zeros((rows, cols), np.int32)
    known = np.zeros((rows, cols), np.int32)
    for r in range(flags.shape[0]):
        j = math.floor((y0 + (r + 0.5) * res - oy) / WAY_CELL)
        if j < 0 or j >= rows:
            continue
        for c in range(flags.shape[1]):
            i = math.floor((x0 + (c + 0.5) * res - ox) / WAY_CELL)
            if i < 0 or i >= cols:
                continue
            count[j, i] += 1
            if not flags[r, c] & (UNSEEN_RAW | VIRTUAL):  # rays passed over virtual ground, none met it
                known[j, i] += 1
                if flags[r, c] & FACE and height[r, c] > top[j, i]:
                    top[j, i] = height[r, c]
    for j in range(rows):
        for i in range(cols):
            seen[j, i] = 2 * known[j, i] > count[j, i]


@njit(cache=True)
def _mark(places, ox, oy, reach, out):
    """Set the cells within `reach` of places (n, 2)."""
    rows, cols = out.shape
    n = math.ceil(reach / WAY_CELL)
    for k in range(len(places)):
        c = math.floor((places[k, 0] - ox) / WAY_CELL)
        r = math.floor((places[k, 1] - oy) / WAY_CELL)
        for j in range(max(0, r - n), min(rows, r + n + 1)):
            for i in range(max(0, c - n), min(cols, c + n + 1)):
                if (j - r) ** 2 + (i - c) ** 2 <= (reach / WAY_CELL) ** 2:
                    out[j, i] = True


@njit(cache=True)
def _shown(places, unseen, taken, top, ox, oy):
    """(n,) [m^2] of unseen ground, not taken yet, that places (n, 3) show: each part of a ray stands for its share of
    the disc."""
    out = np.zeros(len(places))
    for k in range(len(places)):
        out[k] = _look(places[k], unseen, taken, top, ox, oy, False)
    return out


@njit(cache=True)
def _look(place, unseen, taken, top, ox, oy, mark):
    rows, cols = unseen.shape
    step = 0.5 * WAY_CELL
    share = step * 2.0 * math.pi / SIGHT_RAYS
    total = 0.0
    for a in range(SIGHT_RAYS):
        dx, dy = math.cos(2.0 * math.pi * a / SIGHT_RAYS), math.sin(2.0 * math.pi * a / SIGHT_RAYS)
        for s in range(1, math.floor(SIGHT_RANGE / step) + 1):
            c = math.floor((place[0] + s * step * dx - ox) / WAY_CELL)
            r = math.floor((place[1] + s * step * dy - oy) / WAY_CELL)
            if r < 0 or c < 0 or r >= rows or c >= cols:
                continue
            if top[r, c] > place[2] + HIDING_HEIGHT:
                break
            if unseen[r, c] and not taken[r, c]:
                total += s * step * share
                if mark:
                    # the cells beside it too, or the gaps between far rays would count once more
                    for j in range(max(0, r - 1), min(rows, r + 2)):
                        for i in range(max(0, c - 1), min(cols, c + 2)):
                            if unseen[j, i]:
                                taken[j, i] = True
    return total
