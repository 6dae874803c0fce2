"""Where to look from when the way to the goal leads over ground that nobody saw.

A frontier is a node beside such ground. A plan may end at one; its value is the cost to come there plus what is still
to go from there (`planning.search.to_go`), where a metre of unseen ground costs what it costs on the graph. So a way to
the goal over unseen ground and a way to a frontier are compared by the same price.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.describe import FRONTIER_RAYS
from planning.graph.flags import FACE, VIRTUAL
from planning.graph.graph import TraversalGraph
from planning.search.request import PlanRequest

LOOKED_FROM = 0.30
"""[m] Around a place where the robot was, or that it gave up, no frontier is left. On a ramp the last 0.4 m to the
crest show what lies behind it. Around a frontier that showed nothing when the robot came to it none is left within
`SAME_FRONTIER`: the rim of a pit is as dark from the next place on it."""
SHOWN_SHARE = 0.2
"""Of the ground around a frontier that nobody had seen when it was chosen: less is nothing."""
SAME_FRONTIER = 1.0
"""[m] Frontiers this near to the one driven to are the same one: it moves on as ground is seen."""
SWITCH_SHARE, SWITCH_LEAST = 0.10, 0.5
"""Another end must be better than the one driven to by this share and by at least so much [m]: a robot between two
equal ones makes up its mind."""
GIVE_UP_AFTER = 6.0
"""[s] on the way to a frontier without coming nearer to it: the ground before it cannot be seen, or not be driven."""
NEARER_WAY = 0.1
"""[m] of the way to it."""
LONGEST_PAUSE = 2.0
"""[s] between two plans, at most, that count: the goal may have been paused."""


@dataclass(slots=True)
class _Attempt:
    """To come to a frontier."""

    place: tuple[float, float]
    dark: float
    """Share of the ground around it that nobody had seen."""
    least: float
    """[m] of the way to it so far."""
    seconds: float = 0.0
    """Since it was less."""


@dataclass(slots=True)
class Tried:
    """Where a robot on its way to one goal has looked from, and what it gave up."""

    places: list[tuple[float, float, float]] = field(default_factory=list)
    """x, y, radius [m]; goes into `PlanRequest.tried`."""
    chosen: tuple[float, float] | None = None
    """x, y [m] of the frontier on the way to."""
    _attempts: list[_Attempt] = field(default_factory=list)
    _last: float | None = None

    def at(self, xy: tuple[float, float], grid: ElevationGrid | None) -> None:
        """The robot plans from x, y [m]: what can be seen from there is in the `grid`."""
        if all(math.dist(place[:2], xy) > 0.5 * LOOKED_FROM for place in self.places):
            self.places.append((*xy, LOOKED_FROM))
        if self.chosen is None or math.dist(self.chosen, xy) > LOOKED_FROM or grid is None:
            return
        here = self._attempt(self.chosen)
        if here is not None and _dark(grid, here.place) > (1.0 - SHOWN_SHARE) * here.dark:
            self.places.append((*self.chosen, SAME_FRONTIER))
            self._attempts.remove(here)

    def found(
        self, frontier: tuple[float, float] | None, way: float, now: float, grid: ElevationGrid | None
    ) -> None:
        """The plan of `now` [s] leads to `frontier`, x, y [m], on a way of `way` [m]; None: to the goal."""
        passed = 0.0 if self._last is None else min(max(now - self._last, 0.0), LONGEST_PAUSE)
        self._last, self.chosen = now, frontier
        if frontier is None or grid is None:
            return
        here = self._attempt(frontier)
        if here is None:
            self._attempts.append(_Attempt(frontier, _dark(grid, frontier), way))
        elif way < here.least - NEARER_WAY:
            here.least, here.seconds = way, 0.0
        else:
            here.seconds += passed
            if here.seconds >= GIVE_UP_AFTER:
                self.places.append((*frontier, LOOKED_FROM))
                self._attempts.remove(here)

    def _attempt(self, frontier: tuple[float, float]) -> _Attempt | None:
        """The one to come to this frontier, wherever it was then."""
        near = [a for a in self._attempts if math.dist(a.place, frontier) <= SAME_FRONTIER]
        return min(near, key=lambda a: math.dist(a.place, frontier), default=None)


def _dark(grid: ElevationGrid, place: tuple[float, float]) -> float:
    """Share of the ground within `SAME_FRONTIER` of x, y [m] that nobody saw."""
    n = round(SAME_FRONTIER / grid.resolution)
    c, r = (round((place[k] - grid.origin[k]) / grid.resolution) for k in (0, 1))
    seen = grid.trusted[max(0, r - n) : max(0, r + n + 1), max(0, c - n) : max(0, c + n + 1)]
    return 1.0 - float(seen.sum()) / (2 * n + 1) ** 2


def frontiers(graph: TraversalGraph, start: int, request: PlanRequest) -> NDArray[np.bool_]:
    """(n,) nodes beside ground that no ray came to, away from node `start` and from where the robot looked already;
    where there are none, those beside virtual ground."""
    left = untried(graph, start, request)
    dark = graph.frontier & left
    # Places of one query are none: the graph did not find them worth standing at.
    return dark if dark.any() else beside_virtual(graph) & (graph.node_ids >= 0) & left


def untried(graph: TraversalGraph, start: int, request: PlanRequest) -> NDArray[np.bool_]:
    """(n,) nodes away from node `start` and from where the robot looked already."""
    nodes = graph.nodes[:, :2]
    left = np.ones(len(nodes), np.bool_)
    for x, y, radius in ((*nodes[start].tolist(), LOOKED_FROM), *request.tried):
        left &= np.hypot(nodes[:, 0] - x, nodes[:, 1] - y) > radius
    return left


def with_hysteresis(
    nodes: NDArray[np.float64],
    to_go: NDArray[np.float64],
    goal: tuple[float, float],
    previous: tuple[float, float] | None,
) -> NDArray[np.float64]:
    """`to_go` (n,) [m] of nodes (n, >= 2), the longer the less they are the frontier driven to at x, y [m]."""
    if previous is None:
        return to_go
    away, far = (np.hypot(nodes[:, 0] - x, nodes[:, 1] - y) for x, y in (previous, goal))
    other = np.minimum(away / SAME_FRONTIER, 1.0)
    return to_go + other * np.maximum(SWITCH_LEAST, SWITCH_SHARE * far)


def worth_keeping(kept: float, best: float) -> bool:
    """Whether what was chosen stays chosen although another is better; cost so far plus way to go [m]."""
    return kept - best < max(SWITCH_LEAST, SWITCH_SHARE * kept)


def beside_virtual(graph: TraversalGraph) -> NDArray[np.bool_]:
    """(n,) nodes before whose body, within a ring of the graph, virtual ground begins: what lies behind a wall does
    not."""
    c = graph.cells
    if c is None:
        return np.zeros(len(graph.nodes), np.bool_)
    clear = 0.5 * graph.params.length
    points = np.ascontiguousarray(graph.nodes[:, :2])
    return virtual_around(c.flags, *c.origin, c.res, points, clear, clear + graph.params.expand_dist)


@njit(cache=True)
def virtual_around(flags, x0, y0, res, points, near, far):
    """(n,) whether one of sixteen rays from points (n, 2) [m] comes to virtual ground between `near` and `far` [m] and
    to no face before."""
    rows, cols = flags.shape
    out = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        for a in range(FRONTIER_RAYS):
            ux, uy = math.cos(2.0 * math.pi * a / FRONTIER_RAYS), math.sin(2.0 * math.pi * a / FRONTIER_RAYS)
            for k in range(1, math.floor(far / res) + 1):
                c = math.floor((points[i, 0] + k * res * ux - x0) / res + 0.5)
                r = math.floor((points[i, 1] + k * res * uy - y0) / res + 0.5)
                if r < 0 or c < 0 or r >= rows or c >= cols or flags[r, c] & FACE:
                    break
                if k * res > near and flags[r, c] & VIRTUAL:
                    out[i] = True
                    break
            if out[i]:
                break
    return out
