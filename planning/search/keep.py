"""Keeping the route that is driven: what is left of it stays unless the new one is clearly better.

Two searches on almost the same map from places a step apart find routes that cost almost the same and look different. A
robot that changes between them turns instead of driving.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from planning.risk.body import BodyModel, weights_of
from planning.risk.terrain import Sampler
from planning.search.attach import SAME_PLACE, XY, Ground, there
from planning.search.endpoints import Endpoints
from planning.search.explain import Route, describe
from planning.search.frontier import worth_keeping
from planning.search.request import Plan, PlanRequest
from planning.search.straight import has_room


def kept(at: Endpoints, request: PlanRequest, found: Plan, start_yaw: float, goal_yaw: float) -> Plan:
    """The rest of `request.driven` where it leads to where `found` leads, can still be driven and costs little more;
    else `found`."""
    if at.ground is None or not len(found.transitions):
        return found
    nodes, body = at.table.graph.nodes, at.table.body
    ends, places = (found.nodes[0], found.nodes[-1]), (_xy(found.points[0]), _xy(found.points[-1]))
    route = rest(at.ground, at.table.sampler, body, nodes, request, ends, places, start_yaw, goal_yaw)
    if route is None or not worth_keeping(float(route.cost(weights_of(body)).sum()), found.cost):
        return found
    same = {name: getattr(found, name) for name in ("reaches_goal", "frontier", "to_go", "short", "expanded")}
    return replace(describe(nodes, request, body, route, 0), **same, kept=True)


def _xy(point: NDArray[np.float64]) -> XY:
    return float(point[0]), float(point[1])


def rest(
    ground: Ground,
    sampler: Sampler,
    body: BodyModel,
    nodes: NDArray[np.float64],
    request: PlanRequest,
    ends: tuple[int, int],
    places: tuple[XY, XY],
    start_yaw: float,
    goal_yaw: float,
) -> Route | None:
    """The rest of `request.driven` as a route between two of the `nodes` (n, 3), `ends` at `places` [m], tested and
    evaluated on the map of now; None where it cannot be driven or ends elsewhere."""
    driven = request.driven
    if driven is None:
        return None
    here, end = places
    legs = [((float(x), float(y)), bool(b)) for (x, y), b in zip(driven.points, driven.back, strict=True)]
    if len(legs) > 1 and math.dist(here, legs[0][0]) <= SAME_PLACE:
        legs = legs[1:]
    xy = np.array([here, *(place for place, _ in legs)])
    if math.dist(legs[-1][0], end) > SAME_PLACE or not ground.may_join(xy):
        return None
    back = np.array([b for _, b in legs])
    moves = ground.moves(xy)
    if moves[-1, 0] < 0.0:
        return None
    near = KDTree(nodes[:, :2]).query(xy[1:-1])[1].tolist()  # what the points are called
    count = len(legs)
    route = Route(
        (ends[0], *near, ends[1]),
        xy,
        moves[:, 0].astype(np.float64),
        np.zeros(count, np.bool_),
        back,
        request.rules,
        start_yaw,
        goal_yaw,
        there(moves, back),
        ground.turn_prices(xy).astype(np.float64),
        np.empty((count, 3, 3, 4)),
    )
    if not all(has_room(ground, route, k) for k in range(len(xy))):
        return None
    route.evaluate(sampler, weights_of(body), 0, count)
    return route
