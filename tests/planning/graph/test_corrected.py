"""The corrected graph: what the robot cannot drive over, no edge crosses; what it can, the graph reaches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mapping.grid import ElevationGrid
from planning import NoRoute
from planning.graph.describe import turn_is_free
from planning.graph.flags import FACE, HIGH, LOW, PLANTS, cell_flags
from planning.graph.graph import GraphParams, TraversalGraph
from tests.places import cases
from tests.planning.graph.scenes import WIDTH, Scene, crossing_edges, drivable, random_scene

RES = 0.04
PARAMS = GraphParams(blind_radius=0.0)


def _flat(
    width: float = 6.0, depth: float = 4.0, res: float = RES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y of the cell centres and zero heights, (rows, cols)."""
    cols, rows = round(width / res), round(depth / res)
    y, x = np.mgrid[0:rows, 0:cols] * res
    return x, y, np.zeros((rows, cols), np.float32)


def _grid(z: np.ndarray, trusted: np.ndarray | None = None, res: float = RES) -> ElevationGrid:
    trusted = np.ones(z.shape, bool) if trusted is None else trusted
    return ElevationGrid(z.astype(np.float32), trusted, (0.0, 0.0), res)


def _reaches(graph: TraversalGraph, xy: tuple[float, float]) -> bool:
    return graph.nearest_node(xy) is not None


@pytest.mark.parametrize("res", [0.02, 0.05])
@pytest.mark.parametrize("thick", [0.05, 0.10, 0.15])
@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 4])
def test_no_edge_crosses_a_thin_wall(thick: float, angle: float, res: float) -> None:
    x, y, z = _flat(res=res)
    across = (x - 3.0) * np.cos(angle) + (y - 2.0) * np.sin(angle)
    z[np.abs(across) <= 0.5 * thick + 1e-6] = 1.0
    graph = TraversalGraph.build(_grid(z, res=res), (1.0, 1.0), PARAMS, seed=2)
    side = (graph.nodes[:, 0] - 3.0) * np.cos(angle) + (graph.nodes[:, 1] - 2.0) * np.sin(angle)
    assert len(side) > 20
    assert side.max() < -0.2, "the far side and the wall itself are out of reach"


@pytest.mark.parametrize("res", [0.02, 0.05])
@pytest.mark.parametrize(
    ("height", "crossed"), [(0.05, True), (0.10, True), (0.13, False), (0.40, False), (-0.13, False)]
)
def test_a_ledge_is_crossed_up_to_the_step_limit(height: float, crossed: bool, res: float) -> None:
    x, _y, z = _flat(res=res)
    z[x > 3.0] = height
    z += 0.005 * np.random.default_rng(0).standard_normal(z.shape)
    graph = TraversalGraph.build(_grid(z, res=res), (1.0, 2.0), PARAMS)
    assert _reaches(graph, (5.0, 2.0)) == crossed


@pytest.mark.parametrize(("degrees", "climbed"), [(15.0, True), (24.0, True), (30.0, False)])
def test_a_ramp_is_climbed_up_to_the_slope_limit(degrees: float, climbed: bool) -> None:
    x, _, z = _flat(8.0)
    z += np.clip(x - 2.0, 0.0, 3.0) * np.tan(np.radians(degrees))
    z += 0.01 * np.random.default_rng(0).standard_normal(z.shape)
    graph = TraversalGraph.build(_grid(z), (1.0, 2.0), PARAMS)
    assert _reaches(graph, (7.0, 2.0)) == climbed


@pytest.mark.parametrize(("rise", "climbed"), [(0.10, True), (0.17, False)])
def test_stairs_are_climbed_up_to_the_step_limit(rise: float, climbed: bool) -> None:
    x, _, z = _flat(6.0, res=0.02)
    z += rise * np.clip(np.floor((x - 2.0) / 0.3) + 1, 0, 5)
    graph = TraversalGraph.build(_grid(z, res=0.02), (1.0, 2.0), PARAMS)
    assert _reaches(graph, (5.0, 2.0)) == climbed


@pytest.mark.parametrize(("gap", "crossed"), [(0.08, True), (0.25, False)])
def test_a_trench_is_crossed_up_to_the_gap_limit(gap: float, crossed: bool) -> None:
    x, _, z = _flat()
    z[np.abs(x - 3.0) <= 0.5 * gap] = -0.6
    graph = TraversalGraph.build(_grid(z), (1.0, 2.0), PARAMS)
    assert _reaches(graph, (5.0, 2.0)) == crossed


@pytest.mark.parametrize(("gap", "crossed"), [(0.08, True), (0.30, False)])
def test_an_unseen_slit_is_crossed_up_to_the_gap_limit(gap: float, crossed: bool) -> None:
    x, _, z = _flat()
    graph = TraversalGraph.build(_grid(z, np.abs(x - 3.0) > 0.5 * gap), (1.0, 2.0), PARAMS)
    assert _reaches(graph, (5.0, 2.0)) == crossed


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4])
def test_a_doorway_of_090_is_passed(seed: int, angle: float) -> None:
    x, y, z = _flat()
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-0.4, 0.4, 2)
    u = (x - 3.0 - shift[0]) * np.cos(angle) + (y - 2.0 - shift[1]) * np.sin(angle)
    v = -(x - 3.0 - shift[0]) * np.sin(angle) + (y - 2.0 - shift[1]) * np.cos(angle)
    z[(np.abs(u) < 0.08) & (np.abs(v) > 0.45)] = 1.0
    z += 0.01 * rng.standard_normal(z.shape)
    graph = TraversalGraph.build(_grid(z), (1.0, 1.5), PARAMS, seed=seed)
    assert _reaches(graph, (5.0, 2.0))


@pytest.mark.parametrize("seed", range(4))
def test_a_passage_of_070_is_followed(seed: int) -> None:
    x, y, z = _flat()
    rng = np.random.default_rng(seed)
    angle, shift = rng.uniform(0, np.pi), rng.uniform(-0.2, 0.2, 2)
    u = (x - 3.0 - shift[0]) * np.cos(angle) + (y - 2.0 - shift[1]) * np.sin(angle)
    v = -(x - 3.0 - shift[0]) * np.sin(angle) + (y - 2.0 - shift[1]) * np.cos(angle)
    z[(np.abs(u) < 0.8) & (np.abs(v) > 0.35)] = 1.0
    z += 0.005 * rng.standard_normal(z.shape)
    ahead = 1.25 * np.array([np.cos(angle), np.sin(angle)])
    middle = np.array([3.0, 2.0]) + shift
    graph = TraversalGraph.build(_grid(z), tuple(middle - ahead), PARAMS, seed=seed)
    assert _reaches(graph, tuple(middle + ahead))


def test_noise_and_single_outliers_do_not_block() -> None:
    rng = np.random.default_rng(1)
    _, _, z = _flat(res=0.02)
    z += 0.015 * rng.standard_normal(z.shape)
    bad = rng.random(z.shape) < 0.01
    z[bad] += rng.choice([-0.05, 0.05], bad.sum())
    graph = TraversalGraph.build(_grid(z, res=0.02), (1.0, 2.0), PARAMS)
    clean = TraversalGraph.build(_grid(np.zeros_like(z), res=0.02), (1.0, 2.0), PARAMS)
    assert graph.node_ids.tolist() == clean.node_ids.tolist()
    assert np.array_equal(graph.edges, clean.edges)


def test_the_blind_ring_at_the_start_is_bridged_but_not_more() -> None:
    x, y, z = _flat(8.0, 8.0)
    d = np.hypot(x - 4.0, y - 4.0)
    seen = (d < 0.4) | (d > 1.7)
    graph = TraversalGraph.build(_grid(z, seen), (4.0, 4.0), GraphParams())
    assert _reaches(graph, (1.0, 4.0))
    assert _reaches(graph, (4.0, 7.0))
    assert not graph.frontier[graph.nearest_node((4.0, 4.0))]
    with pytest.raises(NoRoute) as caught:
        TraversalGraph.build(_grid(z, (d > 1.7)), (4.0, 4.0), PARAMS)
    assert caught.value.reason == "start_not_on_graph"


def test_the_blind_ring_is_not_bridged_behind_a_wall() -> None:
    x, y, z = _flat(8.0, 8.0)
    wall = (np.abs(x - 4.8) < 0.1) & (y > 2.0) & (y < 6.0)
    z[wall] = 1.0
    d = np.hypot(x - 4.0, y - 4.0)
    seen = (d < 0.4) | (d > 1.7) | ((np.abs(x - 4.72) < 0.05) & (np.abs(y - 4.0) < 3.0))
    graph = TraversalGraph.build(_grid(z, seen), (4.0, 4.0), GraphParams())
    assert _reaches(graph, (3.4, 4.0))
    assert not _reaches(graph, (5.5, 4.0))
    # a wall that comes into sight later takes back what was assumed behind it
    grown = TraversalGraph.build(_grid(np.where(wall, 0.0, z), seen), (4.0, 4.0), GraphParams())
    assert _reaches(grown, (5.5, 4.0))
    grown.update(_grid(z, seen), [(0, 0, *z.shape)])
    np.testing.assert_array_equal(grown.node_ids, graph.node_ids)
    np.testing.assert_array_equal(grown.edges, graph.edges)


def test_frontiers_are_where_the_unseen_begins() -> None:
    x, _, z = _flat()
    z[:4] = z[-4:] = 1.0
    z[:, :4] = 1.0
    trusted = x < 4.0
    graph = TraversalGraph.build(_grid(z, trusted), (1.0, 2.0), PARAMS)
    assert graph.frontier.any()
    assert graph.nodes[graph.frontier, 0].min() > 3.0
    assert graph.frontier[graph.nodes[:, 0] > 3.7].all()


def test_the_graph_is_deterministic_and_seeded() -> None:
    _, _, z = _flat()
    z[40:50, 60:70] = 0.5
    a = TraversalGraph.build(_grid(z), (1.0, 2.0), PARAMS, seed=5)
    b = TraversalGraph.build(_grid(z), (1.0, 2.0), PARAMS, seed=5)
    c = TraversalGraph.build(_grid(z), (1.0, 2.0), PARAMS, seed=6)
    for name in ("nodes", "indices", "risk", "node_ids", "turn_price"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
    assert a.nodes.tobytes() != c.nodes.tobytes()


@pytest.mark.parametrize(
    ("start", "reason"),
    [((np.nan, 1.0), "bad_input"), ((50.0, 1.0), "outside_map"), ((3.0, 2.0), "start_not_on_graph")],
)
def test_a_bad_start_is_a_typed_error(start: tuple[float, float], reason: str) -> None:
    x, y, z = _flat()
    z[np.hypot(x - 3.0, y - 2.0) < 0.9] = 1.0
    with pytest.raises(NoRoute) as caught:
        TraversalGraph.build(_grid(z, np.hypot(x - 3.0, y - 2.0) > 0.8), start, PARAMS)
    assert caught.value.reason == reason


def test_a_map_without_trusted_cells_is_a_typed_error() -> None:
    _, _, z = _flat()
    with pytest.raises(NoRoute) as caught:
        TraversalGraph.build(_grid(z, np.zeros(z.shape, bool)), (1.0, 1.0))
    assert caught.value.reason == "no_terrain"


@pytest.mark.parametrize("seed", range(6))
def test_on_random_ground_no_swept_footprint_covers_a_wall_a_ledge_or_a_pit(seed: int) -> None:
    scene = random_scene(seed, res=0.02 if seed % 4 == 0 else 0.04, noise=0.005)
    # with gaps allowed, what a wall cuts off a pit may be too narrow to count
    params = GraphParams(blind_radius=0.0, max_gap=0.0)
    graph = TraversalGraph.build(scene.grid, scene.start, params, seed)
    assert len(graph.edges) > 300
    assert crossing_edges(graph, scene, shrink=0.0, step=0.12) == []


@pytest.mark.parametrize("res", [0.02, 0.04])
@pytest.mark.parametrize("seed", range(3))
def test_the_corners_of_a_wide_pit_are_no_gap_to_drive_over(seed: int, res: float) -> None:
    rng = np.random.default_rng(seed)
    x, y, z = _flat(5.0, 5.0, res)
    label = np.zeros(z.shape, int)
    for k, (cx, cy) in enumerate([(1.2, 1.2), (1.2, 3.8), (3.8, 1.2), (3.8, 3.8), (2.5, 2.5)]):
        a = rng.uniform(0, np.pi)
        u = (x - cx) * np.cos(a) + (y - cy) * np.sin(a)
        v = -(x - cx) * np.sin(a) + (y - cy) * np.cos(a)
        pit = (
            np.abs(u) + np.abs(v) < rng.uniform(0.3, 0.5) if k % 2 else (np.abs(u) < 0.4) & (np.abs(v) < 0.25)
        )
        label[pit] = k + 1
        z[pit] -= 0.5
    z += 0.005 * rng.standard_normal(z.shape)
    grid = _grid(z, res=res)
    graph = TraversalGraph.build(grid, (2.5, 0.7), PARAMS, seed)
    assert len(graph.edges) > 150
    assert crossing_edges(graph, Scene(grid, label, (2.5, 0.7)), shrink=0.0, step=0.12) == []


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 4])
def test_a_crack_is_driven_across_but_not_along(angle: float) -> None:
    x, y, z = _flat(6.0, 6.0, 0.02)
    across = -(x - 3.0) * np.sin(angle) + (y - 3.0) * np.cos(angle)
    z[np.abs(across) < 0.04] -= 0.5
    graph = TraversalGraph.build(_grid(z, res=0.02), (3.0 + np.sin(angle), 3.0 - np.cos(angle)), PARAMS)
    a, b = (graph.nodes[graph.edges[:, k], :2] - 3.0 for k in (0, 1))
    side_a, side_b = (-p[:, 0] * np.sin(angle) + p[:, 1] * np.cos(angle) for p in (a, b))
    over = side_a * side_b < 0.0
    assert over.sum() > 10
    slant = np.abs(side_a - side_b)[over] / np.hypot(*(a - b)[over].T)
    # three cells wide: a line that is over it for a gap of 0.10 m and a cell meets it at 30 deg
    assert slant.min() > np.sin(np.radians(28.0))
    beside = ~over & (np.abs(side_a - side_b) < 0.05)
    assert beside.any()
    assert np.abs(side_a + side_b)[beside].min() > WIDTH, "no wheel above the crack"


@pytest.mark.parametrize("seed", cases(4, 2))
def test_on_random_ground_all_that_can_be_driven_to_is_covered(seed: int) -> None:
    scene = random_scene(seed)
    graph = TraversalGraph.build(scene.grid, scene.start, PARAMS, seed)
    reachable = drivable(scene, grow=0.05)
    gap, _ = cKDTree(graph.nodes[:, :2]).query(reachable)
    assert len(reachable) > 3000
    assert np.mean(gap > 0.5) < 0.005
    possible = drivable(scene, grow=-0.04)
    off, _ = cKDTree(possible).query(graph.nodes[:, :2])
    assert off.max() < 0.15, "no node where the robot could not get to"


def test_headings_that_fit_are_told_apart_from_those_that_do_not() -> None:
    _, y, z = _flat(6.0, 4.0)
    z[np.abs(y - 2.0) > 0.36] = 1.0  # a corridor 0.72 m wide: along it fits, across it does not
    graph = TraversalGraph.build(_grid(z), (1.0, 2.0), PARAMS)
    node = graph.nearest_node((3.0, 2.0))
    assert node is not None
    mask = graph.free_headings[node]
    for k in range(36):
        c, s = abs(np.cos(np.radians(5 * k))), abs(np.sin(np.radians(5 * k)))
        off = abs(graph.nodes[node, 1] - 2.0)
        half = 0.35 * s + 0.215 * c
        if abs(half + off - 0.38) > 0.05:  # the wall's face is known to a cell
            assert bool(mask >> np.uint64(k) & np.uint64(1)) == (half + off < 0.38)
    assert turn_is_free(mask, 0.1, -0.2)
    assert turn_is_free(mask, np.pi - 0.1, 0.2)
    assert not turn_is_free(mask, 0.0, np.pi)
    assert not turn_is_free(mask, -0.5, -1.0)
    wide = TraversalGraph.build(_grid(np.zeros_like(z)), (1.0, 2.0), PARAMS)
    assert turn_is_free(wide.free_headings[0], 0.0, np.pi)


def test_the_graph_holds_both_sides_of_unseen_ground_that_the_robot_stands_before() -> None:
    """Which of them it can leave to is for the test of its first move to tell: that one knows where the robot
    stands."""
    x, _, z = _flat()
    trusted = np.abs(x - 1.6) > 0.09
    graph = TraversalGraph.build(_grid(z, trusted), (1.5, 2.0), PARAMS)
    assert _reaches(graph, (0.6, 2.0))
    assert _reaches(graph, (4.0, 2.0))
    assert not crossing_edges_of_slit(graph)
    far = TraversalGraph.build(_grid(z, trusted), (0.7, 2.0), PARAMS)
    assert not _reaches(far, (4.0, 2.0))


def crossing_edges_of_slit(graph: TraversalGraph) -> list[tuple[int, int]]:
    sides = graph.nodes[:, 0] > 1.6
    return [(a, b) for a, b in graph.edges.tolist() if sides[a] != sides[b]]


def test_no_face_rises_to_ground_of_which_only_a_bound_is_known() -> None:
    x, _y, z = _flat()
    virtual = (x > 2.0) & (x < 4.0)
    z[virtual & (np.abs(x - 3.0) < 0.06)] = 0.57  # filled from a wall: the rays there passed no lower
    grid = ElevationGrid(z, ~virtual, (0.0, 0.0), RES, virtual)
    assert _reaches(TraversalGraph.build(grid, (1.0, 2.0), PARAMS), (5.0, 2.0))
    measured = ElevationGrid(z, ~virtual | (z > 0.5), (0.0, 0.0), RES, virtual & (z < 0.5))
    assert not _reaches(TraversalGraph.build(measured, (1.0, 2.0), PARAMS), (5.0, 2.0))
    z[:] = 0.0
    z[x >= 2.0] = -0.4  # beyond an edge nothing is higher than that
    deep = ElevationGrid(z, ~virtual, (0.0, 0.0), RES, virtual)
    assert not _reaches(TraversalGraph.build(deep, (1.0, 2.0), PARAMS), (5.0, 2.0))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("way", [1, -1])
def test_where_a_bound_tells_of_a_drop_it_begins_behind_the_last_ground_that_was_seen(
    axis: int, way: int
) -> None:
    # As seen from the platform of `rescue_elevated` beside its bridge: behind the edge the rays pass ever lower.
    z = np.zeros((40, 40), np.float32)
    z[20:] = -np.linspace(0.04, 2.0, 20)[:, None]
    virtual = np.zeros(z.shape, bool)
    virtual[20:] = True
    z, virtual = (np.ascontiguousarray((a if axis == 0 else a.T)[::way, ::way]) for a in (z, virtual))
    flags = cell_flags(z, ~virtual, virtual, RES, 0.20, 0.03, np.tan(np.radians(25.0)), 3, 6)[0]
    flags = (flags if axis == 0 else flags.T)[::way, ::way]
    assert (flags[19, 8:32] & HIGH > 0).all()
    assert (flags[20, 8:32] & LOW > 0).all()
    assert not (flags[:19] & FACE).any()


def test_no_edge_leads_over_a_hole_that_the_map_tells_to_be_wide_and_it_is_free_again_without_it() -> None:
    z = np.zeros((80, 140), np.float32)
    free = ElevationGrid(z, np.ones(z.shape, bool), (0.0, 0.0), RES)
    holes = np.zeros(z.shape, bool)
    holes[::5, 70] = True  # a cell here and there, as rays show them
    graph = TraversalGraph.build(free, (0.8, 1.6), GraphParams(), 0)

    def across() -> int:
        source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
        a, b = graph.nodes[source, 0], graph.nodes[graph.indices, 0]
        return int(((a < 70 * RES) & (b > 70 * RES)).sum())

    assert across() > 10
    graph.update(replace(free, holes=holes), [(0, 0, *z.shape)], (0.8, 1.6))
    assert across() == 0
    graph.update(free, [(0, 0, *z.shape)], (0.8, 1.6))
    assert across() > 10


def test_a_way_through_leaves_counts_as_long_as_it_takes_and_is_free_again_without_them() -> None:
    z = np.zeros((80, 140), np.float32)
    free = ElevationGrid(z, np.ones(z.shape, bool), (0.0, 0.0), RES)
    leaves = np.zeros(z.shape, bool)
    leaves[:, 50:100] = True
    start = (0.8, 1.6)
    graph = TraversalGraph.build(free, start, GraphParams(), 0)
    assert graph.cells is not None
    before = graph.cells.flags.copy()
    whole = [(0, 0, *z.shape)]

    def risks() -> tuple[float, float]:
        """Of edges that lie in the leaves with all of their corridor, and of those that lie beyond."""
        source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
        a, b = graph.nodes[source, 0], graph.nodes[graph.indices, 0]
        low, high = np.minimum(a, b), np.maximum(a, b)
        inside = (low > 50 * RES + 0.4) & (high < 99 * RES - 0.4)
        beside = high < 49 * RES - 0.4
        assert inside.sum() > 10
        assert beside.sum() > 10
        return float(graph.risk[inside].max()), float(graph.risk[beside].max())

    assert risks() == (0.0, 0.0)
    graph.update(replace(free, plants=leaves), whole, start)
    np.testing.assert_array_equal(graph.cells.flags & PLANTS > 0, leaves)
    priced, beyond = risks()
    assert priced == pytest.approx(0.5, abs=1e-6)
    assert beyond == 0.0
    graph.update(free, whole, start)
    np.testing.assert_array_equal(graph.cells.flags, before)
    assert risks() == (0.0, 0.0)
