"""A route that is driven is kept without a search only where no route of the graph can be clearly better."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel, weights_of
from planning.risk.table import RiskTable
from planning.search.again import Search
from planning.search.attach import Ground
from planning.search.plan import Driven, DriveRules, Plan, PlanRequest, plan
from planning.search.unbeaten import all_cost_more, changed_nodes

BODY = BodyModel()
RULES = DriveRules(backward=1.3, turning=0.3)
ROWS, COLS, RESOLUTION = 100, 200, 0.05
START, GOAL = (1.0, 2.5), (9.0, 2.5)
Windows = list[tuple[int, int, int, int]]


def bumpy(seed: int) -> tuple[ElevationGrid, TraversalGraph]:
    """10 x 5 m of rolling ground with posts, and its graph."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:ROWS, 0:COLS] * RESOLUTION
    height = 0.08 * np.sin(1.7 * x + seed) * np.cos(1.3 * y) + rng.normal(0.0, 0.004, x.shape)
    for px, py in rng.uniform((1.8, 0.5), (8.2, 4.5), (6, 2)):
        height[np.hypot(x - px, y - py) < 0.15] += 0.5
    grid = ElevationGrid(height.astype(np.float32), np.ones(x.shape, bool), (0.0, 0.0), RESOLUTION)
    return grid, TraversalGraph.build(grid, START, GraphParams(), seed)


def updated(rng: np.random.Generator, grid: ElevationGrid) -> tuple[ElevationGrid, Windows]:
    """The grid with one or two patches raised, made level or not seen any more, and where."""
    height, trusted, windows = grid.height.copy(), grid.trusted.copy(), Windows()
    for _ in range(int(rng.integers(1, 3))):
        r, c = int(rng.integers(0, ROWS - 12)), int(rng.integers(0, COLS - 12))
        h, w = (int(v) for v in rng.integers(2, 12, 2))
        part = (slice(r, r + h), slice(c, c + w))
        if rng.uniform() < 0.5:
            height[part] += np.float32(rng.choice([0.02, 0.06, 0.5]))
        else:
            height[part] = height[part].min()
        trusted[part] = rng.uniform() < 0.8
        windows.append((r, c, r + h, c + w))
    return ElevationGrid(height, trusted, grid.origin, grid.resolution), windows


def asked(
    start: tuple[float, float], goal: tuple[float, float], before: Plan | None, rules: DriveRules
) -> PlanRequest:
    """From a place on the route of `before`, what is left of which is driven."""
    if before is None:
        return PlanRequest(start, goal, 0.0, rules=rules)
    points = before.points[1:, :2]
    left = np.hypot(*(points - goal).T) < math.dist(start, goal)
    back = np.array([each.backward for each in before.transitions])
    return PlanRequest(start, goal, 0.0, rules=rules, driven=Driven(points[left], back[left]))


@pytest.mark.parametrize("seed", range(6))
def test_no_route_costs_less_than_what_the_last_search_says_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid, graph = bumpy(seed)
    table: RiskTable | None = None
    close = 0
    for _ in range(8):
        table = RiskTable(graph, grid, BODY, table)
        plan(graph, grid, PlanRequest(START, GOAL, 0.0, rules=RULES), BODY, table)
        start = (float(rng.uniform(0.6, 2.5)), float(rng.uniform(1.5, 3.5)))
        grid, windows = updated(rng, grid)
        graph.update(grid, windows, start)
        try:
            cost = plan(graph, grid, PlanRequest(start, GOAL, 0.0, rules=RULES), BODY).cost
        except NoRoute:
            continue
        search = table.searched
        assert isinstance(search, Search)
        assert search.found is not None
        changed = changed_nodes(graph, search.found.version)
        near_goal = (np.hypot(*(graph.nodes[changed, :2] - GOAL).T) < 1.6).any()
        if near_goal:
            continue
        ground = Ground(graph, grid, (*start, 0.0))

        def all_above(limit: float) -> bool:
            return all_cost_more(limit, ground, start, changed, search, weights_of(BODY), RULES.backward)  # noqa: B023

        assert not all_above(cost + 1e-6)
        close += all_above(0.75 * cost)
    assert close >= 2


def test_what_is_kept_without_a_search_is_kept_after_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Routes that are not made straight: then the costs bound all that may be found."""
    kept = 0
    for seed in range(12):
        rng = np.random.default_rng(10 + seed)
        grid, graph = bumpy(seed)
        start, before = START, None
        table: RiskTable | None = None
        for _ in range(8):
            request = asked(start, GOAL, before, DriveRules(1.3))
            table = RiskTable(graph, grid, BODY, table)
            try:
                got = plan(graph, grid, request, BODY, table)
            except NoRoute:
                break
            with monkeypatch.context() as patch:
                patch.setattr(sys.modules["planning.search.plan"], "unbeaten", lambda *_: (None, None))
                want = plan(graph, grid, request, BODY)
            assert (got.nodes, got.cost, got.kept, got.short) == (
                want.nodes,
                want.cost,
                want.kept,
                want.short,
            )
            np.testing.assert_array_equal(got.points, want.points)
            kept += got.kept and got.expanded == 0
            before = got
            start = (float(got.points[1, 0]), float(got.points[1, 1]))
            grid, windows = updated(rng, grid)
            graph.update(grid, windows, start)
    assert kept >= 5


def test_a_way_that_opens_is_found_and_one_that_closes_elsewhere_needs_no_search() -> None:
    height = np.zeros((ROWS, COLS), np.float32)
    height[:80, 90:94] = 0.5  # a wall, open at its upper end
    trusted = np.ones(height.shape, bool)
    grid = ElevationGrid(height, trusted, (0.0, 0.0), RESOLUTION)
    graph = TraversalGraph.build(grid, START, GraphParams(), 0)
    table = RiskTable(graph, grid, BODY)
    first = plan(graph, grid, PlanRequest((1.0, 1.0), (8.0, 1.0), 0.0, rules=RULES), BODY, table)
    request = asked((1.0, 1.0), (8.0, 1.0), first, RULES)

    def after(rows: slice, cols: slice, value: float) -> Plan:
        nonlocal grid, table
        changed = grid.height.copy()
        changed[rows, cols] = value
        grid = ElevationGrid(changed, trusted, (0.0, 0.0), RESOLUTION)
        graph.update(grid, [(rows.start, cols.start, rows.stop, cols.stop)], (1.0, 1.0))
        table = RiskTable(graph, grid, BODY, table)
        return plan(graph, grid, request, BODY, table)

    closed = after(slice(0, 6), slice(40, 46), 0.5)
    assert closed.kept
    assert closed.expanded == 0
    opened = after(slice(10, 40), slice(90, 94), 0.0)
    assert not opened.kept
    assert opened.length < first.length - 2.0


@pytest.mark.parametrize("bad", ["ab", (1.0,), (np.nan, 1.0)])
def test_a_place_that_is_none_is_told_as_one_although_a_route_is_driven(bad: object) -> None:
    grid, graph = bumpy(0)
    table = RiskTable(graph, grid, BODY)
    first = plan(graph, grid, PlanRequest(START, GOAL, 0.0, rules=RULES), BODY, table)
    request = replace(asked(START, GOAL, first, RULES), start=bad)
    with pytest.raises(NoRoute) as none:
        plan(graph, grid, request, BODY, table)
    assert none.value.reason is NoRouteReason.BAD_INPUT
