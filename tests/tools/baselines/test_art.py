"""ART: contact of boxes with the surface, its layers, its roadmap, its routes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason
from planning.search import PlanRequest
from tools.baselines.art import ArtParams, plan
from tools.baselines.art.contact import half_angle, rotation_of, touches, valid, way_is_valid
from tools.baselines.art.layers import closed, density, dilated, eroded, layers, least, most, normals
from tools.baselines.art.plan import _quaternions
from tools.baselines.art.roadmap import cheapest, connect, seconds, yaw_of

pytestmark = pytest.mark.campaign
RES = 0.05
QUICK = ArtParams(milestones=400, batch=200)


def quaternion(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    return _quaternions(*(np.array([v]) for v in (yaw, pitch, roll)))[0]


def pose(x: float, y: float, z: float, *angles: float) -> np.ndarray:
    return np.array([x, y, z, *quaternion(*angles)])


def met(height: np.ndarray, centre: np.ndarray, rotation: np.ndarray, half: np.ndarray) -> bool:
    """The same question in plain numpy: all vertices and all edges of the grid, clipped by the six planes of the
    box."""
    rows, cols = height.shape
    c, r = np.meshgrid(np.arange(cols), np.arange(rows))
    vertices = np.stack([c * RES, r * RES, height], axis=2)
    pairs = [(vertices[:, :-1], vertices[:, 1:]), (vertices[:-1], vertices[1:]), (vertices, vertices)]
    for a, b in pairs:
        p, q = (((v.reshape(-1, 3) - centre) @ rotation) for v in (a, b))
        known = np.isfinite(p).all(axis=1) & np.isfinite(q).all(axis=1)
        p, d = p[known], (q - p)[known]
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (-half - p) / d, (half - p) / d
        inside = np.abs(p) <= half
        enter = np.where(d == 0.0, np.where(inside, -np.inf, np.inf), np.minimum(one, two)).max(axis=1)
        leave = np.where(d == 0.0, np.where(inside, np.inf, -np.inf), np.maximum(one, two)).min(axis=1)
        if (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)).any():
            return True
    return False


def test_a_box_touches_the_surface_as_in_plain_numpy() -> None:
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(300):
        height = rng.normal(0.0, 0.1, (14, 16))
        height[rng.random(height.shape) < 0.1] = np.nan
        q = rng.normal(size=4)
        rotation = rotation_of(q / np.linalg.norm(q))
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        centre = np.array([*rng.uniform(-0.1, 0.8, 2), rng.normal(0.0, 0.15)])
        half = rng.uniform(0.01, 0.12, 3)
        found = touches(height, 0.0, 0.0, RES, centre, rotation, half)
        assert found == met(height, centre, rotation, half)
        hits += found
    assert 50 < hits < 250


def test_a_pose_stands_where_its_legs_reach_and_its_torso_is_free() -> None:
    height = np.zeros((60, 60))
    at = (0.0, 0.0, RES, QUICK.boxes)
    assert valid(height, height, *at, pose(1.5, 1.5, 0.0, 0.4))
    assert not valid(height, height, *at, pose(1.5, 1.5, 0.10, 0.4)), "no leg reaches down"
    assert not valid(height, height, *at, pose(1.5, 1.5, 0.0, 0.4, 0.5)), "pitched over"
    assert not valid(height, height, *at, pose(0.1, 1.5, 0.0, 0.0)), "a foot off the map"
    block = height.copy()
    block[29:32, 29:32] = 0.33
    assert not valid(block, block, *at, pose(1.5, 1.5, 0.0, 0.0)), "the torso sits on the block"
    block[29:32, 29:32] = 0.25
    assert valid(block, block, *at, pose(1.5, 1.5, 0.0, 0.0)), "it stands over it"
    masked = height.copy()
    masked[:, 32:40] = np.nan
    assert not valid(height, masked, *at, pose(1.5, 1.5, 0.0, 0.0)), "no foothold in front"
    slope = 0.7 * np.arange(60) * RES * np.ones((60, 1))
    uphill = pose(1.5, 1.5, 1.05, 0.0, -math.atan(0.7))
    assert valid(slope, slope, *at, uphill)
    assert not valid(slope, slope, *at, pose(1.5, 1.5, 1.05, 0.0))


def test_a_way_is_tested_between_its_ends() -> None:
    height = np.zeros((60, 80))
    at = (0.0, 0.0, RES, QUICK.boxes)
    a, b = pose(1.0, 1.5, 0.0, 0.0), pose(3.0, 1.5, 0.0, 0.0)
    assert way_is_valid(height, height, *at, a, b, 0.1, 0.02)
    height[28:33, 38:42] = 0.5
    assert not way_is_valid(height, height, *at, a, b, 0.1, 0.02)
    assert way_is_valid(height, height, *at, a, b, 5.0, 5.0), "only the ends, which are not its business"
    assert half_angle(quaternion(0.3), quaternion(1.3)) == pytest.approx(0.5)
    assert yaw_of(quaternion(-2.0, 0.2, 0.1)) == pytest.approx(-2.0)


def test_layers_of_discs_are_those_of_plain_numpy() -> None:
    rng = np.random.default_rng(8)
    z = rng.normal(size=(25, 30))
    mask = rng.random(z.shape) < 0.3
    for size in (1, 4, 7):
        r, c = np.mgrid[: z.shape[0], : z.shape[1]]
        near = (r[..., None, None] - r) ** 2 + (c[..., None, None] - c) ** 2 <= (0.5 * size) ** 2
        np.testing.assert_array_equal(most(z, size), np.where(near, z, -np.inf).max(axis=(2, 3)))
        np.testing.assert_array_equal(least(z, size), np.where(near, z, np.inf).min(axis=(2, 3)))
        np.testing.assert_array_equal(dilated(mask, size), (near & mask).any(axis=(2, 3)))
        np.testing.assert_array_equal(eroded(mask, size), (~near | mask).all(axis=(2, 3)))
        assert (closed(mask, size) >= mask).all()


def test_normals_are_those_of_the_plane_and_rises_those_of_the_arms() -> None:
    y, x = np.mgrid[:30, :40] * RES
    normal, rise = normals(0.2 * x - 0.1 * y, RES, 4)
    expected = np.array([-0.2, 0.1, 1.0]) / math.sqrt(1.05)
    np.testing.assert_allclose(
        normal[5:-5, 5:-5], np.broadcast_to(expected, normal[5:-5, 5:-5].shape), atol=1e-9
    )
    assert rise[15, 20] == pytest.approx(8 * RES * 0.3), "the diagonal arm, downhill"


def test_feet_keep_off_unseen_ground_but_not_off_small_holes_or_walls() -> None:
    height = np.zeros((80, 100), np.float32)
    trusted = np.ones(height.shape, np.bool_)
    trusted[20:23, 20:23] = False
    trusted[:, 80:] = False
    height[60:64] = 0.6
    base = layers(ElevationGrid(height, trusted, (0.0, 0.0), RES), QUICK)
    open_ground = layers(
        ElevationGrid(height, trusted, (0.0, 0.0), RES), QUICK.model_copy(update={"masks": False})
    )
    assert np.isfinite(open_ground.masked).all(), "without masks they stand everywhere"
    stand = np.isfinite(base.masked)
    assert not stand[:, 80:].any()
    assert not stand[40, 76:80].any(), "the margin"
    assert stand[40, 70]
    assert stand[18, 18], "beside a hole that counts as seen"
    assert not stand[21, 21], "not in it"
    assert stand[57, 30], "beside a wall"
    free = density(base, np.array([[40, 30]] * 5), 4.0, 0.1)
    assert free.sum() == pytest.approx(1.0)
    assert free[40, 30] < 0.01 * free[40, 60], "where vertices are, fewer come"


def test_edges_cost_the_slowest_of_along_across_and_turn() -> None:
    speed = np.array([0.5, 0.1, 0.5])
    assert seconds(pose(0, 0, 0, 0.0), pose(1, 0, 5, 0.0), speed) == pytest.approx(2.0)
    assert seconds(pose(0, 0, 0, 0.0), pose(0, 1, 0, 0.0), speed) == pytest.approx(10.0)
    assert seconds(pose(0, 0, 0, 0.5 * math.pi), pose(0, 1, 0, 0.5 * math.pi), speed) == pytest.approx(2.0)
    assert seconds(pose(0, 0, 0, 3.0), pose(0, 0, 0, -3.0), speed) == pytest.approx((2 * math.pi - 6) / 0.5)


def test_the_cheapest_route_over_live_edges_is_that_of_relaxing_them_all() -> None:
    rng = np.random.default_rng(0)
    poses = np.array([pose(*rng.uniform(0, 3, 2), 0.0, rng.uniform(-3, 3)) for _ in range(60)])
    speed = np.array([0.5, 0.1, 0.5])
    edges, cost = connect(poses, speed)
    assert len({tuple(sorted(e)) for e in edges.tolist()}) == len(edges)
    degree = np.bincount(edges[:, 0], minlength=60)
    assert degree[59] == math.ceil(7.0 / 6.0 * math.e * math.log(60)), "of the 59 before it"
    both = np.concatenate([edges, edges[:, ::-1]])
    order = np.argsort(both[:, 0], kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(both[:, 0], minlength=60))])
    for _ in range(5):
        alive = rng.random(len(edges)) < 0.5
        nodes, used, total = cheapest(
            poses, first, both[order, 1], order % len(edges), cost, alive, 0, 1, speed
        )
        g = np.full(60, np.inf)
        g[0] = 0.0
        for _ in range(60):
            for (a, b), w in zip(edges[alive].tolist(), cost[alive].tolist(), strict=True):
                g[a], g[b] = min(g[a], g[b] + w), min(g[b], g[a] + w)
        assert total == pytest.approx(g[1])
        assert cost[used].sum() == pytest.approx(total)
        assert alive[used].all()
        assert (nodes[0], nodes[-1]) == (0, 1)


def walled() -> ElevationGrid:
    """Rough 5 x 4 m with a wall that leaves a gap of 1.4 m at high y."""
    height = np.random.default_rng(1).normal(0.0, 0.005, (80, 100)).astype(np.float32)
    height[:52, 49:51] = 0.8
    return ElevationGrid(height, np.ones(height.shape, np.bool_), (0.0, 0.0), RES)


def test_it_goes_around_a_wall_and_finds_the_same_route_again() -> None:
    request = PlanRequest((1.0, 1.0), (4.0, 1.0))
    found = plan(walled(), request, QUICK)
    np.testing.assert_allclose(found.points[[0, -1], :2], [(1.0, 1.0), (4.0, 1.0)])
    line = found.points[:, :2]
    at = np.interp(2.475, line[:, 0], line[:, 1]) if (np.diff(line[:, 0]) > 0).all() else line[:, 1].max()
    assert at > 2.6
    assert 4.0 < found.length < 9.0
    assert found.points.tolist() == plan(walled(), request, QUICK).points.tolist()
    assert found.points.tolist() != plan(walled(), request, QUICK, seed=1).points.tolist()


def test_it_tells_why_there_is_no_route() -> None:
    grid = walled()
    grid.height[:, 49:51] = 0.8
    with pytest.raises(NoRoute, match="finds no way") as none:
        plan(grid, PlanRequest((1.0, 1.0), (4.0, 1.0)), QUICK)
    assert none.value.reason is NoRouteReason.NO_ROUTE
    unseen = ElevationGrid(grid.height, np.zeros(grid.height.shape, np.bool_), grid.origin, RES)
    with pytest.raises(NoRoute, match="at the start"):
        plan(unseen, PlanRequest((1.0, 1.0), (4.0, 1.0)), QUICK)
