"""Evaluations carried over map updates, and evaluated ahead, against fresh ones."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.arcs import arcs_of
from planning.risk.body import BodyModel, weights_of
from planning.risk.footprint import scratch
from planning.risk.pose_sets import evaluate_poses, turn_angle
from planning.risk.table import RiskTable
from planning.risk.terrain import changed_cells
from planning.search.endpoints import endpoints
from planning.search.plan import PlanRequest, plan
from tests.planning.worlds import lattice, rough

BODY = BodyModel()
W = weights_of(BODY)


def ground(seed: int, shape: tuple[int, int] = (110, 120)) -> np.ndarray:
    """Gentle waves with noise (rows, cols) at 0.05 m."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] * 0.05
    z = 0.1 * np.sin(1.3 * x + rng.uniform(0, 6)) * np.cos(1.1 * y) + rng.normal(0, 0.004, shape)
    return z.astype(np.float32)


def edges_of(table: RiskTable) -> np.ndarray:
    return table.tables.edge


@pytest.mark.parametrize("seed", range(3))
def test_after_map_updates_carried_evaluations_equal_fresh_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    height = ground(seed)
    trusted = np.ones(height.shape, bool)
    grid = ElevationGrid(height, trusted, (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(grid, (1.0, 1.0), GraphParams(), seed)
    table = RiskTable(graph, grid, BODY)
    table.evaluate_edges()
    kept = 0
    for _ in range(8):
        r, c = (int(v) for v in rng.integers(0, 90, 2))
        height, trusted = height.copy(), trusted.copy()
        height[r : r + 14, c : c + 10] += rng.choice([0.02, 0.5, -0.3])
        trusted[c : c + 5, r : r + 4] ^= True
        grid = ElevationGrid(height, trusted, (0.0, 0.0), 0.05)
        graph.update(grid, [(r, c, r + 14, c + 10), (c, r, c + 5, r + 4)])
        table = RiskTable(graph, grid, BODY, table)
        carried = ~np.isnan(edges_of(table)[:, 0])
        kept += carried.sum()
        assert not carried.all()
        fresh = RiskTable(graph, grid, BODY)
        fresh.evaluate_edges()
        np.testing.assert_array_equal(edges_of(table)[carried], edges_of(fresh)[carried])
        request = PlanRequest(0, len(graph.nodes) - 1, 0.3, -1.0)
        with_it, without = plan(graph, grid, request, BODY, table), plan(graph, grid, request, BODY)
        assert (with_it.nodes, with_it.cost) == (without.nodes, without.cost)
    assert kept > 4 * len(graph.indices), "most edges are far from what changed"


@pytest.mark.parametrize("seed", range(3))
def test_turns_are_kept_where_nothing_changed_under_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = ElevationGrid(ground(seed), np.ones(ground(seed).shape, bool), (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(grid, (1.0, 1.0), GraphParams(), seed)
    table, kept = RiskTable(graph, grid, BODY), 0
    for k in range(6):
        # Between nodes, and from and to places that are nodes of this query alone.
        request = PlanRequest(0, len(graph.nodes) - 1) if k % 2 else PlanRequest((1.0, 1.0), (4.6, 4.8), 0.3)
        plan(graph, grid, request, BODY, table)
        height = grid.height.copy()
        r, c = (int(v) for v in rng.integers(0, 90, 2))
        height[r : r + 10, c : c + 10] += 0.02
        grid = ElevationGrid(height, grid.trusted, (0.0, 0.0), 0.05)
        graph.update(grid, [(r, c, r + 10, c + 10)])
        table = RiskTable(graph, grid, BODY, table)
        arcs, tables = table.arcs, table.tables
        for slot in np.flatnonzero(tables.turn_at >= 0).tolist():
            at = arcs.target[slot]
            for out in range(arcs.indptr[at], arcs.indptr[at + 1]):
                for change in range(2):
                    got = tables.turns[tables.turn_at[slot] + 2 * (out - arcs.indptr[at]) + change]
                    if np.isnan(got[0]):
                        continue
                    turn = turn_angle(arcs.heading[slot], arcs.heading[out] + change * np.pi)
                    where = arcs.x[at], arcs.y[at], arcs.heading[slot], 0.0, 0.0, turn
                    work = scratch(table.sampler)
                    assert tuple(got) == evaluate_poses(table.sampler, work, W, *where, work.moments)
                    kept += 1
    assert kept > 50


@pytest.mark.parametrize("seed", range(40))
def test_the_box_of_changed_cells_is_that_of_a_comparison_cell_by_cell(seed: int) -> None:
    """Of two windows of one map, the cells of one changed here and there."""
    rng = np.random.default_rng(seed)
    z, known = rng.normal(size=(30, 30)).astype(np.float32), rng.random((30, 30)) < 0.8
    (r0, c0), (b0, d0) = rng.integers(0, 8, (2, 2)) if seed % 4 else np.zeros((2, 2), np.int64)
    (r1, c1), (b1, d1) = rng.integers(15, 30, (2, 2)) if seed % 4 else np.full((2, 2), 30)
    old = np.ascontiguousarray(z[b0:b1, d0:d1]), np.ascontiguousarray(known[b0:b1, d0:d1]).astype(np.uint8)
    changed = rng.random(z.shape) < rng.choice([0.0, 0.01, 0.1])
    z, known = np.where(changed & (z > 0), z + 1, z), known ^ (changed & (z <= 0))
    new = np.ascontiguousarray(z[r0:r1, c0:c1]), np.ascontiguousarray(known[r0:r1, c0:c1]).astype(np.uint8)
    there = np.zeros(z.shape, bool)
    there[b0:b1, d0:d1] = True
    want = (changed | ~there)[r0:r1, c0:c1]
    flat = (new[0].ravel(), new[1].ravel(), c1 - c0, old[0].ravel(), old[1].ravel(), d1 - d0)
    box, cells = changed_cells(*flat, int(r0 - b0), int(c0 - d0))
    if not want.any():
        assert cells.size == 0
        return
    rows, cols = np.flatnonzero(want.any(axis=1)), np.flatnonzero(want.any(axis=0))
    assert box == (rows[0], cols[0], rows[-1] + 1, cols[-1] + 1)
    inside = want[box[0] : box[2], box[1] : box[3]]
    np.testing.assert_array_equal(cells, inside)


def test_changes_add_up_over_tables_that_nobody_asked_for_an_edge() -> None:
    rng = np.random.default_rng(4)
    grid = ElevationGrid(ground(4), np.ones((110, 120), bool), (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(grid, (1.0, 1.0), GraphParams(), 4)
    table = RiskTable(graph, grid, BODY)
    table.evaluate_edges()
    for k in range(3):
        height = grid.height.copy()
        height[20 + 30 * k : 26 + 30 * k, 30:40] += rng.normal(0.0, 0.02, (6, 10))
        grid = ElevationGrid(height, grid.trusted, (0.0, 0.0), 0.05)
        graph.update(grid, [(20 + 30 * k, 30, 26 + 30 * k, 40)])
        table = RiskTable(graph, grid, BODY, table)
    carried = ~np.isnan(edges_of(table)[:, 0])
    fresh = RiskTable(graph, grid, BODY)
    fresh.evaluate_edges()
    np.testing.assert_array_equal(edges_of(table)[carried], edges_of(fresh)[carried])
    assert 0.4 < carried.mean() < 0.95


def test_a_table_whose_terrain_went_on_makes_another() -> None:
    grid = ElevationGrid(ground(4), np.ones((110, 120), bool), (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(grid, (1.0, 1.0), GraphParams(), 4)
    table = RiskTable(graph, grid, BODY)
    assert RiskTable(graph, grid, BODY, table).terrain is table.terrain
    other = ElevationGrid(grid.height + np.float32(0.1), grid.trusted, (0.0, 0.0), 0.05)
    terrain = table.terrain
    after = RiskTable(graph, other, BODY, table)
    assert after.terrain is terrain
    for asked in (table, RiskTable(graph, grid, BODY, table)):
        np.testing.assert_array_equal(asked.terrain.height, RiskTable(graph, grid, BODY).terrain.height)
    np.testing.assert_array_equal(after.terrain.height, RiskTable(graph, other, BODY).terrain.height)


def test_a_map_that_grows_keeps_what_was_known_inside() -> None:
    z = ground(5, (150, 160))
    whole = ElevationGrid(z, np.ones(z.shape, bool), (-0.75, -0.5), 0.05)
    part = ElevationGrid(z[10:130, 15:140].copy(), np.ones((120, 125), bool), (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(part, (2.0, 2.0), GraphParams(), 1)
    table = RiskTable(graph, part, BODY)
    table.evaluate_edges()
    graph.update(whole, [])
    grown = RiskTable(graph, whole, BODY, table)
    carried = ~np.isnan(edges_of(grown)[:, 0])
    fresh = RiskTable(graph, whole, BODY)
    fresh.evaluate_edges()
    assert 0.2 < carried.mean() < 0.9
    np.testing.assert_allclose(edges_of(grown)[carried], edges_of(fresh)[carried], atol=1e-5, rtol=0)


def test_another_body_resolution_or_raster_carries_nothing() -> None:
    grid = rough(1, size=3.0, resolution=0.1)
    graph = lattice(grid, 0.55, seed=2)
    table = RiskTable(graph, grid, BODY)
    table.evaluate_edges()
    assert RiskTable(graph, grid, BODY, table).evaluated()[0] == len(graph.indices)
    x, y = grid.origin
    for other, body in (
        (grid, BodyModel(width=0.5)),
        (ElevationGrid(grid.height, grid.trusted, grid.origin, 0.09), BODY),
        (ElevationGrid(grid.height, grid.trusted, (x + 0.03, y), 0.1), BODY),
    ):
        assert RiskTable(graph, other, body, table).evaluated() == (0, 0)


def test_edges_evaluated_ahead_change_no_route() -> None:
    grid = rough(3, size=4.0, resolution=0.05)
    graph = lattice(grid, 0.5, seed=3)
    ahead = RiskTable(graph, grid, BODY)
    ahead.evaluate_edges()
    assert ahead.evaluated() == (len(graph.indices), 0)
    rng = np.random.default_rng(0)
    for a, b in rng.integers(0, len(graph.nodes), (25, 2)).tolist():
        for variant in ("full", "edge-only", "mean-only"):
            request = PlanRequest(a, b, 0.4, None, variant)  # type: ignore[arg-type]
            one, two = plan(graph, grid, request, BODY, ahead), plan(graph, grid, request, BODY)
            assert (one.nodes, one.cost) == (two.nodes, two.cost)


def test_the_arcs_of_a_query_equal_those_made_from_its_graph() -> None:
    grid = ElevationGrid(ground(2), np.ones((110, 120), bool), (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(grid, (1.0, 1.0), GraphParams(), 2)
    table = RiskTable(graph, grid, BODY)
    for start, goal in (((1.0, 1.02), (4.0, 4.5)), ((2.0, 2.2), (2.1, 2.6))):
        query = endpoints(table, PlanRequest(start, goal, 0.3)).table
        assert len(query.arcs.target) > len(table.arcs.target)
        for got, want in zip(query.arcs, arcs_of(query.graph), strict=True):
            np.testing.assert_array_equal(got, want)


def test_the_arcs_after_an_update_equal_those_made_from_the_graph() -> None:
    grid = ElevationGrid(ground(3), np.ones((110, 120), bool), (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(grid, (1.0, 1.0), GraphParams(), 2)
    before = RiskTable(graph, grid, BODY)
    height = grid.height.copy()
    height[50:58, 50:58] += np.float32(0.4)
    after = ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)
    assert graph.update(after, [(50, 50, 58, 58)])
    for got, want in zip(RiskTable(graph, after, BODY, before).arcs, arcs_of(graph), strict=True):
        np.testing.assert_array_equal(got, want)
