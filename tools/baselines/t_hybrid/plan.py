"""A route by T-Hybrid for the planner's own requests."""

from __future__ import annotations

import math

import numpy as np

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason
from planning.search import Plan, PlanRequest
from planning.search.door import as_plan
from tools.baselines.route import places
from tools.baselines.t_hybrid.params import THybridParams
from tools.baselines.t_hybrid.search import EXHAUSTED, FOUND, HEADING_COUNT, risk_at, search
from tools.baselines.t_hybrid.smooth import smooth
from tools.baselines.t_hybrid.terrain import HybridMap, assess


def plan(
    grid: ElevationGrid,
    request: PlanRequest,
    params: THybridParams | None = None,
    terrain: HybridMap | None = None,
) -> Plan:
    """The route for `request` between two positions. Without a start yaw it begins at any heading; without a goal yaw
    the bearing from
    start to goal guides the search. `terrain`: the assessment of this map, where there is one.

    Raises NoRoute, also when the budget is used up: the release then drives a partial path, the paper counts an
    abstention.
    """
    p = params or THybridParams()
    start, goal = places(grid, request)
    terrain = terrain or assess(grid, p)
    a, b = (
        np.array([(x - terrain.origin[0]) / p.cell, (y - terrain.origin[1]) / p.cell])
        for x, y in (start, goal)
    )
    bearing = math.atan2(b[1] - a[1], b[0] - a[0])
    guide = bearing if request.goal_yaw is None else request.goal_yaw
    headings = (
        np.arange(HEADING_COUNT) * 2.0 * math.pi / HEADING_COUNT + 1e-6
        if request.start_yaw is None
        else np.array([request.start_yaw % (2.0 * math.pi)])
    )
    for name, at, reason in (
        ("start", a, NoRouteReason.START_NOT_ON_GRAPH),
        ("goal", b, NoRouteReason.GOAL_IN_OBSTACLE),
    ):
        # An endpoint must be traversable; at which heading is the search's to tell.
        risk = risk_at(terrain.flag, terrain.rough, terrain.normal, at[0], at[1], 0.0, np.pi, np.pi, 0.0)
        if not np.isfinite(risk):
            raise NoRoute(reason, f"T-Hybrid finds no traversable ground at the {name}: choose another")
    outcome, poses, cost, pops = search(
        terrain.flag,
        terrain.rough,
        terrain.normal,
        terrain.occupied,
        np.column_stack([np.tile(a, (len(headings), 1)), headings]),
        np.array([*b, guide]),
        0.5 * p.length / p.cell,
        0.5 * p.width / p.cell,
        p.max_pitch,
        p.max_roll,
        p.risk_floor,
        p.budget,
        p.released_quirks,
    )
    if outcome == EXHAUSTED:
        raise NoRoute(
            NoRouteReason.NO_ROUTE,
            f"T-Hybrid used up its {p.budget} pops: choose a nearer goal, or another planner",
        )
    if outcome != FOUND:
        raise NoRoute(
            NoRouteReason.NO_ROUTE, "T-Hybrid finds no way: choose another goal, or another planner"
        )
    cells = smooth(poses, terrain.occupied)
    xy = np.vstack([cells * p.cell + terrain.origin, goal])
    return as_plan(grid, request, xy, cost * p.cell, int(pops))
