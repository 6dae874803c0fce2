"""Which frontier to drive to when the goal lies beyond known ground.

A frontier's worth is the cost to get there plus the shortest way from there to the goal that known obstacles leave
open, unknown ground counting as free: what is left can hardly be cheaper. (The straight line instead of that way sends
the robot into every dead end that points at the goal.) A frontier once chosen is kept until another is better by a clear
margin, so that a robot between two equal frontiers makes up its mind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.describe import RAYS
from planning.graph.fields import ENTERED
from planning.graph.flags import FACE, FIELD, VIRTUAL
from planning.graph.graph import TraversalGraph
from planning.search.request import Plan, PlanRequest
from planning.search.to_go import in_field

SAME_FRONTIER = 1.0
"""Frontier nodes within this distance [m] of the one chosen before count as the same frontier."""
BACK = 0.3
"""A frontier moves on as ground is seen: one that lies this much farther from the goal [m of the way to go] than the one chosen before is another."""
SWITCH_SHARE = 0.10
SWITCH_LEAST = 0.5
"""Another frontier must be better by this share of the kept one's worth and by at least this much [m]."""
LOOKED = 0.35
"""Frontier nodes within this distance [m] of the robot or of a place looked from already show nothing new. On a ramp it is the last 0.4 m to the crest that
show what lies behind it."""
ARRIVED = 0.3
"""This close to a frontier [m] the robot has seen what there is to see from it."""
BESIDE, PATIENCE = 1.5, 6.0
"""A node beside virtual ground may never be reached, as the way there may be virtual too. So long [s] within this distance of it [m], or
standing, the robot tries to see more."""
STANDS = 0.1
"""A robot that moved less [m] from one plan to the next stands."""
LONGEST = 2.0
"""Longest time [s] between two plans that counts: the goal may have been paused."""
BEGINS = 0.4
"""Virtual ground that begins farther than this [m] ahead of a body at a node is not looked at from there."""
FIELD_STEP = 0.1
"""A route is sampled so densely [m] for stepfields."""

UNSEEN = 0.5
"""A way to the goal of which more leads over ground that nobody saw [m] is not known to be one: frontiers are asked as well."""


class FrontierMemory:
    """What a robot on its way to one goal remembers of frontiers; goes into `PlanRequest` and is fed by its plans."""

    def __init__(self) -> None:
        self.chosen: tuple[float, float] | None = None
        """x, y [m] of the frontier on the way to."""
        self.seen: list[tuple[float, float]] = []
        """Places looked from already, and frontiers given up."""
        self.been: list[tuple[float, float]] = []
        """Places the robot planned from."""
        self.exhausted = False
        """No node was left, also none beside virtual ground: until a frontier is found again, which shows other ground, frontiers alone count."""
        self._tried: list[tuple[tuple[float, float], float]] = []
        """Nodes beside virtual ground, and how long [s] the robot tried to see more there."""
        self._last: tuple[tuple[float, float], float] | None = None

    def at(self, xy: tuple[float, float], now: float, *, virtual: bool = False) -> None:
        """The robot plans from x, y [m] at `now` [s]: what it has come to it has seen. `virtual`: `chosen` lies beside virtual ground."""
        last, self._last = self._last, (xy, now)
        if not self.been or math.dist(self.been[-1], xy) > ARRIVED:
            self.been.append(xy)
        if self.chosen is None:
            return
        far = math.dist(self.chosen, xy)
        if far < ARRIVED:
            self.seen.append(xy)
        elif virtual and last is not None and (far < BESIDE or math.dist(xy, last[0]) < STANDS):
            self._try(self.chosen, min(max(now - last[1], 0.0), LONGEST))

    def found(self, frontier: tuple[float, float] | None) -> None:
        """The newest plan leads to `frontier`, x, y [m]; None: to the goal."""
        self.chosen = frontier
        if frontier is not None:
            self.exhausted = False

    def _try(self, place: tuple[float, float], seconds: float) -> None:
        """Nodes of other samples stand beside the same ground: what is near counts as one."""
        same = [entry for entry in self._tried if math.dist(entry[0], place) <= LOOKED]
        spent = seconds + max((entry[1] for entry in same), default=0.0)
        self._tried = [entry for entry in self._tried if entry not in same] + [(place, spent)]
        if spent >= PATIENCE:
            self.seen.append(place)


def open_frontiers(graph: TraversalGraph, start: int, request: PlanRequest) -> NDArray[np.bool_]:
    """(n,) frontier nodes that are worth driving to from node `start`; where there are none, nodes beside virtual ground. Those around the
    frontier driven to so far count as well where no other frontier is near it: else the robot would turn away to a far one at each crest.

    The one that the robot is on its way to stays open until the robot has come to it.
    """
    previous = request.previous_frontier
    out = _far(graph, start, request.seen_frontiers, graph.frontier, previous)
    if request.been is None:
        return out
    beside = beside_virtual(graph, start, request)
    if not out.any():
        return beside
    if previous is None:
        return out
    near = np.hypot(*(graph.nodes[:, :2] - np.array(previous)).T) <= SAME_FRONTIER
    return out if (out & near).any() else out | (beside & near)


def beside_virtual(graph: TraversalGraph, start: int, request: PlanRequest) -> NDArray[np.bool_]:
    """(n,) nodes beside virtual ground where the robot has not been; none once these were exhausted. Places that are nodes of one query are none: the graph did not find
    them worth standing at."""
    if request.been is None:
        return np.zeros(len(graph.nodes), np.bool_)
    seen = (*request.seen_frontiers, *request.been)
    lasting = graph.node_ids >= 0
    return _far(graph, start, seen, _beside_virtual(graph) & lasting, request.previous_frontier)


def _beside_virtual(graph: TraversalGraph) -> NDArray[np.bool_]:
    """(n,) nodes from whose surroundings virtual ground begins: what lies behind a wall does not."""
    c = graph.cells
    if c is None:
        return np.zeros(len(graph.nodes), np.bool_)
    clear = 0.5 * graph.params.length
    return virtual_around(
        c.flags, *c.origin, c.res, np.ascontiguousarray(graph.nodes[:, :2]), clear, clear + BEGINS
    )


@njit(cache=True)
def virtual_around(flags, x0, y0, res, points, near, far):
    """(n,) whether one of sixteen rays from points (n, 2) [m] comes to virtual ground between `near` and `far` [m] and to no face before."""
    rows, cols = flags.shape
    out = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        for a in range(RAYS):
            ux, uy = math.cos(2.0 * math.pi * a / RAYS), math.sin(2.0 * math.pi * a / RAYS)
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


def fields_of(graph: TraversalGraph) -> NDArray[np.bool_] | None:
    """(rows, cols) of the graph's map: what lies in a stepfield with high posts; None where the graph knows no map."""
    return None if graph.cells is None else graph.cells.flags & FIELD > 0


def is_beside_virtual(graph: TraversalGraph, xy: tuple[float, float]) -> bool:
    """Whether the node at x, y [m] was looked for as one beside virtual ground; False where it is gone."""
    away = np.hypot(graph.nodes[:, 0] - xy[0], graph.nodes[:, 1] - xy[1])
    return bool(away.min(initial=np.inf) < 1e-3 and not graph.frontier[int(away.argmin())])


def _far(
    graph: TraversalGraph,
    start: int,
    seen: Sequence[tuple[float, float]],
    nodes: NDArray[np.bool_],
    previous: tuple[float, float] | None,
) -> NDArray[np.bool_]:
    """Those of `nodes` (n,) that are not near the start or a place looked from already."""

    def away(place: Sequence[float]) -> NDArray[np.float64]:
        return np.hypot(graph.nodes[:, 0] - place[0], graph.nodes[:, 1] - place[1])

    here = away(graph.nodes[start])
    out = here > LOOKED
    if previous is not None:
        out |= (away(previous) <= ARRIVED) & (here > ARRIVED)
    for place in seen:
        out &= away(place) > LOOKED
    return out & nodes


def same_frontier(
    nodes: NDArray[np.float64], to_go: NDArray[np.float64], previous: tuple[float, float]
) -> NDArray[np.bool_]:
    """(n,) which nodes (n, 2) may be the frontier at `previous` as it is now; `to_go` (n,) is the way from each [m]. From the mouth of a flat lane a robot went
    back to the rim of the stepfield beside it, 0.65 m away, as if that were the same frontier, and then into the field."""
    away = np.hypot(*(nodes - np.array(previous)).T)
    return (away <= SAME_FRONTIER) & (to_go <= to_go[int(away.argmin())] + BACK)


def worth_keeping(kept: float, best: float) -> bool:
    """Whether the frontier chosen before stays chosen although another is better; cost so far plus way to go [m]."""
    return kept - best < max(SWITCH_LEAST, SWITCH_SHARE * kept)


def enters_field(graph: TraversalGraph, points: NDArray[np.float64]) -> bool:
    """Whether a route over these points (n, >= 2) leads a robot outside of stepfields with high posts into one."""
    x, y = points[:, 0], points[:, 1]
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    along = np.linspace(0.0, s[-1], int(s[-1] / FIELD_STEP) + 2)
    inside = in_field(graph, np.column_stack([np.interp(along, s, x), np.interp(along, s, y)]))
    return bool(not inside[0] and inside.sum() * FIELD_STEP > ENTERED)


def over_unseen(plan: Plan) -> float:
    """[m] of a plan that at most lead over ground that nobody saw: each transition counts with the unseen share of its worst pose."""
    return sum(t.length * t.unknown for t in plan.transitions)


def in_doubt(graph: TraversalGraph, plan: Plan) -> bool:
    """Whether a plan to the goal is to be compared with frontiers."""
    return enters_field(graph, plan.points) or over_unseen(plan) > UNSEEN
