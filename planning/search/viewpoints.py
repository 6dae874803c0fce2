"""Where a robot that explores looks from next: places at the edge of what it has seen, what each shows, and the order
to visit them.

A place is a node of the graph beside ground that nobody saw, so the robot can come there. What it shows is such ground
that lies within `SIGHT` and behind no wall; places are taken one after the other, each with what the ones before it
leave (a greedy cover). The order is the shortest way over all of them and, where the robot returns, home: the nearest
place first leaves crumbs behind for which the robot comes back. Nothing is remembered here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from planning.search.frontier import beside_virtual, worth_keeping
from planning.search.sight import Sight

Array = NDArray[np.float64]
LEAST_GAIN = 0.5
"""[m^2] A place that shows less is not driven to."""
MOST_PLACES = 24
"""Places are ordered, at most; the others come later."""
ALIKE_SHARE = 0.9
"""Of places that show at least this share of the most, the nearest is taken."""
BARRED_RADIUS = 0.75
"""[m] around a place given up there is no other one."""
SAME_VIEWPOINT = 1.5
"""[m] The place driven to moves on as ground is seen: the nearest one within this distance of it is the same."""
BESIDE_GRAPH = 1.0
"""[m] A robot farther than this from every node stands on no graph."""


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
    """[m^2] of the area that may lie behind the places; all that unseen ground joins to them, where there is an
    area."""
    home: float
    """Cost of the way from the robot home [m]; infinite where the graph has none, NaN where no home was named."""
    unreachable: Array
    """(m, 2) middles [m] of edges of the seen ground to which no way leads."""

    @property
    def coverage(self) -> float:
        """Share of the ground that can be expected within reach that was seen."""
        return self.seen / max(self.seen + self.hidden, 1e-9)


def viewpoints(graph: TraversalGraph, grid: ElevationGrid, survey: Survey, sigma: float) -> Viewpoints:
    """`graph` on `grid`; `sigma`: what the native risk of a metre counts. The graph must know its map
    (`TraversalGraph.cells`)."""
    assert graph.cells is not None
    nodes = graph.nodes
    away, homeward = graph.costs(sigma), graph.costs(sigma, back=True)

    def ways(place: tuple[float, float], cost: Array = away) -> Array:
        """(n,) cost from the node nearest to a place to each node, or with `homeward` from each to it; infinite where
        none is near."""
        apart = np.hypot(*(nodes[:, :2] - place).T)
        near = int(apart.argmin())
        return (
            np.full(len(nodes), np.inf)
            if apart[near] > BESIDE_GRAPH
            else apart[near] + graph.ways(cost, near)
        )

    sight = Sight.of(graph, grid, survey.area)
    way = ways(survey.start)
    may = (graph.frontier | beside_virtual(graph)) & np.isfinite(way) & sight.holds(nodes[:, :2])
    for place in () if survey.barred is None else survey.barred:
        may &= np.hypot(*(nodes[:, :2] - place).T) > BARRED_RADIUS
    chosen, gain = _cover(nodes, np.flatnonzero(may), way, sight)
    between = np.array([ways((nodes[k, 0], nodes[k, 1]))[chosen] for k in chosen]).reshape(
        len(chosen), len(chosen)
    )
    back = np.zeros(len(nodes)) if survey.home is None else ways(survey.home, homeward)
    home = math.nan if survey.home is None else float(way[_nearest(nodes, survey.home)])
    to_home = np.where(np.isfinite(back[chosen]), back[chosen], 0.0)
    kept = _same(nodes[chosen, :2], survey.target)
    order = _ordered(way[chosen], between, to_home, kept)
    chosen, gain = chosen[order], gain[order]
    return Viewpoints(
        nodes[chosen, :2].copy(),
        gain,
        way[chosen],
        sight.seen_near(nodes),
        sight.hidden(gain.sum(), survey.area is not None),
        home,
        sight.unreachable(nodes),
    )


def _nearest(nodes: Array, place: tuple[float, float]) -> int:
    return int(np.hypot(*(nodes[:, :2] - place).T).argmin())


def _same(xy: Array, target: tuple[float, float] | None) -> int:
    """The place that `target` is now, or -1."""
    if target is None or not len(xy):
        return -1
    away = np.hypot(*(xy - target).T)
    return int(away.argmin()) if away.min() <= SAME_VIEWPOINT else -1


def _cover(
    nodes: Array, candidates: NDArray[np.int64], way: Array, sight: Sight
) -> tuple[NDArray[np.int64], Array]:
    """Nodes chosen one after the other, and what each shows [m^2]."""
    chosen: list[int] = []
    gains: list[float] = []
    places = np.ascontiguousarray(nodes[candidates])
    while len(chosen) < MOST_PLACES and len(places):
        gain = sight.shown(places)
        if gain.max() < LEAST_GAIN:
            break
        like = np.flatnonzero(gain >= ALIKE_SHARE * gain.max())
        best = int(like[way[candidates[like]].argmin()])
        chosen.append(int(candidates[best]))
        gains.append(float(gain[best]))
        sight.take(places[best])
        left = gain >= LEAST_GAIN  # what is shown only gets less
        left[best] = False
        candidates, places = candidates[left], places[left]
    return np.array(chosen, np.int64), np.array(gains)


def _ordered(first: Array, between: Array, last: Array, kept: int) -> NDArray[np.int64]:
    """The shortest way found over all places: `first` (n,) from the robot, `between` (n, n), `last` (n,) home [m].
    Place `kept` (-1: none) stays first unless another order is clearly shorter."""
    if not len(first):
        return np.empty(0, np.int64)
    order = _tour(first, between, last, -1)
    if kept >= 0 and order[0] != kept:
        other = _tour(first, between, last, kept)
        best, same = _length(order, first, between, last), _length(other, first, between, last)
        if worth_keeping(same, best):
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
    """Insert each place where it costs least, then reverse and move stretches while that shortens the way. `fixed`
    stays first where it is no -1."""
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
    other, rest = np.empty(n, np.int64), np.empty(n, np.int64)
    better = True
    while better:
        better = False
        for a in range(low, n):
            for b in range(a, n):
                for j in range(n):
                    other[j] = order[a + b - j] if a <= j <= b else order[j]
                length = _length(other, first, between, last)
                if length < now - 1e-6:
                    now, better = length, True
                    for j in range(n):
                        order[j] = other[j]
                many = b + 1 - a
                for j in range(n - many):
                    rest[j] = order[j] if j < a else order[j + many]
                for at in range(low, n - many + 1):
                    for j in range(n):
                        if j < at:
                            other[j] = rest[j]
                        else:
                            other[j] = order[a + j - at] if j < at + many else rest[j - many]
                    length = _length(other, first, between, last)
                    if length < now - 1e-6:
                        now, better = length, True
                        for j in range(n):
                            order[j] = other[j]
                        break
    return order
