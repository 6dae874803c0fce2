"""The search backward that is kept between queries: the same plans and costs as a new search, after map updates and from other places."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.errors import NoRoute
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel, weights_of
from planning.risk.table import RiskTable
from planning.search.again import Known, go_on
from planning.search.bounds import Asked, ToGo, cost_to_go, reached
from planning.search.keep import nearest
from planning.search.plan import DriveRules, Plan, PlanRequest, plan

BODY = BodyModel()
RULES = DriveRules(backward=1.3, turning=0.3, straight=True)
CELLS, RESOLUTION = 120, 0.05


def found(graph: TraversalGraph, grid: ElevationGrid, request: PlanRequest, table: RiskTable) -> Plan | None:
    try:
        return plan(graph, grid, request, BODY, table)
    except NoRoute:
        return None


def updated(
    rng: np.random.Generator, grid: ElevationGrid
) -> tuple[ElevationGrid, list[tuple[int, int, int, int]]]:
    """The grid with one or two patches raised, lowered or not seen any more, and where."""
    height, trusted, windows = grid.height.copy(), grid.trusted.copy(), []
    for _ in range(int(rng.integers(1, 3))):
        r, c = (int(v) for v in rng.integers(0, CELLS - 12, 2))
        h, w = (int(v) for v in rng.integers(2, 12, 2))
        height[r : r + h, c : c + w] += np.float32(rng.choice([0.02, 0.06, 0.5, -0.5]))
        trusted[r : r + h, c : c + w] = rng.uniform() < 0.8
        windows.append((r, c, r + h, c + w))
    return ElevationGrid(height, trusted, grid.origin, grid.resolution), windows


def rolling(seed: int, noise: float = 0.0) -> tuple[np.random.Generator, ElevationGrid, TraversalGraph]:
    """Rolling ground with noise [m], and its graph."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:CELLS, 0:CELLS] * RESOLUTION
    height = 0.08 * np.sin(1.7 * x + seed) * np.cos(1.3 * y)
    if noise > 0.0:
        height += rng.normal(0.0, noise, x.shape)
    grid = ElevationGrid(height.astype(np.float32), np.ones(x.shape, bool), (0.0, 0.0), RESOLUTION)
    return rng, grid, TraversalGraph.build(grid, (1.0, 1.0), GraphParams(), seed)


@pytest.mark.parametrize("seed", range(4))
def test_plans_are_those_of_a_new_search(seed: int) -> None:
    rng, grid, graph = rolling(seed, noise=0.004)
    table: RiskTable | None = None
    routes = 0
    goals = rng.uniform(4.0, 5.5, (2, 2))
    for k in range(12):
        start, goal = tuple(rng.uniform(0.5, 3.0, 2).tolist()), tuple(goals[k // 6].tolist())
        yaw = None if seed % 2 else 0.7
        request = PlanRequest(start, goal, float(rng.uniform(-3, 3)), yaw, allow_frontier=True, rules=RULES)
        if k % 3:
            grid, windows = updated(rng, grid)
            graph.update(grid, windows, start)
        table = RiskTable(graph, grid, BODY, table)
        got, want = (
            found(graph, grid, request, table),
            found(graph, grid, request, RiskTable(graph, grid, BODY)),
        )
        assert (got is None) is (want is None)
        if got is not None and want is not None:
            routes += got.reaches_goal
            assert (got.nodes, got.cost) == (want.nodes, want.cost)
            np.testing.assert_array_equal(got.points, want.points)
    assert routes >= 6


@pytest.mark.parametrize("seed", range(3))
def test_costs_to_the_goal_are_those_of_a_new_search_and_most_are_kept(seed: int) -> None:
    """All states settled, without a bound that depends on the start."""
    rng, grid, graph = rolling(seed)
    goal_id = int(graph.node_ids[-1])
    kept = 0.0
    table = RiskTable(graph, grid, BODY)
    for k in range(5):
        if k:
            grid, windows = updated(rng, grid)
            graph.update(grid, windows)
            table = RiskTable(graph, grid, BODY, table)
        is_end = graph.node_ids == goal_id
        if not is_end.any():
            break
        got, known = settled(table, is_end)
        want, none = settled(RiskTable(graph, grid, BODY), is_end)
        assert not none
        np.testing.assert_array_equal(got.h, want.h)
        np.testing.assert_array_equal(got.settled, want.settled)
        kept = max(kept, known / max(1, int(want.settled.sum())))
    assert kept > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_plans_are_the_same_where_the_table_was_asked_for_its_edges_between_queries(seed: int) -> None:
    """As the planner does that prepares for a map that has grown (`MapGraph.prepare`)."""
    rng, grid, graph = rolling(seed)
    table, routes = RiskTable(graph, grid, BODY), 0
    for k in range(8):
        request = PlanRequest(tuple(rng.uniform(0.6, 3.0, 2).tolist()), (5.0, 5.1), 0.3, rules=RULES)
        if k % 2:
            grid, windows = updated(rng, grid)
            graph.update(grid, windows, request.start)  # type: ignore[arg-type]
            table = RiskTable(graph, grid, BODY, table)
        table.evaluate_edges()
        got, want = (
            found(graph, grid, request, table),
            found(graph, grid, request, RiskTable(graph, grid, BODY)),
        )
        assert (got is None) is (want is None)
        if got is not None and want is not None:
            routes += 1
            assert (got.nodes, got.cost) == (want.nodes, want.cost)
            np.testing.assert_array_equal(got.points, want.points)
    assert routes >= 4


HELD = PlanRequest((0.7, 0.7), (5.2, 5.2), 3.0, 0.5, rules=replace(RULES, guarded=True))
"""The guard holds turns of its cheapest route `among_posts`."""


@pytest.mark.parametrize("seed", [0, 5])
def test_the_same_query_again_settles_little_also_where_the_guard_holds_turns(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """It settles what leads out of the start, and one search backward serves all searches of the query."""
    searches = list[tuple[int, ToGo]]()

    def noted(*args: object) -> tuple[ToGo, Known]:
        go, come = go_on(*args)  # type: ignore[arg-type]
        searches.append((int(go.settled.sum()), go))
        return go, come

    monkeypatch.setattr(sys.modules["planning.search.route_search"], "go_on", noted)
    graph, grid = among_posts(seed)
    table = RiskTable(graph, grid, BODY)
    first = found(graph, grid, HELD, table)
    searches.clear()
    again = found(graph, grid, HELD, table)
    assert first is not None
    assert again is not None
    assert (again.nodes, again.cost) == (first.nodes, first.cost)
    [(before, go)] = searches
    assert int(go.settled.sum()) - before <= 40


@pytest.mark.parametrize("seed", [0, 5])
def test_a_search_led_by_bounds_that_know_of_held_turns_finds_the_same(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    graph, grid = among_posts(seed)
    got = found(graph, grid, HELD, RiskTable(graph, grid, BODY))
    module = sys.modules["planning.search.route_search"]
    guides, guide_to = [], vars(module)["guide_to"]
    monkeypatch.setattr(module, "MOST", 0)
    monkeypatch.setattr(module, "guide_to", lambda *args: guides.append(guide_to(*args)) or guides[-1])
    want = found(graph, grid, HELD, RiskTable(graph, grid, BODY))
    assert (got is None) is (want is None)
    if got is not None and want is not None:
        assert (got.nodes, got.cost) == (want.nodes, want.cost)
    assert len(guides) > 1, "the guard holds a turn of the cheapest route"


def test_the_nearest_node_of_a_place_is_that_of_all_nodes() -> None:
    rng = np.random.default_rng(5)
    nodes = np.round(rng.uniform(0.0, 9.0, (400, 2)), 1)  # many at the same distance
    places = np.round(rng.uniform(-2.0, 11.0, (300, 2)), 1)
    assert nearest(nodes, places) == [int(np.argmin(np.hypot(*(nodes - p).T))) for p in places]


def among_posts(seed: int) -> tuple[TraversalGraph, ElevationGrid]:
    """Posts on rough ground."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:CELLS, 0:CELLS] * RESOLUTION
    height = 0.03 * np.sin(1.7 * x + seed) * np.cos(1.3 * y)
    for r, c in rng.integers(0, CELLS - 4, (28, 2)):
        height[r : r + 4, c : c + 4] = 0.6
    height[:30, :30] = height[90:, 90:] = 0.0
    grid = ElevationGrid(height.astype(np.float32), np.ones(x.shape, bool), (0.0, 0.0), RESOLUTION)
    return TraversalGraph.build(grid, (0.7, 0.7), GraphParams(), seed), grid


def settled(table: RiskTable, is_end: np.ndarray) -> tuple[ToGo, int]:
    """The search backward over everything, and how many states it had settled before it began."""
    w, arcs, tables, come = weights_of(BODY), table.arcs, table.tables(BODY), np.zeros(len(is_end))
    asked = Asked(0, is_end, np.zeros(len(is_end)), np.nan, np.nan, True, False, 1.3, 0.3, 0.0)
    go, _ = go_on(table, tables, BODY, asked)
    before = int(go.settled.sum())
    heap = reached(w, arcs, tables, 0, come, 1.3, go)
    cost_to_go(table.sampler, w, arcs, tables, asked, come, go, heap, 1e9)
    return go, before
