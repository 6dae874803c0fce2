"""Checking a request and putting its start and goal on the graph, as nodes of their own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.graph.fields import OBSTACLE_FACE
from planning.graph.graph import SNAP_DISTANCE, TraversalGraph
from planning.risk.table import RiskTable
from planning.search.attach import SAME_PLACE, Ground, Spot, attached, dear_to_turn
from planning.search.request import Place, PlanRequest


@dataclass(slots=True)
class Endpoints:
    """Where a query begins and ends, as nodes of `table.graph`."""

    table: RiskTable
    start: int
    goal: int | None
    """None: a frontier has to do."""
    short: float = 0.0
    """[m] from the goal node to the goal asked for."""
    seen: bool = False
    """The goal without a node lies on seen ground and in no obstacle."""
    ground: Ground | None = None
    """What tests a move beside the graph's edges; None on graphs that cannot."""
    _origin: RiskTable | None = None

    def close(self) -> None:
        """Keep what the query evaluated."""
        if self._origin is not None:
            self._origin.take_back(self.table)


def endpoints(table: RiskTable, request: PlanRequest) -> Endpoints:
    """Start and goal of a request. Raises NoRoute when they make no sense or the robot can go nowhere from its start.

    Positions become nodes themselves (`planning.search.attach`), where the graph knows its map; on another one they
    have to be nodes, but for a goal beyond it.
    """
    graph, grid = table.graph, table.grid
    start_xy, goal_xy = position(graph, request.start, "start"), position(graph, request.goal, "goal")
    nodes = is_node(request.start), is_node(request.goal)
    if not graph.knows(grid) or all(nodes):
        if not nodes[0] or not (nodes[1] or request.allow_frontier):
            raise PlanningError("a graph that was not built on this map knows ways between its nodes alone")
        return Endpoints(table, int(request.start), int(request.goal) if nodes[1] else None)  # type: ignore[arg-type]
    if not is_node(request.start):
        _require_on_map(grid, start_xy, "start")
    yaw = math.nan if request.start_yaw is None else request.start_yaw
    ground = Ground(graph, grid, None if is_node(request.start) else (*start_xy, yaw), request.held)
    new: list[Spot] = []
    start, goal, short, seen = len(graph.nodes), None, 0.0, False
    if is_node(request.start):
        start = int(request.start)  # type: ignore[arg-type]
    else:
        spot = ground.spot(start_xy)
        few = not len(spot.nodes) or dear_to_turn(graph, grid, (*start_xy, yaw))
        new = [*(ground.ahead(start_xy, yaw) if few else []), spot]
        start += len(new) - 1
    if is_node(request.goal):
        goal = int(request.goal)  # type: ignore[arg-type]
    elif math.dist(start_xy, goal_xy) <= SAME_PLACE:
        goal = start
    else:
        if not request.allow_frontier:
            _require_on_map(grid, goal_xy, "goal")
        end = ground.end_near(goal_xy, SNAP_DISTANCE) if on_map(grid, goal_xy) else None
        if end is None and new and ground.move(start_xy, goal_xy) is not None:
            end = goal_xy
        if end is None:
            seen = _judge(graph, grid, goal_xy, request.allow_frontier)
        else:
            short = math.dist(end, goal_xy)
            goal = len(graph.nodes) + len(new)
            new.append(ground.spot(end))
            if len(new) > 1:
                new[-1].from_start = ground.move(start_xy, end)
    way_out = is_node(request.start) or any(spot.from_start is not None for spot in new)
    if not way_out and not len(new[start - len(graph.nodes)].nodes) and goal != start:
        raise NoRoute(
            NoRouteReason.START_NOT_ON_GRAPH,
            f"no straight move leads from where the robot stands ({start_xy[0]:.2f}, {start_xy[1]:.2f}) to drivable "
            "ground: drive it by hand, slowly, onto open ground that it sees",
        )
    query, kept = attached(graph, grid, new, start)
    return Endpoints(
        table.for_query(query, kept),
        start,
        goal,
        short,
        seen,
        ground,
        table,
    )


def is_node(place: object) -> bool:
    """True for a node index, False for a position."""
    return isinstance(place, (int, np.integer)) and not isinstance(place, bool)


def position(graph: TraversalGraph, place: Place, name: str) -> tuple[float, float]:
    """x, y [m] of a place. Raises NoRoute for anything else than a node index or two finite numbers."""
    if is_node(place):
        if not 0 <= place < len(graph.nodes):  # type: ignore[operator]
            raise NoRoute(NoRouteReason.BAD_INPUT, f"{name} node {place} is not in 0..{len(graph.nodes) - 1}")
        x, y = graph.nodes[place, :2]  # type: ignore[index]
        return float(x), float(y)
    try:
        x, y = (float(v) for v in place)  # type: ignore[union-attr]
    except (TypeError, ValueError):
        raise NoRoute(
            NoRouteReason.BAD_INPUT, f"{name} must be x, y in metres or a node index; got {place!r}"
        ) from None
    if not (np.isfinite(x) and np.isfinite(y)):
        raise NoRoute(NoRouteReason.BAD_INPUT, f"{name} ({x}, {y}) is not finite: give x, y in metres")
    return x, y


def on_map(grid: ElevationGrid, xy: tuple[float, float]) -> bool:
    """True when x, y lies in a cell of the grid."""
    x0, y0, x1, y1 = grid.extent
    half = grid.resolution / 2
    return x0 - half <= xy[0] <= x1 + half and y0 - half <= xy[1] <= y1 + half


def ground_at(
    grid: ElevationGrid, xy: tuple[float, float], max_step: float, radius: float, coverage: float
) -> str:
    """The ground within `radius` of x, y, lengths in m: `unseen` where less than `coverage` of it is trusted, `blocked`
    by a face above `max_step`, or `free`."""
    if not on_map(grid, xy):
        return "unseen"
    reach = int(np.ceil(radius / grid.resolution))
    (c,), (r,) = _cells(grid, np.array([xy[0]]), np.array([xy[1]]))
    rows = slice(max(r - reach, 0), r + reach + 1)
    cols = slice(max(c - reach, 0), c + reach + 1)
    z, ok = grid.height[rows, cols], grid.trusted[rows, cols]
    dr, dc = np.mgrid[
        rows.start - r : rows.start - r + z.shape[0], cols.start - c : cols.start - c + z.shape[1]
    ]
    disc = dr**2 + dc**2 <= (radius / grid.resolution) ** 2
    if ok[disc].mean() < coverage:
        return "unseen"
    for axis in (0, 1):
        step = np.abs(np.diff(np.where(ok & disc, z, np.nan), axis=axis))
        if np.nanmax(step, initial=0.0) > max_step:
            return "blocked"
    return "free"


def _cells(
    grid: ElevationGrid, x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    col = np.floor((x - grid.origin[0]) / grid.resolution + 0.5).astype(np.int64)
    row = np.floor((y - grid.origin[1]) / grid.resolution + 0.5).astype(np.int64)
    return np.clip(col, 0, grid.shape[1] - 1), np.clip(row, 0, grid.shape[0] - 1)


def _judge(graph: TraversalGraph, grid: ElevationGrid, xy: tuple[float, float], allow_frontier: bool) -> bool:
    """What a goal is that no node is near to. -> True: seen and no obstacle; False: not seen. Raises NoRoute for the
    rest."""
    where = f"the goal ({xy[0]:.2f}, {xy[1]:.2f})"
    p = graph.params
    ground = ground_at(grid, xy, p.max_step, p.robot_size, p.min_coverage)
    inside = ground_at(grid, xy, max(OBSTACLE_FACE, p.max_step), 0.5 * p.width, p.min_coverage)
    if ground == inside == "blocked":
        raise NoRoute(
            NoRouteReason.GOAL_IN_OBSTACLE,
            f"{where} is in a known obstacle, no drivable node within {SNAP_DISTANCE:.2f} m: move it to free ground",
        )
    if allow_frontier:
        return ground != "unseen"
    if ground == "unseen":
        raise NoRoute(
            NoRouteReason.GOAL_UNKNOWN, f"the ground at {where} was not seen yet: allow a frontier or move it"
        )
    raise NoRoute(
        NoRouteReason.NOT_CONNECTED,
        f"no drivable node within {SNAP_DISTANCE:.2f} m of {where}: move it to ground the robot can reach",
    )


def _require_on_map(grid: ElevationGrid, xy: tuple[float, float], name: str) -> None:
    if not on_map(grid, xy):
        x0, y0, x1, y1 = grid.extent
        raise NoRoute(
            NoRouteReason.OUTSIDE_MAP,
            f"{name} ({xy[0]:.2f}, {xy[1]:.2f}) is outside the map, x {x0:.2f}..{x1:.2f}, y {y0:.2f}..{y1:.2f} m: "
            "move it inside, or extend the map",
        )
