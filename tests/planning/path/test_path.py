"""Paths: ends, corridor, spacing, risk not above the route's, speeds the robot can keep."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hal.rotation import wrap
from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from planning.path import PathLimits, make_path, rest_of, smooth_route, still_safe
from planning.path.speed import speeds
from planning.path.spline import curve, distance_along, reach_limits
from planning.risk.body import BodyModel, edge_poses, pose_features, sweep_poses
from planning.search.plan import PlanRequest, plan
from tests.planning.worlds import flat, lattice, rough

BODY = BodyModel()
LIMITS = PathLimits()


def distance_to_polyline(points, vertices):
    """(n,) distance of each point from all of the polyline [m]."""
    a, b = vertices[:-1], vertices[1:]
    ab = b - a
    rel = points[:, None] - a[None]
    t = np.clip((rel * ab).sum(-1) / np.maximum((ab * ab).sum(-1), 1e-18), 0.0, 1.0)
    return np.hypot(*(rel - t[..., None] * ab).transpose(2, 0, 1)).min(1)


def zigzag():
    """A route with corners of 30 to 120 degrees on level ground."""
    grid = flat(6, 4)
    xy = np.array([[0.6, 2.0], [1.4, 2.0], [2.0, 2.5], [2.6, 1.6], [3.3, 1.6], [3.4, 2.3], [4.5, 2.3]])
    edges = np.column_stack([np.arange(len(xy) - 1), np.arange(1, len(xy))])
    return grid, TraversalGraph.from_edges(
        np.column_stack([xy, np.zeros(len(xy))]), edges, np.zeros(len(edges))
    )


def test_the_path_keeps_ends_spacing_and_corridor():
    grid, graph = zigzag()
    path = make_path(plan(graph, grid, PlanRequest(0, 6)), grid, BODY)
    np.testing.assert_array_equal(path.points[[0, -1], :2], graph.nodes[[0, 6], :2])
    gaps = np.hypot(*np.diff(path.points[:, :2], axis=0).T)
    assert gaps.max() <= 0.02 + 1e-6
    np.testing.assert_allclose(np.diff(path.s), gaps)
    away = distance_to_polyline(path.points[:, :2], graph.nodes[:, :2])
    assert 0.02 < away.max() <= LIMITS.corridor
    bend = np.abs(wrap(np.diff(path.yaw)))
    assert bend.max() < np.radians(20), "a rounded path has no kinks"


def test_speed_respects_curvature_braking_and_the_stop_at_the_end():
    grid, graph = zigzag()
    path = make_path(plan(graph, grid, PlanRequest(0, 6)), grid, BODY)
    ds = np.diff(path.s)
    accel = np.diff(path.speed**2) / (2 * ds)
    assert accel.min() >= -LIMITS.max_accel - 1e-6
    assert accel.max() <= LIMITS.max_accel + 1e-6
    assert path.speed[-1] == 0.0
    assert path.speed.max() <= LIMITS.max_speed
    rate = path.speed[:-1] * np.abs(wrap(np.diff(path.yaw))) / ds
    assert rate[path.speed[:-1] > LIMITS.min_speed].max() <= LIMITS.max_yaw_rate + 1e-6


def test_rough_and_sloped_ground_is_driven_more_slowly():
    def top_speed(height):
        grid = ElevationGrid(height.astype(np.float32), np.ones((81, 121), bool), (0.0, 0.0), 0.05)
        _, graph = zigzag()
        return make_path(plan(graph, grid, PlanRequest(0, 6)), grid, BODY).speed.max()

    level = np.zeros((81, 121))
    slope = np.tan(np.radians(15)) * np.arange(121) * 0.05 + level
    bumps = 0.05 * np.random.default_rng(0).uniform(size=level.shape)
    assert top_speed(slope) < 0.8 * top_speed(level)
    assert top_speed(bumps) < 0.95 * top_speed(level)


def test_a_slope_within_the_limits_alone_is_no_reason_to_be_slower_than_it_was_measured_at():
    def top_speed(height):
        grid = ElevationGrid(height.astype(np.float32), np.ones((81, 121), bool), (0.0, 0.0), 0.05)
        _, graph = zigzag()
        return make_path(
            plan(graph, grid, PlanRequest(0, 6)), grid, BODY, PathLimits(max_speed=0.5)
        ).speed.max()

    level, along = np.zeros((81, 121)), np.arange(121) * 0.05
    assert top_speed(level + np.tan(np.radians(15)) * along) > 0.9 * top_speed(level)
    side = np.tan(np.radians(15)) * 0.05 * np.arange(81)[:, None]
    assert top_speed(level + side) < 0.9 * top_speed(level), "it may slide"


def test_the_ends_are_on_the_path_and_the_first_turn_is_told():
    grid, graph = zigzag()
    request = PlanRequest(0, 6, start_yaw=np.pi, goal_yaw=1.0)
    path = make_path(plan(graph, grid, request), grid, BODY)
    np.testing.assert_allclose(path.points[[0, -1], :2], graph.nodes[[0, 6], :2])
    assert path.initial_turn is not None
    assert (
        np.pi + path.initial_turn == pytest.approx(path.yaw[0] + 2 * np.pi, abs=0.01) or path.initial_turn < 0
    )
    assert abs(path.initial_turn) > 2.5, "the route starts behind the robot: it has to turn around first"
    assert path.goal_yaw == 1.0


def test_start_at_the_goal_is_a_single_point():
    grid, graph = zigzag()
    path = make_path(plan(graph, grid, PlanRequest(2, 2, 0.3, 1.2)), grid, BODY)
    assert path.points.shape == (1, 3)
    assert path.speed.tolist() == [0.0]
    assert path.length == 0.0
    assert path.yaw.tolist() == [0.3]


@pytest.mark.parametrize("seed", range(6))
def test_the_paths_risk_is_not_above_the_routes(seed):
    grid = rough(seed, size=4.0, resolution=0.05)
    graph = lattice(grid, 0.5, seed)
    route = plan(graph, grid, PlanRequest(0, len(graph.nodes) - 1))
    path = make_path(route, grid, BODY)
    xy = route.points[:, :2]
    dense = BODY.model_copy(update={"edge_step": 0.02})
    legs = [edge_poses(a, b, dense) for a, b in pairwise(xy)]
    turns = [sweep_poses(p[0, 0], p[0, 1], q[0, 2], p[0, 2], dense) for q, p in pairwise(legs)]
    want = pose_features(grid, np.concatenate(legs + turns), BODY)
    got = pose_features(grid, np.column_stack([path.points[:, :2], path.yaw]), BODY)
    assert ((got.max(0) - want.max(0))[:3] <= 0.0051 * BODY.scales[:3]).all()
    assert distance_to_polyline(path.points[:, :2], xy).max() <= LIMITS.corridor + 1e-9
    np.testing.assert_allclose(path.worst, got.max(0)[:3], rtol=0.2, atol=0.05)


def test_a_corner_beside_a_post_stays_sharp():
    grid, graph = zigzag()
    height = grid.height.copy()
    free = make_path(plan(graph, grid, PlanRequest(0, 6)), grid, BODY)
    # A post just inside the widest corner, where only the rounded path would pass over it.
    inner = graph.nodes[3, :2] + np.array([-0.02, 0.40])
    height[round(inner[1] / 0.05), round(inner[0] / 0.05)] = 0.3
    posted = ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)
    route = plan(graph, posted, PlanRequest(0, 6))
    path = make_path(route, posted, BODY)
    got = pose_features(posted, np.column_stack([path.points[:, :2], path.yaw]), BODY)
    cut = pose_features(posted, np.column_stack([free.points[:, :2], free.yaw]), BODY)
    assert got[:, 2].max() <= cut[:, 2].max()


def test_sharp_corners_are_kept_exactly():
    vertices = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    xy, owner = curve(vertices, np.zeros(3), 0.02)
    assert distance_to_polyline(xy, vertices).max() < 1e-12
    assert np.hypot(*(xy - [1.0, 0.0]).T).min() < 1e-9
    assert set(owner.tolist()) == {0, 1, 2}
    assert reach_limits(vertices, 0.08)[1] == pytest.approx(6 * 0.98 * 0.08 / np.sqrt(2))


def test_a_path_stops_being_safe_when_a_wall_or_a_hole_in_the_graph_appears():
    grid, graph = zigzag()
    path = make_path(plan(graph, grid, PlanRequest(0, 6)), grid, BODY)
    assert still_safe(path, graph, grid, BODY) == (True, "")
    height = grid.height.copy()
    height[:, 60] = 0.5
    walled = ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)
    ok, why = still_safe(path, graph, walled, BODY)
    assert not ok
    assert "0.50 m face" in why
    shorter = TraversalGraph.from_edges(graph.nodes[:3], np.array([[0, 1], [1, 2]]), np.zeros(2))
    ok, why = still_safe(path, shorter, grid, BODY)
    assert not ok
    assert "no drivable ground" in why


@pytest.mark.parametrize("seed", range(5))
def test_the_distance_from_the_route_equals_that_from_all_of_it(seed):
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.uniform(-1.0, 1.0, 40)) * 0.6
    steps = rng.uniform(0.15, 0.6, 40)[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    vertices = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    xy, owner = curve(vertices, reach_limits(vertices, 0.08), 0.02)
    assert (np.diff(owner) >= 0).all()
    got = distance_along(xy, owner, vertices, 0.08)
    assert got.max() > 0.01
    np.testing.assert_allclose(got, distance_to_polyline(xy, vertices), atol=1e-9)


def test_a_route_that_crosses_itself_is_left_where_it_is_left():
    vertices = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    point, owner = np.array([[1.0, 0.5]]), np.array([1])
    assert distance_to_polyline(point, vertices)[0] == 0.0
    assert distance_along(point, owner, vertices, 0.08)[0] == pytest.approx(0.5)


def test_a_smooth_route_keeps_ends_corridor_and_spacing_and_looks_at_no_map():
    rng = np.random.default_rng(5)
    for _ in range(20):
        turns = rng.uniform(-2.2, 2.2, 12).cumsum()
        vertices = np.cumsum(
            rng.uniform(0.3, 0.6, (12, 1)) * np.column_stack([np.cos(turns), np.sin(turns)]), 0
        )
        line = smooth_route(vertices)
        np.testing.assert_array_equal(line[[0, -1]], vertices[[0, -1]])
        assert np.hypot(*np.diff(line, axis=0).T).max() <= 0.02 + 1e-6
        assert distance_to_polyline(line, vertices).max() <= 0.08 + 1e-9
        assert distance_to_polyline(vertices, line).max() <= 0.08 + 1e-9, "every vertex is passed"
        tight = smooth_route(vertices, corridor=0.02, spacing=0.05)
        assert distance_to_polyline(tight, vertices).max() <= 0.02 + 1e-9
        assert len(tight) < len(line)
    grid, graph = zigzag()
    path = make_path(plan(graph, grid, PlanRequest(0, 6)), grid, BODY)
    np.testing.assert_allclose(
        smooth_route(graph.nodes[:, :2]),
        path.points[:, :2],
        atol=1e-9,
        err_msg="on level ground no risk objects",
    )


def test_a_smooth_route_turns_back_in_place():
    out_and_back = np.array([[0.0, 0.0], [1.0, 0.0], [0.05, 0.05]])
    line = smooth_route(out_and_back)
    assert (np.hypot(*(line - (1.0, 0.0)).T) < 1e-9).any(), "a reversal stays a corner"
    np.testing.assert_array_equal(smooth_route([[0.0, 0.0], [1.0, 0.0]])[[0, -1]], [[0.0, 0.0], [1.0, 0.0]])


def test_faces_are_climbed_at_the_speed_that_the_robot_needs_for_them():
    grid = flat(6, 4)
    half = grid.height.shape[1] // 2
    grid.height[:, half:] += 0.12
    nodes = np.array([[0.6, 2.0, 0.0], [5.4, 2.0, 0.0]])
    graph = TraversalGraph.from_edges(nodes, np.array([[0, 1]]), np.zeros(1))
    slow, fast = (
        make_path(plan(graph, grid, PlanRequest(0, 1)), grid, BODY, PathLimits(max_step=0.25, step_speed=v))
        for v in (0.0, 0.75)
    )
    away = np.abs(fast.points[:, 0] - grid.origin[0] - (half - 0.5) * grid.resolution)
    assert slow.speed[away < 0.2].max() < 0.6, "a face is a risk"
    np.testing.assert_array_equal(slow.least, 0.0)
    np.testing.assert_allclose(fast.least[away < 0.2], 0.75)
    assert fast.speed[away < 0.2].min() >= 0.75
    assert fast.least[away > 0.6].max() == 0.0
    np.testing.assert_array_equal(fast.speed[away > 0.8], slow.speed[away > 0.8])


def test_a_robot_that_turns_near_a_corner_where_its_path_turns_round_goes_on_with_the_way_back():
    grid = flat(6, 4)
    nodes = np.array([[1.0, 2.0, 0.0], [3.0, 2.0, 0.0], [1.0, 3.0, 0.0]])
    graph = TraversalGraph.from_edges(nodes, np.array([[0, 1], [1, 2]]), np.zeros(2))
    path = make_path(plan(graph, grid, PlanRequest(0, 2, 0.0)), grid, BODY)
    for x, passed in ((2.9, True), (2.5, False)):
        ahead = path.ahead(x, 2.03)
        assert ahead is not None
        assert (len(ahead[0]) == 1) is passed
        rest = rest_of(path, (x, 2.03, 1.0), grid, BODY)
        assert (np.abs(rest.yaw[0]) > 1.5) == passed, (
            "the heading of the way back, or of the way to the corner"
        )
        assert len(rest.route) == len(ahead[0]) + 1


@pytest.mark.parametrize(("face", "climbs"), [(0.02, False), (0.15, True), (0.22, True), (0.30, False)])
def test_a_face_that_the_map_has_a_little_too_high_is_climbed_at_the_speed_that_faces_need(
    face: float, climbs: bool
) -> None:
    s = np.arange(0.0, 3.0, 0.02)
    features = np.tile([0.2, 0.0, 0.3, 0.0], (len(s), 1))  # it reaches up under the body: slower
    limits = PathLimits(max_step=0.20, step_speed=0.5)
    _, least = speeds(s, np.zeros_like(s), s, features, np.full(len(s), face), BODY, limits)
    assert least[len(s) // 2] == pytest.approx(0.5 if climbs else 0.0)
