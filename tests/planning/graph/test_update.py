"""Local updates give what a full rebuild gives, keep ids and memory, and follow a growing map."""

from __future__ import annotations

import gc

import numpy as np
import psutil
import pytest

from mapping.grid import ElevationGrid
from planning import PlanningError
from planning.graph.graph import GraphParams, TraversalGraph
from tests.planning.graph.scenes import random_scene

PARAMS = GraphParams(blind_radius=0.0)
ARRAYS = ("nodes", "indptr", "indices", "risk", "frontier", "turn_price", "free_headings", "node_ids")


def _with(grid: ElevationGrid, height: np.ndarray) -> ElevationGrid:
    return ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)


def _assert_same(a: TraversalGraph, b: TraversalGraph) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.parametrize("seed", range(3))
def test_after_any_change_the_graph_equals_a_full_rebuild(seed: int) -> None:
    scene = random_scene(seed, size=6.0)
    rng = np.random.default_rng(seed)
    z = scene.grid.height.copy()
    graph = TraversalGraph.build(scene.grid, scene.start, PARAMS, seed)
    differing = 0
    for _ in range(12):
        r, c = rng.integers(0, 130, 2)
        if np.hypot(r + 10 - 75, c + 10 - 75) < 35:
            c += 60  # not on the start
        h, w = rng.integers(2, 30, 2)
        z = z.copy()
        z[r : r + h, c : c + w] += rng.choice([0.005, 0.3, -0.3, 1.0]) * rng.standard_normal()
        grid = _with(scene.grid, z)
        changed = graph.update(grid, [(r, c, r + h, c + w)])
        _assert_same(graph, TraversalGraph.build(grid, scene.start, PARAMS, seed))
        differing += changed
    assert differing >= 4
    assert graph.version == 13


@pytest.mark.parametrize("seed", range(3))
def test_nodes_drawn_anew_in_places_leave_the_rest_as_it_is_and_follow_the_map(seed: int) -> None:
    scene = random_scene(seed, size=6.0)
    graph = TraversalGraph.build(scene.grid, scene.start, PARAMS, seed)
    before, cells = {name: getattr(graph, name).copy() for name in ARRAYS}, graph.cells
    assert cells is not None
    where = cells.where.copy()
    places = np.array([scene.start, (9.0, -9.0)])  # the second is off the map
    first, second, again = (graph.redrawn(scene.grid, places, 1.0, sample) for sample in (1, 2, 1))
    for name, array in before.items():
        np.testing.assert_array_equal(getattr(graph, name), array)
    np.testing.assert_array_equal(cells.where, where)
    _assert_same(first, again)
    _assert_same(first.redrawn(scene.grid, places, 1.0, 0), graph)
    side = cells.side
    for drawn in (first, second):
        place_of = {
            int(i): tuple(xy)
            for g in (graph, drawn)
            for i, xy in zip(g.node_ids, g.nodes[:, :2].tolist(), strict=True)
        }
        for g in (graph, drawn):
            assert [place_of[int(i)] for i in g.node_ids] == [*map(tuple, g.nodes[:, :2].tolist())], (
                "an id is one place"
            )
        assert np.array_equal(drawn.version, graph.version + 1)
        far = np.abs(drawn.nodes[:, :2] - scene.start).max(axis=1) > 1.0 + side
        assert np.isin(drawn.node_ids[far], graph.node_ids).all()
        near = np.abs(drawn.nodes[:, :2] - scene.start).max(axis=1) < 1.0 - side
        assert near.sum() >= 5
        assert not np.isin(drawn.node_ids[near], graph.node_ids).any()
    assert not np.isin(first.node_ids, second.node_ids).all()
    # the map changes, in one place of those and beside it: the same as drawn anew on the map of then
    z = scene.grid.height.copy()
    r, c = (
        round((at - o) / scene.grid.resolution)
        for at, o in zip(scene.start[::-1], scene.grid.origin[::-1], strict=True)
    )
    z[r + 10 : r + 40, c + 8 : c + 12] += 0.5
    grid = _with(scene.grid, z)
    first.update(grid, [(r + 10, c + 8, r + 40, c + 12)])
    _assert_same(first, TraversalGraph.build(grid, scene.start, PARAMS, seed).redrawn(grid, places, 1.0, 1))


def test_an_obstacle_kills_nodes_at_once_and_they_stay_away_until_it_leaves() -> None:
    scene = random_scene(1, size=6.0)
    graph = TraversalGraph.build(scene.grid, scene.start, PARAMS)
    before = graph.node_ids.copy()
    z = scene.grid.height.copy()
    window = (90, 70, 105, 85)  # 0.6 m square, 1 m high, 0.6 m beside the start
    z[90:105, 70:85] += 1.0
    box = (70 * 0.04, 90 * 0.04, 84 * 0.04, 104 * 0.04)

    def inside() -> int:
        x, y = graph.nodes[:, 0], graph.nodes[:, 1]
        return int(np.sum((x > box[0] - 0.2) & (x < box[2] + 0.2) & (y > box[1] - 0.2) & (y < box[3] + 0.2)))

    assert inside() > 0
    for _ in range(5):
        graph.update(_with(scene.grid, z), [window])
        assert inside() == 0
    kept = np.isin(before, graph.node_ids)
    assert kept.mean() > 0.8, "nodes elsewhere keep their ids"
    graph.update(scene.grid, [window])
    assert graph.node_ids.tolist() == before.tolist()


def test_a_growing_map_extends_the_graph_and_equals_a_full_rebuild() -> None:
    scene = random_scene(4, size=8.0)
    full = scene.grid
    n = full.shape[0]
    graph = None
    for lo, hi in ((60, 140), (50, 150), (20, 150), (0, 190), (0, n)):
        part = ElevationGrid(
            full.height[lo:hi, lo:hi], full.trusted[lo:hi, lo:hi], (lo * 0.04, lo * 0.04), full.resolution
        )
        if graph is None:
            graph = TraversalGraph.build(part, scene.start, PARAMS)
            ids = graph.node_ids
        else:
            nodes = len(graph.nodes)
            assert graph.update(part, [])
            assert len(graph.nodes) > nodes
        _assert_same_but_rounding(graph, TraversalGraph.build(part, scene.start, PARAMS))
    assert np.isin(ids, graph.node_ids).mean() > 0.7
    assert graph.frontier.sum() > 0


def test_a_map_that_became_smaller_has_no_edges_beyond_its_border() -> None:
    """Such as one that begins anew. Edges into the part that went pointed at no cell, or at one on the other side."""
    scene = random_scene(4, size=8.0)
    full, n = scene.grid, scene.grid.shape[0]
    graph = TraversalGraph.build(full, scene.start, PARAMS)
    for lo, hi in ((0, n - 31), (23, n - 31), (23, n - 52), (41, n - 52)):
        where = (lo * full.resolution, lo * full.resolution)
        part = ElevationGrid(full.height[lo:hi, lo:hi], full.trusted[lo:hi, lo:hi], where, full.resolution)
        graph.update(part, [])
        _assert_same_but_rounding(graph, TraversalGraph.build(part, scene.start, PARAMS))


def _assert_same_but_rounding(a: TraversalGraph, b: TraversalGraph) -> None:
    np.testing.assert_array_equal(a.node_ids, b.node_ids)
    np.testing.assert_array_equal(a.edges, b.edges)
    np.testing.assert_allclose(a.nodes, b.nodes, atol=1e-9)
    np.testing.assert_allclose(a.risk, b.risk, atol=1e-4)


def test_seen_terrain_replaces_frontiers() -> None:
    scene = random_scene(3, size=6.0)
    x = np.arange(150) * 0.04
    half = ElevationGrid(
        scene.grid.height,
        np.broadcast_to(x < 3.6, (150, 150)).copy(),
        scene.grid.origin,
        scene.grid.resolution,
    )
    graph = TraversalGraph.build(half, scene.start, PARAMS)
    assert graph.nodes[:, 0].max() < 3.6
    assert graph.frontier[graph.nodes[:, 0] > 3.0].any()
    graph.update(scene.grid, [(0, 90, 150, 150)])
    _assert_same(graph, TraversalGraph.build(scene.grid, scene.start, PARAMS))
    assert graph.nodes[:, 0].max() > 4.5


def test_a_thousand_updates_of_a_standing_robot_stay_flat() -> None:
    rng = np.random.default_rng(0)
    z = np.zeros((44, 44), np.float32)
    z[:4] = 0.5
    grid = ElevationGrid(z.copy(), np.ones(z.shape, bool), (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(grid, (1.1, 1.1), PARAMS)
    ids = graph.node_ids.copy()
    edges = graph.edges
    process = psutil.Process()
    resident = 0
    for k in range(1000):
        noise = rng.normal(0.0, 0.005, (12, 12)).astype(np.float32)
        grid.height[16:28, 16:28] = z[16:28, 16:28] + noise  # in place, as a mapper's buffer is
        graph.update(grid, [(16, 16, 28, 28)])
        assert graph.node_ids.tobytes() == ids.tobytes()
        if k == 100:
            gc.collect()
            resident = process.memory_info().rss
    gc.collect()
    np.testing.assert_array_equal(graph.edges, edges)
    assert graph.version == 1001
    assert process.memory_info().rss - resident < 0.4e6, "444 bytes an update"


def test_a_start_in_a_new_obstacle_keeps_the_graph_of_before() -> None:
    scene = random_scene(5, size=6.0)
    graph = TraversalGraph.build(scene.grid, scene.start, PARAMS)
    before = len(graph.nodes)
    z = scene.grid.height.copy()
    z[60:90, 60:90] += np.random.default_rng(0).uniform(0.2, 1.0, (30, 30)).astype(np.float32)
    graph.update(_with(scene.grid, z), [(60, 60, 90, 90)])
    assert len(graph.nodes) > 0.6 * before
    assert graph.nearest_node(scene.start) is None


def test_bad_updates_are_typed_errors() -> None:
    scene = random_scene(0, size=6.0)
    graph = TraversalGraph.build(scene.grid, scene.start, PARAMS)
    grid = scene.grid
    moved = ElevationGrid(grid.height, grid.trusted, (0.013, 0.0), grid.resolution)
    with pytest.raises(PlanningError, match="align"):
        graph.update(moved, [])
    coarse = ElevationGrid(grid.height, grid.trusted, (0.0, 0.0), 0.05)
    with pytest.raises(PlanningError, match="resolution"):
        graph.update(coarse, [])
    _assert_same(graph, TraversalGraph.build(grid, scene.start, PARAMS))
    bare = TraversalGraph.from_edges(graph.nodes, graph.edges, np.zeros(len(graph.edges)))
    with pytest.raises(PlanningError, match="no map"):
        bare.update(grid, [])


def crossings(keep: float) -> tuple[int, int]:
    """Maps of a noisy kerb at the step limit: how often the ground beyond it stayed reachable to the next, and of how
    many."""
    rng = np.random.default_rng(4)
    x = np.mgrid[0:75, 0:100][1] * 0.04
    graph, stayed, were = None, 0, 0
    before = False
    for _ in range(24):
        # the whole face is off by as much: errors of a map are alike over a hand's breadth
        z = np.where(x > 2.0, 0.10 + rng.normal(0.0, 0.02), 0.0) + rng.normal(0.0, 0.003, x.shape)
        grid = ElevationGrid(z.astype(np.float32), np.ones(x.shape, bool), (0.0, 0.0), 0.04)
        if graph is None:
            graph = TraversalGraph.build(grid, (1.0, 1.5), GraphParams(blind_radius=0.0, keep_step=keep), 0)
        else:
            graph.update(grid, [(0, 0, *x.shape)])
        now = bool(graph.nodes[:, 0].max() > 2.5)
        were += before
        stayed += before and now
        before = now
    return stayed, were


def test_a_way_over_a_face_at_the_limit_stays_open_while_the_map_is_noisy() -> None:
    stayed, were = crossings(0.03)
    assert were > 15
    assert stayed >= 0.9 * were
    stayed, were = crossings(0.0)
    assert 0 < stayed < 0.85 * were


def test_what_was_too_high_must_come_down_to_the_limit_and_what_rises_far_above_it_goes() -> None:
    x = np.mgrid[0:75, 0:100][1] * 0.04
    graph = None
    reached = []
    for height in (0.125, 0.09, 0.125, 0.16, 0.125, 0.09):
        z = np.where(x > 2.0, height, 0.0).astype(np.float32)
        grid = ElevationGrid(z, np.ones(x.shape, bool), (0.0, 0.0), 0.04)
        if graph is None:
            graph = TraversalGraph.build(grid, (1.0, 1.5), GraphParams(blind_radius=0.0, keep_step=0.03), 0)
        else:
            graph.update(grid, [(0, 0, *x.shape)])
        reached.append(bool(graph.nodes[:, 0].max() > 2.5))
    assert reached == [False, True, True, False, False, True]
