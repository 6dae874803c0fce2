"""Planning a route: request in, explained plan out (paper eq. 5 and Algorithm 1's query part)."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.graph.graph import TraversalGraph
from planning.risk.body import BodyModel, unseen_price, weights_of
from planning.risk.cost import Weights
from planning.risk.table import RiskTable
from planning.search.endpoints import Endpoints, endpoints, position
from planning.search.explain import Route, describe
from planning.search.frontier import frontiers, untried, with_hysteresis, worth_keeping
from planning.search.guarded import without
from planning.search.keep import kept
from planning.search.request import SETS, VARIANTS, Driven, DriveRules, Plan, PlanRequest, Transition, Variant
from planning.search.route_search import RouteSearch
from planning.search.straight import free_at, straighten, turn_at
from planning.search.to_go import fields_of, open_ground, way_to_go

__all__ = [
    "SETS",
    "VARIANTS",
    "DriveRules",
    "Driven",
    "Plan",
    "PlanRequest",
    "RiskTable",
    "Transition",
    "Variant",
    "plan",
]

NEARER_GOAL = 0.5
"""A place towards a goal that nothing leads to must be this much nearer to it [m], on the way there, than where the
robot stands: what blocks the way is judged from so far. With less the robot drove to and fro before a slope, and
against it."""
HELD_TURNS = 12
"""Searches for a way of whose turns the guard holds none."""


def plan(
    graph: TraversalGraph,
    grid: ElevationGrid,
    request: PlanRequest,
    body: BodyModel | None = None,
    table: RiskTable | None = None,
) -> Plan:
    """The cheapest route for `request`.

    `table` carries evaluations from earlier queries on the same graph, map and body; the result does not depend on it.
    A turn that the guard held (`PlanRequest.held`) is part of it only where there is no other way. Raises NoRoute with
    a reason when there is none, PlanningError when an argument makes no sense.
    """
    body = body or BodyModel()
    table = _table(graph, grid, body, table)
    start_yaw, goal_yaw = _check(grid, request)
    if any(request.held):
        with contextlib.suppress(NoRoute):
            return _searched(table, request, start_yaw, goal_yaw)
        request = replace(request, held=(False, False))
    return _searched(table, request, start_yaw, goal_yaw)


def _searched(table: RiskTable, request: PlanRequest, start_yaw: float, goal_yaw: float) -> Plan:
    """The route that a search finds, or what is left of the one that is driven."""
    ends = endpoints(table, request)
    arcs = ends.table.arcs
    found = _best(ends, request, start_yaw, goal_yaw)
    if found is None and request.rules.guarded:
        # The guard sees a little more or less from where the robot will stand: better a turn that it may hold than no
        # way.
        ends.table.arcs = arcs
        request = replace(request, rules=replace(request.rules, guarded=False))
        found = _best(ends, request, start_yaw, goal_yaw)
    if found is not None and request.driven is not None:
        found = kept(ends, request, found, start_yaw, goal_yaw if found.reaches_goal else np.nan)
    ends.close()
    if found is None:
        raise NoRoute(
            NoRouteReason.NO_ROUTE,
            "no way over known ground leads to the goal, or only by turns for which there is no room"
            + (", and no frontier is left to look from" if request.allow_frontier else "")
            + ": choose another goal, or clear the way",
        )
    return found


def _best(at: Endpoints, request: PlanRequest, start_yaw: float, goal_yaw: float) -> Plan | None:
    """The plan to the goal; the one to a frontier where that is clearly better or there is no other; else one towards
    the goal."""
    found = None if at.goal is None else _to_goal(at, request, start_yaw, goal_yaw)
    if not request.allow_frontier:
        return found
    arcs, goal = at.table.arcs, position(at.table.graph, request.goal, "goal")
    straight = math.hypot(arcs.x[at.start] - goal[0], arcs.y[at.start] - goal[1])
    w = weights_of(at.table.body)
    if found is None or not worth_keeping(_bare(found, w), straight):
        other = _to_frontier(at, request, start_yaw, goal, alone=found is None)
        # What is still to go from a frontier knows neither body nor turns, so the way to the goal counts without, too.
        if found is None or (other is not None and not worth_keeping(_bare(found, w), _bare(other, w))):
            found = other
    if found is None and at.seen:
        found = _to_nearest(at, request, start_yaw)
    return found


def _bare(plan: Plan, w: Weights) -> float:
    """[m] all the way to the goal, without the body's risk and turns."""
    crossed = sum(t.price + w.unknown * t.length * t.unknown for t in plan.transitions)
    return plan.native_cost + crossed + plan.to_go


def _table(graph: TraversalGraph, grid: ElevationGrid, body: BodyModel, table: RiskTable | None) -> RiskTable:
    if table is None:
        return RiskTable(graph, grid, body)
    if not table.fits(graph, grid, body):
        raise PlanningError("the risk table belongs to another graph, map or body: make a new one")
    return table


def _check(grid: ElevationGrid, request: PlanRequest) -> tuple[float, float]:
    """Both yaws as floats (NaN = any) of a request whose fields make sense."""
    if not grid.trusted.any():
        raise NoRoute(NoRouteReason.NO_TERRAIN, "the map holds no trusted cell yet: wait for the first scans")
    if request.variant not in VARIANTS:
        raise PlanningError(f"variant must be one of {', '.join(VARIANTS)}; got {request.variant!r}")
    yaws = []
    for name, yaw in (("start_yaw", request.start_yaw), ("goal_yaw", request.goal_yaw)):
        if yaw is not None and not np.isfinite(yaw):
            raise NoRoute(NoRouteReason.BAD_INPUT, f"{name} is {yaw}: give radians, or None for any heading")
        yaws.append(np.nan if yaw is None else float(yaw))
    return yaws[0], yaws[1]


def _to_goal(at: Endpoints, request: PlanRequest, start_yaw: float, goal_yaw: float) -> Plan | None:
    """The plan to a node, None when it is not connected to the start."""
    arcs = at.table.arcs
    ends = np.zeros(len(arcs.x), np.bool_)
    ends[at.goal] = True
    xy = (float(arcs.x[at.goal]), float(arcs.y[at.goal]))
    found = _search(at, request, ends, np.zeros(len(ends)), xy, start_yaw, goal_yaw)
    return None if found is None else replace(found, short=at.short)


def _to_frontier(
    at: Endpoints, request: PlanRequest, start_yaw: float, goal: tuple[float, float], *, alone: bool
) -> Plan | None:
    """The plan to the frontier with the least cost so far plus way to go (see `planning.search.frontier`). `alone`: no
    way leads to the goal."""
    graph = at.table.graph
    nodes = graph.nodes[:, :2]
    ends = frontiers(graph, at.start, request)
    # Where known ground alone lies between all of them and what hides the goal, they show nothing of the way there.
    ground = open_ground(at.table.grid, goal)
    if alone and not np.isfinite(way_to_go(at.table.grid, nodes, goal, nodes, ground=ground)[ends]).any():
        return None
    way = way_to_go(at.table.grid, nodes, goal, fields=fields_of(graph), ground=ground)
    return _nearer(at, request, start_yaw, goal, ends & np.isfinite(way), way)


def _nearer(
    at: Endpoints,
    request: PlanRequest,
    start_yaw: float,
    goal: tuple[float, float],
    ends: NDArray[np.bool_],
    way: NDArray[np.float64],
) -> Plan | None:
    """The plan to one of the `ends` (n,) with the least cost so far plus way to go, `way` (n,) [m]."""
    price, nodes = unseen_price(at.table.body), at.table.graph.nodes
    way = np.where(ends, way, 0.0)
    left = price * with_hysteresis(nodes, way, goal, request.previous_frontier)
    best = _search(at, request, ends, left, goal, start_yaw, np.nan)
    if best is None:
        return None
    x, y, _ = best.points[-1]
    rest = price * float(way[best.nodes[-1]])
    return replace(best, reaches_goal=False, frontier=(float(x), float(y)), to_go=rest)


def _to_nearest(at: Endpoints, request: PlanRequest, start_yaw: float) -> Plan | None:
    """The plan towards a seen goal that nothing leads to: what blocks it from afar may be the map's error.

    Towards is along the way that walls leave open, so that the robot comes to what blocks it, not to the wall that the
    goal lies behind. From near it is judged: where the robot was already it does not go again, and where no place is
    left the plan ends for good.
    """
    graph = at.table.graph
    goal = position(graph, request.goal, "goal")
    way = way_to_go(at.table.grid, graph.nodes, goal, fields=fields_of(graph))
    ends = untried(graph, at.start, request) & (way < way[at.start] - NEARER_GOAL)
    if (found := _nearer(at, request, start_yaw, goal, ends, way)) is not None:
        return found
    here = _to_goal(replace(at, goal=at.start), request, start_yaw, np.nan)
    return None if here is None else replace(here, short=float(way[at.start]))


def _search(
    at: Endpoints,
    request: PlanRequest,
    ends: NDArray[np.bool_],
    exit_cost: NDArray[np.float64],
    xy: tuple[float, float],
    start_yaw: float,
    goal_yaw: float,
) -> Plan | None:
    """Run the variant's search from a node to the best of the end nodes. A turn that the guard holds is taken out, and
    the search run again."""
    body = at.table.body
    if request.variant == "mean-only":
        body = body.model_copy(update={"weight_mean": 1.0, "weight_tail": 0.0})
    search = RouteSearch(at, request, body, ends, exit_cost, xy, start_yaw, goal_yaw)
    for _ in range(HELD_TURNS):
        found = search.cheapest()
        if found is None:
            return None
        if not _take_out_held(at, found):
            break
    else:
        return None
    found.evaluate(at.table.sampler, weights_of(at.table.body), 0, len(found.risk))
    if request.rules.straight and at.ground is not None:
        straighten(at.ground, at.table, found)
    return describe(at.table.graph.nodes, request, body, found, search.expanded)


def _take_out_held(at: Endpoints, route: Route) -> bool:
    """Whether the guard holds turns of a route; the graph has no room for these any more."""
    if at.ground is None or not route.rules.guarded:
        return False
    held = False
    room = at.table.arcs.room.copy()  # the bounds of the search know the old one
    for k, node in enumerate(route.nodes):
        (yaw, turn), free = turn_at(route, k), free_at(at.ground, route, k)
        if free < abs(turn):
            room[node], held = without(room[node], yaw, turn, free), True
    if held:
        at.table.arcs = at.table.arcs._replace(room=room)
    return held
