"""Search: optimum, variants, explanation, determinism and refusals."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.graph.graph import TraversalGraph
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from planning.search.plan import DriveRules, PlanRequest, plan
from tests.places import needs_shared
from tests.planning.worlds import flat, golden_world, lattice, rough
from tools.bench.planning import reference

BODY = BodyModel()


@pytest.fixture(scope="module")
def world():
    grid = rough(5, size=3.0, resolution=0.1)
    return grid, lattice(grid, 0.55, seed=2)


@pytest.fixture(scope="module", autouse=True)
def remembered(world):
    """The reference works a pose set of the one world out once, not again for every query."""
    plain, known = reference.set_risk, {}

    def set_risk(grid, poses, body):
        if grid is not world[0]:
            return plain(grid, poses, body)
        key = tuple(poses), body
        if key not in known:
            known[key] = plain(grid, poses, body)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reference, "set_risk", set_risk)
        yield


@pytest.mark.parametrize(
    ("variant", "start_yaw", "goal_yaw"),
    [
        ("full", None, None),
        pytest.param("full", 1.0, -2.0, marks=pytest.mark.campaign),
        ("mean-only", None, 0.5),
        ("edge-only", 0.3, None),
    ],
)
def test_search_finds_the_optimum_over_ordered_pairs(world, variant, start_yaw, goal_yaw):
    grid, graph = world
    last = len(graph.nodes) - 1
    for start, goal in ((0, last), (last, 3)):
        got = plan(graph, grid, PlanRequest(start, goal, start_yaw, goal_yaw, variant), BODY)
        yaws = {"start_yaw": start_yaw, "goal_yaw": goal_yaw}
        cost, nodes = reference.cheapest_route(grid, graph, start, goal, BODY, **yaws, variant=variant)
        assert got.cost == pytest.approx(cost, abs=1e-4)
        assert got.nodes == nodes


def test_search_finds_the_optimum_forward_and_backward(world):
    grid, graph = world
    last = len(graph.nodes) - 1
    driven = set()
    for start, goal, yaws in ((0, last, (-2.4, -2.4)), (last, 3, (0.5, None))):
        got = plan(graph, grid, PlanRequest(start, goal, *yaws, rules=DriveRules(backward=1.01)), BODY)
        cost, nodes = reference.cheapest_route(
            grid, graph, start, goal, BODY, start_yaw=yaws[0], goal_yaw=yaws[1], backward=1.01
        )
        assert got.cost == pytest.approx(cost, abs=1e-4)
        assert got.cost == pytest.approx(sum(t.cost for t in got.transitions))
        assert got.nodes == nodes
        driven |= {t.backward for t in got.transitions}
    assert driven == {False, True}


def test_turns_take_time_and_the_optimum_stays_one(world):
    grid, graph = world
    last = len(graph.nodes) - 1
    turned = []
    for turning in (0.0, 2.0):
        got = plan(graph, grid, PlanRequest(0, last, -2.4, 0.8, rules=DriveRules(turning=turning)), BODY)
        cost, nodes = reference.cheapest_route(
            grid,
            graph,
            0,
            last,
            BODY,
            start_yaw=-2.4,
            goal_yaw=0.8,
            turn_cost=lambda _node, turn, each=turning: each * abs(turn),
        )
        assert got.cost == pytest.approx(cost, abs=1e-4)
        assert got.cost == pytest.approx(sum(t.cost for t in got.transitions))
        assert got.nodes == nodes
        chord = np.diff(got.points[:, :2], axis=0)
        yaw = np.concatenate([[-2.4], np.arctan2(chord[:, 1], chord[:, 0]), [0.8]])
        turned.append(np.abs(np.arctan2(np.sin(np.diff(yaw)), np.cos(np.diff(yaw)))).sum())
    assert turned[1] < turned[0] - 0.3


def test_turns_over_edges_cost_more_and_the_optimum_stays_one(world):
    grid, graph = world
    last = len(graph.nodes) - 1
    edgy = TraversalGraph.from_edges(graph.nodes, graph.edges, graph.risk[edge_slots(graph)])
    edgy.turn_price[::2, 1] = 4.0
    changed = 0

    def over_edge(node: int, turn: float) -> float:
        return 4.0 * abs(turn) if edgy.turn_price[node, 1] > 0.0 and abs(turn) > np.radians(30) else 0.0

    for start, goal, yaws in ((0, last, (None, None)), (last, 3, (1.0, -2.0)), (2, last, (3.0, 0.5))):
        got = plan(edgy, grid, PlanRequest(start, goal, *yaws), BODY)
        cost, nodes = reference.cheapest_route(
            grid, edgy, start, goal, BODY, start_yaw=yaws[0], goal_yaw=yaws[1], turn_cost=over_edge
        )
        assert got.cost == pytest.approx(cost, abs=1e-4)
        assert got.nodes == nodes
        assert got.cost == pytest.approx(sum(t.cost for t in got.transitions))
        for t in got.transitions:
            assert t.cost == pytest.approx(t.length * (1 + 3 * t.risk + t.body + t.unknown) + t.turn_cost)
        level = plan(graph, grid, PlanRequest(start, goal, *yaws), BODY)
        assert level.cost <= got.cost + 1e-9
        changed += level.nodes != got.nodes
        for variant in ("native", "edge-only"):
            one, two = (plan(g, grid, PlanRequest(start, goal, *yaws, variant), BODY) for g in (graph, edgy))
            assert (one.nodes, one.cost) == (two.nodes, two.cost), variant
    assert changed > 0


def edge_slots(graph):
    """Index of the risk of every edge in `graph.edges`."""
    source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
    return np.flatnonzero(source < graph.indices)


def test_native_search_is_plain_dijkstra_on_the_native_cost(world):
    grid, graph = world
    n = len(graph.nodes)
    dist = np.full((n, n), np.inf)
    src = np.repeat(np.arange(n), np.diff(graph.indptr))
    length = np.hypot(*(graph.nodes[src] - graph.nodes[graph.indices])[:, :2].T)
    dist[src, graph.indices] = length * (1 + 3 * graph.risk)
    for k in range(n):
        dist = np.minimum(dist, dist[:, k : k + 1] + dist[k])
    for goal in range(1, n, 5):
        got = plan(graph, grid, PlanRequest(0, goal, variant="native"), BODY)
        assert got.cost == pytest.approx(dist[0, goal], rel=1e-6)
        assert got.cost == pytest.approx(got.native_cost)


def test_the_plan_adds_up_and_tells_its_pose_sets(world):
    grid, graph = world
    got = plan(graph, grid, PlanRequest(0, len(graph.nodes) - 1, 2.0, 0.0), BODY)
    assert got.cost == pytest.approx(sum(t.cost for t in got.transitions))
    assert got.length == pytest.approx(sum(t.length for t in got.transitions))
    assert [t.nodes for t in got.transitions] == list(pairwise(got.nodes))
    assert got.reaches_goal
    for t in got.transitions:
        assert t.cost == pytest.approx(t.length * (1 + 3 * t.risk + t.body + t.unknown))
        per_set = {
            name: sum(0.5 * t.mean[name][f] + 0.5 * t.tail[name][f] for f in ("d_fb", "a_lr", "p_int"))
            for name in t.mean
        }
        assert t.body == pytest.approx(max(per_set.values()))
    assert set(got.transitions[0].mean) == {"edge", "sweep"}
    assert set(got.transitions[-1].mean) == {"edge", "sweep", "terminal sweep"}


def test_start_equal_to_goal_is_one_node_at_no_cost(world):
    grid, graph = world
    got = plan(graph, grid, PlanRequest(4, 4, 1.0, 2.0), BODY)
    assert got.nodes == (4,)
    assert got.cost == got.length == 0.0
    assert got.transitions == ()


def test_a_shared_table_changes_no_result_and_evaluates_nothing_twice(world):
    grid, graph = world
    table = RiskTable(graph, grid, BODY)
    goals = range(0, len(graph.nodes), 3)
    shared = [plan(graph, grid, PlanRequest(0, goal), BODY, table) for goal in goals]
    before = table.evaluated()
    again = [plan(graph, grid, PlanRequest(0, goal), BODY, table) for goal in goals]
    assert table.evaluated() == before
    for goal, one, two in zip(goals, shared, again, strict=True):
        alone = plan(graph, grid, PlanRequest(0, goal), BODY)
        assert (alone.nodes, alone.cost) == (one.nodes, one.cost) == (two.nodes, two.cost)
    with pytest.raises(NoRoute) as caught:
        plan(graph, grid, PlanRequest(0, 999), BODY, table)
    assert caught.value.reason is NoRouteReason.BAD_INPUT


def test_a_goal_beyond_known_ground_ends_at_the_most_promising_frontier():
    grid = flat(6, 4)
    nodes = np.array([[3, 2, 0], [2, 2.8, 0], [2, 1.2, 0], [4, 2, 0], [5, 2.8, 0], [5, 1.2, 0]], float)
    edges = np.array([[0, 1], [0, 2], [0, 3], [3, 4], [3, 5]])
    frontier = np.array([True, True, True, False, True, True])
    graph = TraversalGraph.from_edges(nodes, edges, np.zeros(5), frontier)
    ask = PlanRequest(0, (12.0, 2.2), allow_frontier=True)
    best = plan(graph, grid, ask, BODY)
    assert best.nodes == (0, 3, 4)
    assert not best.reaches_goal
    assert best.frontier == (5.0, 2.8)
    # The other side is hardly worse: once chosen it stays, although it would not be chosen anew.
    kept = plan(graph, grid, replace(ask, previous_frontier=(5.0, 1.2)), BODY)
    assert kept.frontier == (5.0, 1.2)
    # What lies behind the robot is clearly worse and given up.
    assert plan(graph, grid, replace(ask, previous_frontier=(2.0, 1.2)), BODY).frontier == (5.0, 2.8)
    everywhere = ((5.0, 2.8, 0.3), (5.0, 1.2, 0.3), (2.0, 2.8, 0.3))
    assert plan(graph, grid, replace(ask, tried=everywhere), BODY).frontier == (2.0, 1.2)
    with pytest.raises(NoRoute) as error:
        plan(graph, grid, replace(ask, tried=(*everywhere, (2.0, 1.2, 0.3))), BODY)
    assert error.value.reason is NoRouteReason.NO_ROUTE
    for start, goal in ((0, ask.goal), ((3.0, 2.0), 4)):
        with pytest.raises(PlanningError, match="between its nodes alone"):
            plan(graph, grid, PlanRequest(start, goal), BODY)


def test_equal_routes_are_decided_the_same_way_every_time():
    grid = flat(3, 3)
    nodes = [[0.5, 1.5, 0], [1.5, 1.0, 0], [1.5, 2.0, 0], [2.5, 1.5, 0]]
    graph = TraversalGraph.from_edges(
        np.array(nodes), np.array([[0, 1], [0, 2], [1, 3], [2, 3]]), np.zeros(4)
    )
    native = PlanRequest(0, 3, variant="native")
    assert plan(graph, grid, native, BODY).nodes == plan(graph, grid, native, BODY).nodes
    for variant in ("edge-only", "mean-only", "full"):
        assert plan(graph, grid, PlanRequest(0, 3, variant=variant), BODY).nodes == (0, 1, 3)


@pytest.mark.parametrize(
    ("start", "goal", "reason"),
    [
        ((float("nan"), 1.0), 3, NoRouteReason.BAD_INPUT),
        (0, (1.0, float("inf")), NoRouteReason.BAD_INPUT),
        (0, 99, NoRouteReason.BAD_INPUT),
        (-1, 3, NoRouteReason.BAD_INPUT),
        ("here", 3, NoRouteReason.BAD_INPUT),
        ((1.0,), 3, NoRouteReason.BAD_INPUT),
        (0, 4, NoRouteReason.NO_ROUTE),
    ],
)
def test_a_request_that_cannot_be_planned_says_why(start, goal, reason):
    grid = flat(4, 4)
    nodes = np.array([[0.5, 1.5, 0], [1.5, 1.0, 0], [1.5, 2.0, 0], [2.5, 1.5, 0], [3.5, 0.5, 0]])
    graph = TraversalGraph.from_edges(nodes, np.array([[0, 1], [0, 2], [1, 3], [2, 3]]), np.zeros(4))
    for variant in ("native", "full"):
        with pytest.raises(NoRoute) as error:
            plan(graph, grid, PlanRequest(start, goal, variant=variant), BODY)
        assert error.value.reason is reason
        assert len(str(error.value)) > 20


def test_bad_yaw_variant_and_foreign_table_are_refused(world):
    grid, graph = world
    with pytest.raises(NoRoute, match="goal_yaw"):
        plan(graph, grid, PlanRequest(0, 3, goal_yaw=float("nan")), BODY)
    with pytest.raises(PlanningError, match="variant"):
        plan(graph, grid, PlanRequest(0, 3, variant="best"), BODY)  # type: ignore[arg-type]
    with pytest.raises(PlanningError, match="risk table"):
        plan(graph, grid, PlanRequest(0, 3), BODY, RiskTable(graph, flat(3, 3), BODY))


def test_a_map_without_a_trusted_cell_is_no_terrain(world):
    _, graph = world
    blind = ElevationGrid(np.full((9, 9), np.nan, np.float32), np.zeros((9, 9), bool), (0.0, 0.0), 0.5)
    with pytest.raises(NoRoute) as error:
        plan(graph, blind, PlanRequest(0, 3), BODY)
    assert error.value.reason is NoRouteReason.NO_TERRAIN


@needs_shared
def test_routes_and_costs_equal_the_reference():
    grid, graph, want = golden_world()
    table = RiskTable(graph, grid, BODY)
    for row, cost, path in zip(want["queries"], want["query_cost"], want["query_path"], strict=True):
        start_yaw, goal_yaw = (None if np.isnan(v) else float(v) for v in row[2:])
        got = plan(graph, grid, PlanRequest(int(row[0]), int(row[1]), start_yaw, goal_yaw), BODY, table)
        assert got.cost == pytest.approx(cost, abs=1e-4)
        assert got.nodes == tuple(path[path >= 0])
    for (i, j, k), cost in zip(want["transitions"], want["transition_cost"], strict=True):
        sub = TraversalGraph.from_edges(
            graph.nodes[[i, j, k]], np.array([[0, 1], [1, 2]]), np.array([0.0, _risk(graph, j, k)])
        )
        assert plan(sub, grid, PlanRequest(0, 2), BODY).transitions[1].cost == pytest.approx(cost, abs=1e-4)


def _risk(graph, j, k):
    row = slice(graph.indptr[j], graph.indptr[j + 1])
    return float(graph.risk[row][graph.indices[row] == k][0])
