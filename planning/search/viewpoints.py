"""Where a robot that explores looks from next: places at the edge of what it has seen, what each shows, and the order to visit them.

A place is a frontier node of the graph, so the robot can come there. What it shows is the ground nobody saw that lies within `SIGHT` and behind
no wall; places are taken one after the other, each with what the ones before it leave (a greedy cover). The order is the shortest way over all of
them and, where the robot returns, home: the nearest place first leaves crumbs behind for which the robot comes back. Nothing is remembered here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.flags import FACE, UNSEEN_RAW
from planning.graph.graph import TraversalGraph
from planning.search.to_go import least_way

Array = NDArray[np.float64]
RASTER = 0.2
"""[m] Cells on which sight is judged."""
SIGHT = 4.0
"""[m] A LiDAR on the back sees ground densely enough for the map within this distance."""
RAYS = 72
HIGH = 0.4
"""[m] A face whose upper side is so much above the place hides the ground behind it."""
LEAST = 0.5
"""[m^2] A place that shows less is not driven to."""
MOST = 24
"""Places are ordered, at most; the others come later."""
ALIKE = 0.9
"""Of places that show at least this share of the most, the nearest is taken."""
BARRED = 0.75
"""[m] around a place given up there is no other one."""
SAME = 1.5
"""[m] The place driven to moves on as ground is seen: the nearest one within this distance of it is the same."""
SWITCH_SHARE, SWITCH_LEAST = 0.1, 1.0
"""Another place comes first only where the whole way is shorter by this share and by this much [m]."""
BESIDE = 1.0
"""[m] A robot farther than this from every node stands on no graph."""
FAR = 0.6
"""[m] Seen ground farther than this from every node is ground that no way leads to."""
EDGE = 1.0
"""[m] A shorter edge of the seen ground, where no way leads to, is not told."""


@dataclass(frozen=True, slots=True)
class Survey:
    """What is explored from where. x, y [m] in the grid's frame."""

    start: tuple[float, float]
    area: Array | None = None
    """(n, 2) corners; None: everything that can be reached."""
    home: tuple[float, float] | None = None
    """Where the way ends; None: at the last place."""
    target: tuple[float, float] | None = None
    """The place that is driven to now."""
    barred: Array | None = None
    """(n, 2) places given up."""
    greedy: bool = False
    """The nearest place first, kept until it is seen, as plain explorers do; for comparison."""


@dataclass(frozen=True, slots=True)
class Viewpoints:
    """Places in the order in which they are visited, and how much is seen."""

    xy: Array
    """(n, 2) [m]."""
    gain: Array
    """(n,) ground that each shows beside those that show more [m^2]."""
    way: Array
    """(n,) cost of the way from the robot [m]."""
    seen: float
    """[m^2] of the area that was seen and that the robot can come to."""
    hidden: float
    """[m^2] of the area that may lie behind the places; all that unseen ground joins to them, where there is an area."""
    home: float
    """Cost of the way from the robot home [m]; infinite where the graph has none, NaN where no home was named."""
    unreachable: Array
    """(m, 2) middles [m] of edges of the seen ground to which no way leads."""

    @property
    def coverage(self) -> float:
        """Share of the ground that can be expected within reach that was seen."""
        return self.seen / max(self.seen + self.hidden, 1e-9)


def viewpoints(graph: TraversalGraph, grid: ElevationGrid, survey: Survey, sigma: float) -> Viewpoints:
    """`graph` on `grid`; `sigma`: what the native risk of a metre counts. The graph must know its map (`TraversalGraph.cells`)."""
    assert graph.cells is not None
    nodes = graph.nodes
    edge = np.repeat(np.arange(len(nodes)), np.diff(graph.indptr))
    length = np.hypot(*(nodes[edge, :2] - nodes[graph.indices, :2]).T)
    cost = length * (1.0 + sigma * graph.risk)
    targets = graph.indices.astype(np.int64)

    def ways(place: tuple[float, float]) -> Array:
        """(n,) cost from the node nearest to a place to each node; infinite where none is near."""
        away = np.hypot(*(nodes[:, :2] - place).T)
        first = np.full(len(nodes), np.inf)
        near = int(away.argmin())
        if away[near] > BESIDE:
            return first
        first[near] = away[near]
        return np.asarray(least_way(graph.indptr, targets, cost, first))

    raster = _Raster.of(graph, grid, survey.area)
    way = ways(survey.start)
    may = graph.frontier & np.isfinite(way) & raster.holds(nodes[:, :2])
    for place in () if survey.barred is None else survey.barred:
        may &= np.hypot(*(nodes[:, :2] - place).T) > BARRED
    chosen, gain = _cover(nodes, np.flatnonzero(may), way, raster)
    between = np.array([ways((nodes[k, 0], nodes[k, 1]))[chosen] for k in chosen]).reshape(
        len(chosen), len(chosen)
    )
    back = np.zeros(len(nodes)) if survey.home is None else ways(survey.home)
    home = math.nan if survey.home is None else float(ways(survey.start)[_nearest(nodes, survey.home)])
    to_home = np.where(np.isfinite(back[chosen]), back[chosen], 0.0)
    kept = _same(nodes[chosen, :2], survey.target)
    if survey.greedy:
        order = np.argsort(way[chosen], kind="stable")
        order = order if kept < 0 else np.r_[kept, order[order != kept]]
    else:
        order = _ordered(way[chosen], between, to_home, kept)
    chosen, gain = chosen[order], gain[order]
    return Viewpoints(
        nodes[chosen, :2].copy(),
        gain,
        way[chosen],
        raster.seen_near(nodes),
        raster.hidden(gain.sum(), survey.area is not None),
        home,
        raster.unreachable(nodes),
    )


def _nearest(nodes: Array, place: tuple[float, float]) -> int:
    return int(np.hypot(*(nodes[:, :2] - place).T).argmin())


def _same(xy: Array, target: tuple[float, float] | None) -> int:
    """The place that `target` is now, or -1."""
    if target is None or not len(xy):
        return -1
    away = np.hypot(*(xy - target).T)
    return int(away.argmin()) if away.min() <= SAME else -1


@dataclass(slots=True)
class _Raster:
    """The area, or the map and `SIGHT` around it, in cells of `RASTER`."""

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
    def of(cls, graph: TraversalGraph, grid: ElevationGrid, area: Array | None) -> _Raster:
        """From the flags that the graph has of its map."""
        assert graph.cells is not None
        flags, res = graph.cells.flags, graph.cells.res
        x0, y0 = graph.cells.origin
        rows, cols = flags.shape
        low = np.array([x0, y0]) - SIGHT
        high = np.array([x0 + cols * res, y0 + rows * res]) + SIGHT
        if area is not None:
            low, high = np.maximum(low, area.min(axis=0)), np.minimum(high, area.max(axis=0))
        shape = tuple(np.maximum(np.ceil((high - low) / RASTER).astype(int), 1)[::-1])
        origin = (float(low[0]), float(low[1]))
        seen, top = np.zeros(shape, np.bool_), np.full(shape, -np.inf, np.float32)
        _reduce(flags, grid.height, x0 - 0.5 * res, y0 - 0.5 * res, res, *origin, seen, top)
        inside = np.ones(shape, np.bool_)
        if area is not None:
            y, x = np.mgrid[0 : shape[0], 0 : shape[1]] * RASTER + 0.5 * RASTER
            inside = _inside(x + origin[0], y + origin[1], area)
        ground = seen & ~np.isfinite(top)
        return cls(origin, inside & ~seen, inside & ground, top, np.zeros(shape, np.bool_))

    def cells(self, xy: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Row and column of places (n, 2), clipped, and which lie on the raster."""
        c, r = (np.floor((xy[:, k] - self.origin[k]) / RASTER).astype(np.int64) for k in (0, 1))
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

    def seen_near(self, nodes: Array) -> float:
        """[m^2] seen and within reach of the robot."""
        return float((self.seen & self.near(nodes, 0.5)).sum()) * RASTER**2

    def hidden(self, shown: float, bounded: bool) -> float:
        """[m^2] that may be seen yet: what the places show, and in an area all unseen ground joined to it."""
        if not bounded:
            return shown
        return float(_joined(self.taken.copy(), self.unseen).sum()) * RASTER**2

    def unreachable(self, nodes: Array) -> Array:
        """(m, 2) middles [m] of edges between seen ground far from every node and unseen ground."""
        edge = np.zeros(self.seen.shape, np.bool_)
        edge[:-1] |= self.unseen[1:]
        edge[1:] |= self.unseen[:-1]
        edge[:, :-1] |= self.unseen[:, 1:]
        edge[:, 1:] |= self.unseen[:, :-1]
        edge &= self.seen & ~self.near(nodes, FAR)
        found = []
        while edge.any():
            one = np.zeros_like(edge)
            one[tuple(np.argwhere(edge)[0])] = True
            whole = _joined(one, edge)
            edge &= ~whole
            rc = np.argwhere(whole)
            if len(rc) * RASTER >= EDGE:
                r, c = rc[len(rc) // 2]
                found.append((self.origin[0] + (c + 0.5) * RASTER, self.origin[1] + (r + 0.5) * RASTER))
        return np.array(found).reshape(-1, 2)


def _inside(x: Array, y: Array, corners: Array) -> NDArray[np.bool_]:
    """Whether places lie in a polygon (n, 2), by the parity of edges to the right of them."""
    out = np.zeros(x.shape, np.bool_)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if ay != by:
            out ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return out


def _cover(
    nodes: Array, candidates: NDArray[np.int64], way: Array, raster: _Raster
) -> tuple[NDArray[np.int64], Array]:
    """Nodes chosen one after the other, and what each shows [m^2]."""
    chosen: list[int] = []
    gains: list[float] = []
    places = np.ascontiguousarray(nodes[candidates])
    while len(chosen) < MOST and len(places):
        gain = _shown(places, raster.unseen, raster.taken, raster.top, *raster.origin)
        if gain.max() < LEAST:
            break
        like = np.flatnonzero(gain >= ALIKE * gain.max())
        best = int(like[way[candidates[like]].argmin()])
        chosen.append(int(candidates[best]))
        gains.append(float(gain[best]))
        _take(places[best], raster.unseen, raster.taken, raster.top, *raster.origin)
        left = gain >= LEAST  # what is shown only gets less
        left[best] = False
        candidates, places = candidates[left], places[left]
    return np.array(chosen, np.int64), np.array(gains)


def _ordered(first: Array, between: Array, last: Array, kept: int) -> NDArray[np.int64]:
    """The shortest way found over all places: `first` (n,) from the robot, `between` (n, n), `last` (n,) home [m]. Place `kept` (-1: none) stays first
    unless another order is clearly shorter."""
    if not len(first):
        return np.empty(0, np.int64)
    order = _tour(first, between, last, -1)
    if kept >= 0 and order[0] != kept:
        other = _tour(first, between, last, kept)
        best, same = _length(order, first, between, last), _length(other, first, between, last)
        if same - best < max(SWITCH_LEAST, SWITCH_SHARE * best):
            order = other
    return np.asarray(order)


@njit(cache=True)
def _length(order, first, between, last):
    """[m] of the whole way."""
    total = first[order[0]] + last[order[-1]]
    for k in range(1, len(order)):
        total += between[order[k - 1], order[k]]
    return total


@njit(cache=True)
def _tour(first, between, last, fixed):
    """Insert each place where it costs least, then reverse and move stretches while that shortens the way. `fixed` stays first where it is no -1."""
    n = len(first)
    order = np.empty(n, np.int64)
    count = 0
    used = np.zeros(n, np.bool_)
    begin = fixed if fixed >= 0 else int(first.argmin())
    order[0] = begin
    used[begin] = True
    count = 1
    low = 1 if fixed >= 0 else 0
    while count < n:
        best, who, where = np.inf, -1, -1
        for k in range(n):
            if used[k]:
                continue
            for at in range(low, count + 1):
                before = first[k] if at == 0 else between[order[at - 1], k]
                after = last[k] if at == count else between[k, order[at]]
                gone = 0.0
                if at == count:
                    gone = last[order[count - 1]]
                elif at == 0:
                    gone = first[order[0]]
                else:
                    gone = between[order[at - 1], order[at]]
                if before + after - gone < best:
                    best, who, where = before + after - gone, k, at
        for j in range(count, where, -1):
            order[j] = order[j - 1]
        order[where] = who
        used[who] = True
        count += 1
    now = _length(order, first, between, last)
    better = True
    while better:
        better = False
        for a in range(low, n):
            for b in range(a, n):
                other = order.copy()
                other[a : b + 1] = order[a : b + 1][::-1]
                length = _length(other, first, between, last)
                if length < now - 1e-6:
                    order, now, better = other, length, True
                rest = np.concatenate((order[:a], order[b + 1 :]))
                for at in range(low, len(rest) + 1):
                    other = np.concatenate((rest[:at], order[a : b + 1], rest[at:]))
                    length = _length(other, first, between, last)
                    if length < now - 1e-6:
                        order, now, better = other, length, True
                        break
    return order


@njit(cache=True)
def _reduce(flags, height, x0, y0, res, ox, oy, seen, top):
    """Cells of the map into those of the raster: seen where more than half of them were, `top` of faces."""
    rows, cols = seen.shape
    count = np.zeros((rows, cols), np.int32)
    known = np.zeros((rows, cols), np.int32)
    for r in range(flags.shape[0]):
        j = math.floor((y0 + (r + 0.5) * res - oy) / RASTER)
        if j < 0 or j >= rows:
            continue
        for c in range(flags.shape[1]):
            i = math.floor((x0 + (c + 0.5) * res - ox) / RASTER)
            if i < 0 or i >= cols:
                continue
            count[j, i] += 1
            if not flags[r, c] & UNSEEN_RAW:
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
    n = math.ceil(reach / RASTER)
    for k in range(len(places)):
        c = math.floor((places[k, 0] - ox) / RASTER)
        r = math.floor((places[k, 1] - oy) / RASTER)
        for j in range(max(0, r - n), min(rows, r + n + 1)):
            for i in range(max(0, c - n), min(cols, c + n + 1)):
                if (j - r) ** 2 + (i - c) ** 2 <= (reach / RASTER) ** 2:
                    out[j, i] = True


@njit(cache=True)
def _shown(places, unseen, taken, top, ox, oy):
    """(n,) [m^2] of unseen ground, not taken yet, that places (n, 3) show: each part of a ray stands for its share of the disc."""
    out = np.zeros(len(places))
    for k in range(len(places)):
        out[k] = _look(places[k], unseen, taken, top, ox, oy, False)
    return out


@njit(cache=True)
def _take(place, unseen, taken, top, ox, oy):
    """Mark what a place shows."""
    _look(place, unseen, taken, top, ox, oy, True)


@njit(cache=True)
def _look(place, unseen, taken, top, ox, oy, mark):
    rows, cols = unseen.shape
    step = 0.5 * RASTER
    share = step * 2.0 * math.pi / RAYS
    total = 0.0
    for a in range(RAYS):
        dx, dy = math.cos(2.0 * math.pi * a / RAYS), math.sin(2.0 * math.pi * a / RAYS)
        for s in range(1, math.floor(SIGHT / step) + 1):
            c = math.floor((place[0] + s * step * dx - ox) / RASTER)
            r = math.floor((place[1] + s * step * dy - oy) / RASTER)
            if r < 0 or c < 0 or r >= rows or c >= cols:
                continue
            if top[r, c] > place[2] + HIGH:
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


@njit(cache=True)
def _joined(some, ground):
    """`some` (rows, cols) and what is joined to it over `ground`, diagonals included."""
    rows, cols = some.shape
    stack = [(0, 0) for _ in range(0)]
    for r in range(rows):
        for c in range(cols):
            if some[r, c]:
                stack.append((r, c))
    while stack:
        r, c = stack.pop()
        for j in range(max(0, r - 1), min(rows, r + 2)):
            for i in range(max(0, c - 1), min(cols, c + 2)):
                if ground[j, i] and not some[j, i]:
                    some[j, i] = True
                    stack.append((j, i))
    return some
