"""Stretches of a route that were made straight for the query before: the same routes as without them, and most are not tried again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.errors import NoRoute
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from planning.search import straight
from planning.search.attach import Ground
from planning.search.chords import Chords
from planning.search.keep import rest
from planning.search.plan import Driven, DriveRules, PlanRequest, plan

BODY = BodyModel()
RULES = DriveRules(backward=1.3, turning=0.3, straight=True)
ROWS, COLS, RESOLUTION = 120, 240, 0.05
START, GOAL = (1.0, 2.0), (11.0, 2.0)


def rolling(seed: int) -> tuple[np.random.Generator, ElevationGrid, TraversalGraph]:
    """12 x 6 m of rolling ground with low posts, and its graph."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:ROWS, 0:COLS] * RESOLUTION
    height = 0.05 * np.sin(1.7 * x + seed) * np.cos(1.3 * y) + rng.normal(0.0, 0.004, x.shape)
    for px, py in rng.uniform((1.8, 0.5), (10.2, 3.5), (10, 2)):
        height[np.hypot(x - px, y - py) < 0.12] += 0.3
    grid = ElevationGrid(height.astype(np.float32), np.ones(x.shape, bool), (0.0, 0.0), RESOLUTION)
    return rng, grid, TraversalGraph.build(grid, START, GraphParams(), seed)


def raised(
    grid: ElevationGrid, x: float, y: float, by: float
) -> tuple[ElevationGrid, tuple[int, int, int, int]]:
    """The grid with a patch of 0.25 m around a place raised, and where."""
    r, c = round(y / RESOLUTION) - 2, round(x / RESOLUTION) - 2
    height = grid.height.copy()
    height[max(r, 0) : r + 5, c : c + 5] += np.float32(by)
    return ElevationGrid(height, grid.trusted, grid.origin, grid.resolution), (max(r, 0), c, r + 5, c + 5)


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The first points of stretches that are tried."""
    out, longest = list[int](), straight._longest

    def noted(ground, table, route, i, cost, most):
        out.append(i)
        return longest(ground, table, route, i, cost, most)

    monkeypatch.setattr(straight, "_longest", noted)
    return out


@pytest.mark.parametrize("seed", range(4))
def test_routes_are_those_of_a_new_table(seed: int) -> None:
    """The robot goes on along its route while the map changes beside it, or stays."""
    rng, grid, graph = rolling(seed)
    request, table, routes = PlanRequest(START, GOAL, 0.0, rules=RULES), None, 0
    for k in range(14):
        table = RiskTable(graph, grid, BODY, table)
        try:
            want = plan(graph, grid, request, BODY)
        except NoRoute:
            break
        got = plan(graph, grid, request, BODY, table)
        assert (got.nodes, got.cost) == (want.nodes, want.cost)
        np.testing.assert_array_equal(got.points, want.points)
        routes += 1
        at = got.points[int(rng.integers(2, 7)), :2]
        if k % 2:
            request = replace(
                request,
                start=(float(got.points[1, 0]), float(got.points[1, 1])),
                start_yaw=float(rng.uniform(-1, 1)),
            )
        grid, window = raised(
            grid, *(at + rng.normal(0.0, 0.3, 2)), float(rng.choice([0.01, 0.03, -0.03, 0.3]))
        )
        graph.update(grid, [window], request.start)  # type: ignore[arg-type]
    assert routes >= 6


def bowed(
    graph: TraversalGraph,
    grid: ElevationGrid,
    table: RiskTable,
    stand: tuple[float, float, float] | None = None,
) -> np.ndarray:
    """Back by 0.4 m, and then on a bow of 1 m to the right from x = 1 to 5 m, made straight."""
    s = np.linspace(0.0, 1.0, 13)
    points = np.column_stack([1.0 + 4.0 * s, 2.0 - np.sin(np.pi * s)])
    driven = Driven(points, np.arange(len(points)) == 0)
    ground, ends = Ground(graph, grid, stand), ((1.4, 2.0), (5.0, 2.0))
    request = PlanRequest(*ends, 0.0, rules=RULES, driven=driven)
    route = rest(ground, table.sampler, BODY, graph.nodes, request, (0, 1), ends, 0.0, np.nan, 0.0)
    assert route is not None
    assert len(table.arcs.x) == len(graph.nodes), "one that nobody asked for an edge hands nothing on"
    straight.straighten(ground, table, route)
    return route.xy


@pytest.mark.parametrize("first", [0.0, 0.3], ids=["a post comes", "a post goes"])
def test_a_chord_is_tried_again_where_its_ground_alone_has_changed(first: float) -> None:
    """The bow leads around a post on its chord."""
    level = ElevationGrid(
        np.zeros((ROWS, COLS), np.float32), np.ones((ROWS, COLS), bool), (0.0, 0.0), RESOLUTION
    )
    grid, _ = raised(level, 3.0, 2.0, first)
    graph = TraversalGraph.build(grid, START, GraphParams(), 0)
    table = RiskTable(graph, grid, BODY)
    before = bowed(graph, grid, table)
    grid, window = raised(level, 3.0, 2.0, 0.3 - first)
    graph.update(grid, [window])
    after = bowed(graph, grid, RiskTable(graph, grid, BODY, table))
    np.testing.assert_array_equal(after, bowed(graph, grid, RiskTable(graph, grid, BODY)))
    assert np.abs(after - before).max() > 0.2


def test_what_is_kept_knows_nothing_of_a_robot_beside_it() -> None:
    """Ground that was not seen is free under a robot that stands on it."""
    trusted = np.ones((ROWS, COLS), bool)
    trusted[34:47, 58:63] = False
    grid = ElevationGrid(np.zeros((ROWS, COLS), np.float32), trusted, (0.0, 0.0), RESOLUTION)
    graph = TraversalGraph.build(grid, START, GraphParams(blind_radius=0.0), 0)
    table, stand = RiskTable(graph, grid, BODY), (3.0, 2.0, 0.0)
    before = bowed(graph, grid, table)
    after = bowed(graph, grid, table, stand)
    np.testing.assert_array_equal(after, bowed(graph, grid, RiskTable(graph, grid, BODY), stand))
    assert np.abs(after - before).max() > 0.2
    np.testing.assert_array_equal(before, bowed(graph, grid, table))


def test_a_chord_is_judged_by_what_the_route_of_now_has_elsewhere() -> None:
    """A low bump on a chord is too much for a route that is level, and not for one that begins on a bump."""
    level = ElevationGrid(
        np.zeros((ROWS, COLS), np.float32), np.ones((ROWS, COLS), bool), (0.0, 0.0), RESOLUTION
    )
    grid, _ = raised(raised(level, 6.5, 2.0, 0.008)[0], 1.0, 2.6, 0.05)
    graph = TraversalGraph.build(grid, START, GraphParams(), 0)
    s = np.linspace(0.0, 1.0, 17)
    lead = np.column_stack([np.arange(1.0, 5.0, 0.25), np.full(16, 2.0)])
    points = np.vstack([lead, np.column_stack([5.0 + 3.0 * s, 2.0 - np.sin(np.pi * s)])])
    driven = Driven(points, np.arange(len(points)) == 0)

    def straightened(begin: tuple[float, float], yaw: float, table: RiskTable) -> np.ndarray:
        ground, ends = Ground(graph, grid), (begin, (8.0, 2.0))
        request = PlanRequest(*ends, yaw, rules=RULES, driven=driven)
        route = rest(ground, table.sampler, BODY, graph.nodes, request, (0, 1), ends, yaw, np.nan, 0.0)
        assert route is not None
        straight.straighten(ground, table, route)
        return route.xy

    table = RiskTable(graph, grid, BODY)
    before = straightened((1.4, 2.0), 0.0, table)
    after = straightened((1.0, 2.6), np.pi / 2, table)
    np.testing.assert_array_equal(after, straightened((1.0, 2.6), np.pi / 2, RiskTable(graph, grid, BODY)))
    assert np.abs(after - before)[1:].max() > 0.2


def test_stretches_far_from_what_changed_are_not_tried_again(tried: list[int]) -> None:
    _, grid, graph = rolling(0)
    request = PlanRequest(START, GOAL, 0.0, rules=RULES)
    table = RiskTable(graph, grid, BODY)
    plan(graph, grid, request, BODY, table)
    first = len(tried)
    tried.clear()
    grid, window = raised(grid, 6.0, 5.8, 0.01)
    graph.update(grid, [window], START)
    plan(graph, grid, request, BODY, RiskTable(graph, grid, BODY, table))
    assert 0 < len(tried) < first, "those near the start"


def test_no_stretch_is_kept_where_the_graph_did_not_follow_the_map(tried: list[int]) -> None:
    _, grid, graph = rolling(0)
    request = PlanRequest(START, GOAL, 0.0, rules=RULES)
    table = RiskTable(graph, grid, BODY)
    plan(graph, grid, request, BODY, table)
    assert isinstance(table.chords, Chords)
    assert table.chords.known
    other, _ = raised(grid, 6.0, 5.8, 0.01)
    first = len(tried)
    tried.clear()
    plan(graph, other, request, BODY, RiskTable(graph, other, BODY, table))
    assert len(tried) == first
