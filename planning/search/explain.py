"""Why a route costs what it does: moments of all its pose sets, and the plan that tells them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from planning.risk.body import FEATURES, BodyModel, weights_of
from planning.risk.chance import Chance, chance
from planning.risk.cost import Weights, cost_of
from planning.risk.pose_sets import route_moments
from planning.risk.table import RiskTable
from planning.risk.terrain import Sampler
from planning.risk.turns import turn_cost
from planning.search.request import SETS, DriveRules, Plan, PlanRequest, Transition


@dataclass(slots=True)
class Route:
    """A sequence of nodes at places that may have been moved."""

    nodes: tuple[int, ...]
    xy: NDArray[np.float64]
    """(n, 2) [m]"""
    risk: NDArray[np.float64]
    """(n - 1,) native risk of the edges; a moved edge keeps that of the graph's."""
    flip: NDArray[np.bool_]
    """(n - 1,) edges that the search evaluates from their far end."""
    back: NDArray[np.bool_]
    """(n - 1,) edges driven backward."""
    rules: DriveRules
    start_yaw: float
    goal_yaw: float
    """[rad], NaN = any."""
    price: NDArray[np.float64]
    """(n - 1,) [m] of the edges beyond eq. 5, the way they are driven; a moved edge keeps that of the graph's."""
    turn_price: NDArray[np.float64]
    """(n, 2) [m/rad] of a bend and of a turn on the spot at each point."""
    moments: NDArray[np.float64]
    """(n - 1, 3, 3, 4), see `route_moments`; nothing before `evaluate`."""

    @classmethod
    def along(
        cls,
        table: RiskTable,
        start: int,
        states: NDArray[np.int64],
        start_yaw: float,
        goal_yaw: float,
        rules: DriveRules = DriveRules(),
    ) -> Route:
        """The route over these states (`planning.search.pairs`) from node `start`."""
        arcs = table.arcs
        slots = states // 2
        nodes = (start, *arcs.target[slots].tolist())
        xy = np.column_stack([arcs.x[list(nodes)], arcs.y[list(nodes)]])
        flip = slots > arcs.reverse[slots]
        return cls(
            nodes,
            xy,
            arcs.risk[slots].astype(np.float64),
            flip,
            states % 2 == 1,
            rules,
            start_yaw,
            goal_yaw,
            arcs.price[slots, states % 2].astype(np.float64),
            arcs.turn_price[list(nodes)].astype(np.float64),
            np.empty((len(slots), 3, 3, 4)),
        )

    def evaluate(self, sampler: Sampler, w: Weights, first: int, last: int) -> None:
        """Bring the moments of transitions first..last - 1 up to date with `xy`."""
        route_moments(
            sampler,
            w,
            self.xy,
            self.flip,
            self.back,
            self.start_yaw,
            self.goal_yaw,
            first,
            last,
            self.moments,
        )

    def yaws(self, first: int, last: int) -> NDArray[np.float64]:
        """(last - first + 2,) heading of the body [rad] before transition `first`, along each from there on, and after
        `last` - 1; NaN = any."""
        a, b = max(first - 1, 0), min(last + 1, len(self.risk))
        along = np.arctan2(*np.diff(self.xy[a : b + 1], axis=0).T[::-1]) + np.pi * self.back[a:b]
        before = [self.start_yaw] if first == 0 else []
        after = [self.goal_yaw] if last == len(self.risk) else []
        return np.concatenate([before, along, after])

    def length(self, first: int, last: int) -> NDArray[np.float64]:
        """(last - first,) [m] of transitions first..last - 1."""
        return np.hypot(*np.diff(self.xy[first : last + 1], axis=0).T)

    def turn_cost(self, first: int, last: int) -> NDArray[np.float64]:
        """(last - first,) [m] for each transition's turns."""
        turn = np.nan_to_num(wrap(np.diff(self.yaws(first, last))))  # NaN where no heading was asked for
        under = self.turn_price[first : last + 1].tolist()
        cost = np.array(
            [
                turn_cost(bend, spin, by, self.rules.turning)
                for (bend, spin), by in zip(under, turn.tolist(), strict=True)
            ]
        )
        if 0 < last == len(self.risk):
            cost[-2] += cost[-1]
        return cost[:-1]

    def terms(self, w: Weights, first: int, last: int, sweeps: bool = True) -> NDArray[np.float64]:
        """(last - first, 3, 2) B and U of each transition's pose sets, -1 where a set does not exist or does not
        count."""
        moments = self.moments[first:last]
        a = w.mean * moments[:, :, 0] + w.tail * moments[:, :, 1]
        out = np.stack([a[..., :3].sum(axis=-1), a[..., 3]], axis=-1)
        if not sweeps:
            out[:, 1:] = -1.0
        return np.nan_to_num(out, nan=-1.0)

    def cost(self, w: Weights, first: int = 0, last: int | None = None) -> NDArray[np.float64]:
        """(last - first,) [m] of each transition (eq. 5), and of its turns; all transitions if not told."""
        last = len(self.risk) if last is None else last
        b, u = self.terms(w, first, last).max(axis=1).T
        edges = cost_of(w, self.length(first, last), self.risk[first:last], b, u)
        return self.factor(first, last) * edges + self.price[first:last] + self.turn_cost(first, last)

    def factor(self, first: int, last: int) -> NDArray[np.float64]:
        """(last - first,) by which the direction makes each edge dearer."""
        return np.where(self.back[first:last], self.rules.backward, 1.0)


def with_chance(found: Plan, graph: TraversalGraph, grid: ElevationGrid) -> Plan:
    """The plan, told how likely it fails; the same plan where that is not known."""
    if not found.transitions:
        return replace(found, chance=Chance(0.0, (), ""))
    start, goal = (
        math.nan if yaw is None else yaw for yaw in (found.request.start_yaw, found.request.goal_yaw)
    )
    back = np.array([x.backward for x in found.transitions])
    goal = goal if found.reaches_goal else math.nan
    return replace(found, chance=chance(graph, grid, found.points[:, :2], back, start, goal))


def describe(
    nodes: NDArray[np.float64], request: PlanRequest, body: BodyModel, route: Route, expanded: int
) -> Plan:
    """The plan of a route over `nodes` (n, 3) under the weights of `body`."""
    w = weights_of(body)
    count = len(route.risk)
    length = route.length(0, count)
    terms = route.terms(w, 0, count, sweeps=request.variant != "edge-only")
    body_term, unknown_term = terms.max(axis=1).T
    native = cost_of(w, length, route.risk, 0.0, 0.0)
    full = route.factor(0, count) * cost_of(w, length, route.risk, body_term, unknown_term)
    cost = (native if request.variant == "native" else full) + route.price
    turns = (
        route.turn_cost(0, count) if request.variant not in ("native", "edge-only") else np.zeros(len(length))
    )
    transitions = []
    for t, moments in enumerate(route.moments.tolist()):
        sets = [(SETS[k], each) for k, each in enumerate(moments) if not math.isnan(each[0][0])]
        mean, tail, peak = (
            {name: dict(zip(FEATURES, each[m], strict=True)) for name, each in sets} for m in range(3)
        )
        transitions.append(
            Transition(
                (route.nodes[t], route.nodes[t + 1]),
                float(length[t]),
                float(route.risk[t]),
                float(body_term[t]),
                float(unknown_term[t]),
                float(cost[t] + turns[t]),
                float(turns[t]),
                float(route.price[t]),
                bool(route.back[t]),
                mean,
                tail,
                peak,
            )
        )
    points = nodes[list(route.nodes)].copy()
    points[:, :2] = route.xy
    return Plan(
        route.nodes,
        float(sum(t.cost for t in transitions)),
        float(native.sum()),
        float(length.sum()),
        tuple(transitions),
        points,
        request,
        expanded=expanded,
    )
