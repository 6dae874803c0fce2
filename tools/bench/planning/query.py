"""Planning times of queries, full variant; `planning` prints these rows with its own.

Least CPU time of this thread over repeats. `query_ms` finds nothing cached: it makes the risk table and evaluates what
it needs. `replan_ms` does the same after 2 % of the cells changed, once from nothing (its baseline) and once with the
table from before. `sample_ns` is the time of a pose over all samples of the footprint, also those that a tile's ceiling
made needless to look at. Baselines, from the same run, are plain numpy (`tools.bench.planning.reference`): its time per
sample, and per query its time per pose times the poses that an eager search evaluates, every edge and every turn of the
states it expands.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from hal.rotation import wrap
from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason
from planning.graph.graph import GraphParams, TraversalGraph
from planning.path import PathLimits
from planning.risk.body import BodyModel, terrain_of
from planning.risk.footprint import poses_features
from planning.risk.table import RiskTable
from planning.search.plan import PlanRequest, plan
from rbtrg_robot import msg
from rbtrg_robot.config import load
from rbtrg_robot.hosts.memory import keep_what_is_loaded
from rbtrg_robot.stage_config import PlannerConfig
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.stages.planner import build
from rbtrg_robot.stages.way import WaySearch
from tools.bench.planning import reference
from tools.bench.planning.worlds import dense_map
from tools.bench.report import Report

BODY = BodyModel()
PAIR_COUNT, UPDATE_COUNT = 200, 60


def partly_unseen(grid: ElevationGrid) -> ElevationGrid:
    """The grid with 6 % of its cells untrusted in patches: the case that costs most per sample."""
    rng = np.random.default_rng(5)
    trusted = grid.trusted.copy()
    side = round(0.24 / grid.resolution)
    while trusted.mean() > 0.94:
        r, c = (int(rng.integers(0, n - side)) for n in grid.shape)
        trusted[r : r + side, c : c + side] = False
    return ElevationGrid(grid.height, trusted, grid.origin, grid.resolution)


def eager_poses(table: RiskTable, states: int) -> float:
    """Poses of a search that expands `states` pairs and evaluates every edge and turn out of them."""
    arcs = table.arcs
    degree = np.diff(arcs.indptr)
    slot = np.repeat(np.arange(len(arcs.target)), degree[arcs.target])
    row = np.concatenate([[0], np.cumsum(degree[arcs.target])])
    out = np.arange(len(slot)) - row[slot] + arcs.indptr[arcs.target[slot]]
    turn = np.abs(wrap(arcs.heading[out] - arcs.heading[slot]))
    per_turn = np.ceil(turn / np.radians(BODY.sweep_step)).mean() + 1
    per_edge = np.ceil(arcs.length / BODY.edge_step).mean() + 1
    return float(states * degree.mean() * per_turn + min(states, len(arcs.target) / 2) * per_edge)


def _pairs(graph: TraversalGraph, grid: ElevationGrid) -> list[PlanRequest]:
    """Random start-goal pairs between which a way leads: which do, depends on the last bits of a processor."""
    rng = np.random.default_rng(7)
    out: list[PlanRequest] = []
    for _ in range(10 * PAIR_COUNT):
        a, b = (int(v) for v in rng.integers(0, len(graph.nodes), 2))
        if a == b:
            continue
        with contextlib.suppress(NoRoute):
            plan(graph, grid, PlanRequest(a, b), BODY)
            out.append(PlanRequest(a, b))
            if len(out) == PAIR_COUNT:
                return out
    raise NoRoute(NoRouteReason.NO_ROUTE, "few nodes of the map can be reached: take another map")


def _replan(report: Report) -> None:
    """The same pairs of places after each map update, with and without the table from before."""
    full, start, _, seed = dense_map()
    grid = partly_unseen(full)
    graph = TraversalGraph.build(grid, start, GraphParams(), seed)
    rng = np.random.default_rng(11)
    side = round(np.sqrt(0.02) * grid.shape[0])
    table = RiskTable(graph, grid, BODY)
    fresh, carried = [], []
    level, raised = grid.height, (0, 0, 0, 0)
    for _ in range(UPDATE_COUNT):
        r, c = (int(v) for v in rng.integers(0, grid.shape[0] - side, 2))
        height = (
            level.copy()
        )  # what was raised before sinks again: raised twice, an edge of a window may close the way
        height[r : r + side, c : c + side] += np.float32(0.03)
        grid = ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)
        before, raised = raised, (r, c, r + side, c + side)
        graph.update(grid, [before, raised])
        request = PlanRequest(0, _far(graph, grid))
        fresh.append(_timed(lambda g=grid, q=request: plan(graph, g, q, BODY)))  # type: ignore[misc]
        began = time.thread_time()
        table = RiskTable(graph, grid, BODY, table)
        plan(graph, grid, request, BODY, table)
        carried.append(time.thread_time() - began)
    report.add("replan_ms", 1e3 * float(np.median(carried)), "ms", baseline=1e3 * float(np.median(fresh)))


def _far(graph: TraversalGraph, grid: ElevationGrid) -> int:
    """The node farthest from the first one to which a way leads: edges may lead to others, by turns for which there is
    no room."""
    away = np.hypot(*(graph.nodes[:, :2] - graph.nodes[0, :2]).T)
    table = RiskTable(graph, grid, BODY)
    for node in np.argsort(-away, kind="stable").tolist():
        with contextlib.suppress(NoRoute):
            plan(graph, grid, PlanRequest(0, node), BODY, table)
            return int(node)
    raise NoRoute(NoRouteReason.NO_ROUTE, "no node of the map can be reached: take another map")


def rows(report: Report, large: RiskTable) -> None:
    """Add the rows of 200 random pairs on the 8 m dense map and of one query across the large one."""
    full, start, params, seed = dense_map()
    graph = TraversalGraph.build(full, start, params, seed)
    grid = partly_unseen(full)
    rng = np.random.default_rng(7)
    requests = _pairs(graph, grid)
    times = [min(_timed(lambda r=r: plan(graph, grid, r, BODY)) for _ in range(3)) for r in requests]  # type: ignore[misc]
    states = [plan(graph, grid, r, BODY).expanded for r in requests[::10]]
    # Poses along edges, as a query meets them.
    some = graph.edges[rng.integers(0, len(graph.edges), 400)]
    t = np.linspace(0.0, 1.0, 10)[:, None, None]
    a_xy, b_xy = graph.nodes[some[:, 0], :2], graph.nodes[some[:, 1], :2]
    yaw = np.tile(np.arctan2(*(b_xy - a_xy).T[::-1]), (10, 1))
    poses = (
        np.concatenate([(1 - t) * a_xy + t * b_xy, yaw[..., None]], axis=2).transpose(1, 0, 2).reshape(-1, 3)
    )
    sampler = terrain_of(grid, BODY).sampler(BODY.length, BODY.width)
    fast = min(_timed(lambda: poses_features(sampler, poses)) for _ in range(9)) / len(poses)
    few = poses[::20]
    plain = _timed(lambda: [reference.features(grid, p, BODY) for p in few]) / len(few)
    eager = 1e3 * plain * eager_poses(RiskTable(graph, grid, BODY), int(np.median(states)))
    report.add("query_ms.p50", 1e3 * float(np.percentile(times, 50)), "ms", limit=15.0, baseline=eager)
    report.add("query_ms.p95", 1e3 * float(np.percentile(times, 95)), "ms", limit=40.0)
    samples = sampler.u.size
    report.add("sample_ns", 1e9 * fast / samples, "ns", limit=1.5, baseline=1e9 * plain / samples)
    _replan(report)
    x0, y0, x1, y1 = large.grid.extent
    nodes = large.graph.nodes[:, :2]
    ends = [int(np.argmin(np.hypot(*(nodes - corner).T))) for corner in ((x0, y0), (x1, y1))]
    across = PlanRequest(ends[0], ends[1])
    report.add(
        "large.query_s", _timed(lambda: plan(large.graph, large.grid, across, BODY, large)), "s", limit=0.5
    )
    report.add("large.query_cold_s", _timed(lambda: plan(large.graph, large.grid, across, BODY)), "s")
    stack_rows(report, large)


def stack_rows(report: Report, large: RiskTable) -> None:
    """What the planner stage does for one answer on the large map, by its own code (`WaySearch.find`): table, query
    with turns that the guard asks, path, and the part of it that is driven. The map has been taken already and the
    kernels are compiled.

    `prepared`: the first goal of a new process that has prepared for the map (`MapGraph.prepare`), as it does before
    one comes. `cold`: the same where the goal comes with the map, and no edge is evaluated. `warm`: the next answers to
    this goal, the robot at the same place, each after an update of 2 x 2 m; the update of the graph has a row of its
    own. `moving`: the robot 1 m on along its path each time, and the updates within 4 m of it.
    """
    grid, graph = large.grid, large.graph
    x0, y0, x1, y1 = grid.extent
    ends = [
        graph.nodes[int(np.argmin(np.hypot(*(graph.nodes[:, :2] - corner).T))), :2]
        for corner in ((x0, y0), (x1, y1))
    ]
    (x, y), goal = (float(v) for v in ends[0]), ends[1]
    message = msg.PlanRequest(
        start_x=x + 0.06, start_y=y, goal_x=float(goal[0]) + 0.06, goal_y=float(goal[1]), goal_id="across"
    )
    terrain, ways, driven = MapGraph(graph.params, BODY, graph.seed), _ways(), None

    def answer() -> None:
        nonlocal driven
        driven = ways.find(terrain, message, driven, 0).whole

    build(load(None, [])).warm_up()
    keep_what_is_loaded()
    terrain.grid, terrain.graph, terrain.table = grid, graph, large
    report.add("large.stack_prepared_s", _timed(answer), "s", limit=1.0)
    terrain.table, driven, ways = None, None, _ways()
    report.add("large.stack_cold_s", _timed(answer), "s")
    rng = np.random.default_rng(3)
    for key, moves in (("warm", False), ("moving", True)):
        times, updates = [], []
        for _ in range(5):
            r, c = (int(v) for v in rng.integers(0, grid.shape[0] - 40, 2))
            if moves:
                assert driven is not None
                at = int(np.searchsorted(driven.s, 1.0))
                (message.start_x, message.start_y), message.start_yaw = (
                    driven.points[at, :2].tolist(),
                    float(driven.yaw[at]),
                )
                col, row = (
                    (v - o) / grid.resolution for v, o in zip(driven.points[at], grid.origin, strict=False)
                )
                r, c = (
                    int(np.clip(v + rng.integers(-80, 40), 0, n - 40))
                    for v, n in zip((row, col), grid.shape, strict=True)
                )
            height = grid.height.copy()
            height[r : r + 40, c : c + 40] += np.float32(0.02)
            grid = ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)
            window = (r, c, r + 40, c + 40)
            updates.append(
                _timed(partial(terrain.refresh, (message.start_x, message.start_y), grid, [window]))
            )
            times.append(_timed(answer))
        report.add(f"large.stack_{key}_s", float(np.median(times)), "s", limit=0.3)
        report.add(f"large.stack_{key}_update_s", float(np.median(updates)), "s")


def _ways() -> WaySearch:
    return WaySearch(PlannerConfig(), BODY, PathLimits())


def _timed(work: Callable[[], object]) -> float:
    before = time.thread_time()
    work()
    return time.thread_time() - before
