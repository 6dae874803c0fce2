"""Moving the inner points of a searched route to where the body stands better (beyond the paper).

The graph's nodes are samples; a few centimetres beside them the ground is often better. Inner points move in small
steps, one at a time, as long as the accumulated transition cost falls. The route stays on ground that was free and
seen: no higher face under the body, turns included, than the robot may climb (or than was there before), no more
unknown ground under any pose of a transition than before, never more than 1.02 times as long, and never worse than the
searched route in the largest support difference, side tilt or interference.
"""

from __future__ import annotations

import numpy as np

from planning.risk.body import edge_poses, sweep_poses, weights_of
from planning.risk.steps import steps_beneath
from planning.risk.table import RiskTable
from planning.search.explain import Route

LENGTH_GROWTH = 1.02
"""Most the length may grow."""
POINT_CORRIDOR = 0.20
"""Farthest a point may move from its node [m]."""
STEP_LENGTHS = (0.10, 0.05, 0.02)
"""Step lengths tried, coarse to fine [m]."""
MOST_ROUNDS = 4
"""Most passes over the route per step length."""
LEAST_GAIN = 1e-6
"""Least saving that counts [m]: below is rounding."""


def refine(table: RiskTable, route: Route) -> Route:
    """The route with its inner points moved; the same object when nothing is gained."""
    w, sampler = weights_of(table.body), table.sampler
    inner = len(route.xy) - 2
    if inner < 1:
        return route
    searched = route.xy.copy()
    budget = LENGTH_GROWTH * route.length(0, inner + 1).sum()
    core = _peaks(route)[:3]
    cost = route.cost(w)
    unknown = np.nanmax(route.moments[:, :, 2, 3], axis=1)
    face = _faces(table, route, 0, len(cost))
    limit = np.maximum(face, table.graph.params.max_step)
    circle = np.array([[np.cos(a), np.sin(a)] for a in np.arange(8) * np.pi / 4])
    for step in STEP_LENGTHS:
        for _ in range(MOST_ROUNDS):
            moved = False
            for i in range(1, inner + 1):
                # Moving point i changes the edges at it and the turns at it and at its neighbours.
                first, last = i - 1, min(i + 2, len(cost))
                here, saved = route.xy[i].copy(), route.moments[first:last].copy()
                best, best_xy = cost[first:last].sum() - LEAST_GAIN, here
                for offset in step * circle:
                    route.xy[i] = here + offset
                    if (
                        np.hypot(*(route.xy[i] - searched[i])) > POINT_CORRIDOR
                        or route.length(0, inner + 1).sum() > budget
                    ):
                        continue
                    route.evaluate(sampler, w, first, last)
                    if (
                        route.cost(w, first, last).sum() < best
                        and (_peaks(route)[:3] <= core).all()
                        and (
                            np.nanmax(route.moments[first:last, :, 2, 3], axis=1) <= unknown[first:last]
                        ).all()
                        and (_faces(table, route, first, last) <= limit[first:last]).all()
                    ):
                        best, best_xy = route.cost(w, first, last).sum(), route.xy[i].copy()
                route.xy[i] = best_xy
                if best_xy is here:
                    route.moments[first:last] = saved
                else:
                    route.evaluate(sampler, w, first, last)
                    cost[first:last] = route.cost(w, first, last)
                    moved = True
            if not moved:
                break
    return route


def _peaks(route: Route) -> np.ndarray:
    """(4,) largest feature values over the whole route."""
    return np.nanmax(route.moments[:, :, 2], axis=(0, 1))


def _faces(table: RiskTable, route: Route, first: int, last: int) -> np.ndarray:
    """(last - first,) highest face under the body along each edge and in the turn before it [m]."""
    out = np.empty(last - first)
    for t in range(first, last):
        poses = edge_poses(route.xy[t], route.xy[t + 1], table.body)
        if t > 0:
            x, y = route.xy[t]
            before, after = route.yaws(t, t).tolist()
            turn = sweep_poses(x, y, before, after, table.body)
            poses = np.concatenate([turn, poses])
        out[t - first] = steps_beneath(table.sampler, poses).max()
    return out
