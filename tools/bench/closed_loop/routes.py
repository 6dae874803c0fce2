"""The route of every method for a query, as the line that the tracker gets."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.robots import describe
from hal.scenes import Scene, load_scene
from planning.errors import NoRoute
from planning.graph import TraversalGraph
from planning.path import PathLimits, make_path, smooth_route
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from planning.search import DriveRules, Plan, PlanRequest, plan
from planning.search.door import planner_of
from rbtrg_robot.stage_config import GraphConfig, PlannerConfig
from tools.baselines.native import NativeParams, native_graph, snapped
from tools.bench.closed_loop.protocol import BASELINES, COMMANDED_SPEED, FACE_RISE, SHARED
from tools.bench.static.study import survey_grid

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Route:
    """What a method found for a query."""

    scene: str
    query: int
    method: str
    controller: str
    """Whose limits it was planned for; empty where the method knows none."""
    error: str = ""
    """Why there is no route."""
    line: list[list[float]] = field(default_factory=list)
    """x, y [m] of the line driven; its last point is the goal that counts."""
    speed: list[float] = field(default_factory=list)
    """[m/s] per point; empty: `COMMANDED_SPEED` everywhere."""
    least: list[float] = field(default_factory=list)
    """[m/s] per point, slowest speed that passes the ground there; empty: any."""
    yaw: list[float] = field(default_factory=list)
    """[rad] of the body per point; empty: along the line."""
    vertices: list[list[float]] = field(default_factory=list)
    """x, y [m] of the route over the graph."""
    length: float = 0.0
    """Of the line [m]."""
    wall: bool = False
    """The line crosses a face higher than `FACE_RISE`."""
    transitions: list[dict[str, float]] = field(default_factory=list)
    """Length, risk, body, unknown, cost of each edge."""


@lru_cache(maxsize=4)
def scene_of(name: str) -> Scene:
    """A scene, loaded once."""
    return load_scene(name)


def routes(scene: str, query: int, methods: list[str], controllers: list[str]) -> list[Route]:
    """Routes of a query. Graph seed is the number of the query."""
    out: list[Route] = []
    shared = [m for m in methods if m != "ours"]
    if shared:
        out += _on_one_graph(scene, query, shared)
    for controller in controllers if "ours" in methods else []:
        out.append(_as_it_drives(scene, query, controller))
    return out


def _on_one_graph(name: str, query: int, methods: list[str]) -> list[Route]:
    """The paper's variants on one native graph, between the nodes nearest to start and goal.

    Baselines plan between the same two places.
    """
    scene = scene_of(name)
    grid, body = survey_grid(scene), BodyModel()
    start, goal = scene.pairs[query]
    try:
        graph = native_graph(grid, scene.start[:2], NativeParams(), query)
        table = RiskTable(graph, grid, body)
        ends = snapped(graph, grid, start, goal)
    except NoRoute as none:
        return [Route(name, query, m, "", str(none)) for m in methods]
    out = []
    for method in methods:
        variant: Any = method if method in SHARED else "full"
        try:
            if method in BASELINES or ":" in method:
                a, b = ((float(x), float(y)) for x, y in graph.nodes[list(ends), :2])
                planner = planner_of(BASELINES.get(method, method))
                found = planner(grid, PlanRequest(a, b))
            else:
                found = plan(graph, grid, PlanRequest(*ends, variant=variant), body, table)
        except NoRoute as none:
            out.append(Route(name, query, method, "", str(none)))
            continue
        if len(found.points) < 2:
            out.append(Route(name, query, method, "", "start and goal share a node"))
            continue
        vertices = np.array(found.points[:, :2])
        line = make_path(found, grid, body).points[:, :2] if method == "guarded" else smooth_route(vertices)
        out.append(_route(scene, query, method, "", line, found))
    return out


def _as_it_drives(name: str, query: int, controller: str) -> Route:
    """As the planner process does it: corrected graph within the controller's limits, real endpoints, straight chords,
    backward where that costs less, the path with its guard, its speeds and its headings.
    """
    scene = scene_of(name)
    grid, body = survey_grid(scene), BodyModel()
    start, goal = scene.pairs[query]
    robot = describe().capabilities(controller)
    params = GraphConfig().params(robot, controller)
    limits = PathLimits(
        max_speed=COMMANDED_SPEED,
        max_step=params.max_step,
        max_slope=params.max_slope,
        step_speed=min(robot.step_vx, COMMANDED_SPEED),
    )
    rules = DriveRules(PlannerConfig().backward, PlannerConfig().turning, straight=True)
    try:
        graph = TraversalGraph.build(grid, start, params, query)
        found = plan(graph, grid, PlanRequest(start, goal, rules=rules), body)
    except NoRoute as none:
        return Route(name, query, "ours", controller, str(none))
    path = make_path(found, grid, body, limits)
    if len(path.points) < 2:
        return Route(name, query, "ours", controller, "start and goal are one place")
    route = _route(scene, query, "ours", controller, path.points[:, :2], found)
    return replace(route, speed=path.speed.tolist(), least=path.least.tolist(), yaw=path.yaw.tolist())


def _route(
    scene: Scene,
    query: int,
    method: str,
    controller: str,
    line: Array,
    found: Plan,
) -> Route:
    return Route(
        scene.name,
        query,
        method,
        controller,
        line=np.round(line, 5).tolist(),
        vertices=np.round(found.points[:, :2], 5).tolist(),
        length=float(np.hypot(*np.diff(line, axis=0).T).sum()),
        wall=crosses_wall(scene, line),
        transitions=[
            {k: float(getattr(t, k)) for k in ("length", "risk", "body", "unknown", "cost")}
            for t in found.transitions
        ],
    )


def crosses_wall(scene: Scene, line: Array) -> bool:
    """Whether the true ground under the line (n, 2) rises or falls by more than `FACE_RISE` within 4 cm."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.arange(0.0, s[-1], 0.01)
    x, y = np.interp(at, s, line[:, 0]), np.interp(at, s, line[:, 1])
    z = np.array([scene.z(px, py) for px, py in zip(x.tolist(), y.tolist(), strict=True)])
    return bool((np.abs(z[4:] - z[:-4]) > FACE_RISE).any())
