"""Faces: height and direction of what rises within a hand's breadth, and routes that cross it head-on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hal.go2w import TREAD_WIDTH
from mapping.grid import ElevationGrid
from planning.graph.edges import AXLE, TREAD, _tipped
from planning.graph.faces import TIPS, askew, max_angle, tipping, update_faces
from planning.graph.flags import FIELD, UNSEEN, VIRTUAL
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel
from planning.search.attach import Ground
from planning.search.plan import PlanRequest, plan

RES = 0.04


def faces_of(height: np.ndarray, trusted: np.ndarray | None = None) -> np.ndarray:
    z = height.astype(np.float32)
    out = np.zeros((*z.shape, 2), np.int16)
    seen = np.ones(z.shape, bool) if trusted is None else trusted
    update_faces(out, z, seen, RES, 0, 0, *z.shape)
    return out


@pytest.mark.parametrize("degrees", [0, 20, 45, 70, 90])
@pytest.mark.parametrize("height", [0.05, 0.09, 0.2])
def test_a_kerb_has_its_height_and_its_normal(degrees: int, height: float) -> None:
    y, x = np.mgrid[0:60, 0:60] * RES
    a = np.radians(degrees)
    noise = 0.003 * np.random.default_rng(degrees).standard_normal(x.shape)
    faces = faces_of(np.where((x - 1.2) * np.cos(a) + (y - 1.2) * np.sin(a) > 0, height, 0.0) + noise) * 1e-3
    size = np.abs(faces).max(axis=2)
    on = size > 0.7 * height
    along = np.abs((x - 1.2) * np.cos(a) + (y - 1.2) * np.sin(a))
    assert along[on].max() < 0.12
    assert np.median(size[on]) == pytest.approx(height, abs=0.01)
    mean = faces[on].mean(axis=0)
    assert np.degrees(np.arctan2(mean[1], mean[0])) == pytest.approx(degrees, abs=5.0)


def test_ramps_and_what_was_not_seen_have_no_faces() -> None:
    y, x = np.mgrid[0:60, 0:60] * RES
    inner = np.s_[8:-8, 8:-8]
    assert np.abs(faces_of(0.36 * x + 0.1 * y)[inner]).max() <= 10
    kerb = np.where(x > 1.2, 0.09, 0.0)
    assert np.abs(faces_of(kerb)).max() == pytest.approx(90, abs=1)
    assert np.abs(faces_of(kerb, np.abs(x - 1.2) > 0.2)[inner]).max() == 0


@pytest.mark.parametrize("degrees", [10, 15, 20])
def test_ridges_and_valleys_are_no_faces_and_a_kerb_on_a_slope_is_one(degrees: int) -> None:
    _, x = np.mgrid[0:60, 0:60] * RES
    noise = 0.003 * np.random.default_rng(degrees).standard_normal(x.shape)
    steep = np.tan(np.radians(degrees))
    inner = np.s_[8:-8, 8:-8]
    ridge = np.abs(x - 1.2) * steep
    for z in (ridge, -ridge):
        high = np.abs(faces_of(z + noise)[inner]).max(axis=2) > 30  # mm, LEAST of `planning.graph.fields`
        assert high.mean() < 0.02
    kerb = np.abs(faces_of(steep * x + np.where(x > 1.2, 0.1, 0.0) + noise)[inner])[..., 0]
    assert np.median(kerb[:, 20:24]) == pytest.approx(100, abs=10)  # 0.08 m on both sides of it


@pytest.mark.parametrize("degrees", [0, 30, 90])
def test_a_slope_that_wheels_slide_down_is_a_face_as_high_as_it_goes_on(degrees: int) -> None:
    y, x = np.mgrid[0:60, 0:60] * RES
    a = np.radians(degrees)
    along = (x - 1.2) * np.cos(a) + (y - 1.2) * np.sin(a)
    noise = 0.003 * np.random.default_rng(degrees).standard_normal(x.shape)
    faces = faces_of(np.clip(along, 0.0, 0.8) + noise)  # 45 deg
    size = np.abs(faces).max(axis=2)
    inner = np.zeros(x.shape, bool)
    inner[8:-8, 8:-8] = True
    foot, middle = inner & (np.abs(along - 0.08) < 0.03), inner & (np.abs(along - 0.4) < 0.1)
    assert np.median(size[foot]) > 200
    assert size[middle].min() > 300
    mean = faces[middle].mean(axis=0)
    assert np.degrees(np.arctan2(mean[1], mean[0])) == pytest.approx(degrees, abs=5.0)
    assert size[inner & (along < -0.2)].max() <= 20


def test_the_angle_allowed_falls_with_the_height() -> None:
    deg = np.degrees([max_angle(h, 0.10, np.radians(30)) for h in (0.0, 0.04, 0.07, 0.10, 0.20)])
    np.testing.assert_allclose(deg, [90, 90, 60, 30, 30])
    for travel, oblique in (
        (0, False),
        (28, False),
        (32, True),
        (90, True),
        (149, True),
        (155, False),
        (180, False),
    ):
        u = np.cos(np.radians(travel)), np.sin(np.radians(travel))
        assert (askew(100, 0, *u, 0.10, np.radians(30)) > 0.0) is oblique
        assert askew(39, 0, *u, 0.10, np.radians(30)) == 0.0
        assert askew(100, 0, *u, 0.10, np.radians(90)) == 0.0


def worst_angle(points: np.ndarray, normal: np.ndarray, kerb: float) -> float:
    """Largest angle [deg] between the kerb's normal and the legs that carry the body over it."""
    out = 0.0
    for a, b in pairwise(points[:, :2]):
        u = (b - a) / np.hypot(*(b - a))
        reach = 0.35 * abs(u @ normal) + 0.2 * abs(u[0] * normal[1] - u[1] * normal[0])
        ends = sorted((float(a @ normal), float(b @ normal)))
        if ends[0] - reach < kerb < ends[1] + reach:
            out = max(out, float(np.degrees(np.arccos(min(1.0, abs(u @ normal))))))
    return out


def test_a_kerb_across_a_wide_lane_is_crossed_head_on_and_no_route_is_lost() -> None:
    y, x = np.mgrid[0:100, 0:160] * RES
    normal = np.array([np.cos(np.radians(50)), np.sin(np.radians(50))])
    kerb = float(np.array([3.2, 2.0]) @ normal)
    z = np.where((x * normal[0] + y * normal[1]) > kerb, 0.09, 0.0)
    z += 0.004 * np.random.default_rng(1).standard_normal(z.shape)
    grid = ElevationGrid(z.astype(np.float32), np.ones(z.shape, bool), (0.0, 0.0), RES)
    angles, lengths = [], []
    for oblique in (90.0, 30.0):
        params = GraphParams(max_oblique=np.radians(oblique), blind_radius=0.0)
        graph = TraversalGraph.build(grid, (1.0, 2.0), params, 0)
        found = plan(graph, grid, PlanRequest((1.0, 2.0), (5.4, 2.0), 0.0), BodyModel())
        angles.append(worst_angle(found.points, normal, kerb))
        lengths.append(found.length)
    assert angles[0] > 45.0
    assert angles[1] < 35.0
    assert lengths[1] < 1.2 * lengths[0]


def test_a_face_counts_the_more_the_more_obliquely_it_is_met() -> None:
    travel = np.radians(np.arange(0, 91, 5))
    weights = np.array([askew(200, 0, np.cos(a), np.sin(a), 0.20, np.radians(15)) for a in travel])
    assert (np.diff(weights) >= 0.0).all()
    assert weights[:4] == pytest.approx(0.0)
    assert 0.0 < weights[6] < 0.25
    assert weights[-4:] == pytest.approx(1.0)
    low = [askew(120, 0, np.cos(a), np.sin(a), 0.20, np.radians(15)) for a in travel]
    assert (np.array(low) <= weights).all()
    assert max(low) < 0.6


@pytest.mark.parametrize("height", [0.19, -0.19, 0.05, 0.4])
@pytest.mark.parametrize("deg", range(0, 90, 10))
def test_who_climbs_a_high_face_much_too_obliquely_tips(deg: int, height: float) -> None:
    y, x = np.mgrid[0:60, 0:60] * RES
    normal = np.array([np.cos(np.radians(deg)), np.sin(np.radians(deg))])
    z = np.where((x - 1.2) * normal[0] + (y - 1.2) * normal[1] > 0.0, height, 0.0)
    z += 0.004 * np.random.default_rng(deg).standard_normal(z.shape)
    faces = np.zeros((*z.shape, 2), np.int16)
    update_faces(faces, z.astype(np.float32), np.ones(z.shape, bool), RES, 0, 0, *z.shape)
    high = np.argwhere(np.abs(faces).max(axis=-1) > 30)
    here = high[(np.abs(high - 30) < 5).all(axis=1)]
    assert len(here)
    for off, tips in ((0, 0), (40, 0), (55, 1), (72, 1), (87, 0), (-55, 1), (125, -1), (180, 0)):
        u = np.cos(np.radians(deg + off)), np.sin(np.radians(deg + off))
        wanted = tips * int(np.sign(height)) if abs(height) == 0.19 else 0  # low enough; a wall
        told = [tipping(faces, r, c, RES, *u, 0.20, np.radians(15)) for r, c in here]
        assert np.mean(np.array(told) == wanted) > 0.9, (off, told)


def beside(aside: float, height: float) -> float:
    """What is added to the risk of a move along an edge of `height` that lies `aside` of its middle [m]."""
    y, _ = np.mgrid[0:80, 0:100] * RES
    z = np.where(y > 1.58 + aside, height, 0.0).astype(np.float32)
    grid = ElevationGrid(z, np.ones(z.shape, bool), (0.0, 0.0), RES)
    params = GraphParams(max_step=0.20, max_oblique=np.radians(15), blind_radius=0.0)
    return Ground(TraversalGraph.build(grid, (1.0, 1.0), params, 0), grid).risk((1.6, 1.58), (2.0, 1.58))[0]


def test_an_edge_close_beside_the_robot_counts_and_a_wall_there_does_not() -> None:
    assert beside(0.36, 0.20) > 0.2
    assert beside(0.36, -0.20) > 0.2
    assert beside(0.48, 0.20) == 0.0
    assert beside(0.36, 0.05) == 0.0, "low enough for any angle"
    assert beside(0.36, 0.60) == 0.0


@pytest.mark.parametrize(("deg", "dear"), [(30.0, False), (55.0, True)])
def test_a_kerb_is_climbed_much_too_askew_at_a_price_and_driven_down_without_it(
    deg: float, dear: bool
) -> None:
    y, x = np.mgrid[0:110, 0:110] * RES
    normal = np.array([np.cos(np.radians(deg)), np.sin(np.radians(deg))])
    z = np.where((x - 2.0) * normal[0] + (y - 2.0) * normal[1] > 0.0, 0.19, 0.0).astype(np.float32)
    grid = ElevationGrid(z, np.ones(z.shape, bool), (0.0, 0.0), RES)
    params = GraphParams(
        max_step=0.20, max_oblique=np.radians(15), max_slope=np.radians(40), blind_radius=0.0
    )
    graph = TraversalGraph.build(grid, (1.0, 2.0), params, 0)
    up, down = Ground(graph, grid).risk((1.7, 2.0), (2.3, 2.0))
    assert up == pytest.approx(down + (TIPS if dear else 0.0))
    np.testing.assert_allclose(Ground(graph, grid).risk((2.3, 2.0), (1.7, 2.0)), (down, up), rtol=1e-6)

    source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
    risk = {(int(a), int(b)): float(r) for a, b, r in zip(source, graph.indices, graph.risk, strict=True)}
    dearer = [(a, b) for (a, b), r in risk.items() if r > risk[b, a] + 1.0]
    assert len(dearer) > 10
    for a, b in dearer:
        move = graph.nodes[b, :2] - graph.nodes[a, :2]
        assert 0.0 < move @ normal < np.cos(np.radians(40.0)) * np.hypot(*move), "it climbs, askew"


def tips_of(faces: np.ndarray, r: int, c: int, u: np.ndarray, max_step: float, max_oblique: float) -> int:
    """`tipping`, in plain numpy."""
    n = round(0.12 / RES)
    near = faces[max(0, r - n) : r + n + 1, max(0, c - n) : c + n + 1].reshape(-1, 2).astype(float)
    height = 0.001 * np.abs(near).max(axis=1)
    told = (height > 0.4 * max_step) & (height <= max_step + 0.03)
    near, height = near[told], height[told]
    normal = near.sum(axis=0)
    if not normal.any():
        return 0
    up = float(normal @ u / np.hypot(*normal))
    least = max_oblique + np.radians(30) * (2.0 - min(height.max() / max_step, 1.0))
    return int(np.sign(up)) if least < np.arccos(min(abs(up), 1.0)) < np.radians(80) else 0


def tipped_of(height: np.ndarray, faces: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """`_tipped`, in plain numpy: six lines of wheels, and where the ground rises or falls along them."""
    d = float(np.hypot(*(b - a)))
    u = (b - a) / d
    n = np.ceil((d + 2.0 * AXLE) / RES)
    along = np.minimum(np.arange(n + 1) * RES, d + 2.0 * AXLE) - AXLE
    there = back = 0
    for side in (TREAD, -TREAD):
        for across in side + np.array([-0.5, 0.0, 0.5]) * TREAD_WIDTH:
            x, y = a[0] + along * u[0] - across * u[1], a[1] + along * u[1] + across * u[0]
            c, r = np.floor(x / RES + 0.5).astype(int), np.floor(y / RES + 0.5).astype(int)
            rise = height[r[2:], c[2:]] - height[r[:-2], c[:-2]]
            tips = np.array(
                [tips_of(faces, i, j, u, 0.20, np.radians(15)) for i, j in zip(r, c, strict=True)]
            )
            there += bool(((rise > 0.08) & (tips[1:-1] > 0)).any())
            back += bool(((rise < -0.08) & (tips[1:-1] < 0)).any())
    return min(1.0, there / 3), min(1.0, back / 3)


def test_wheels_tip_where_the_ground_rises_along_their_tracks() -> None:
    rng, told = np.random.default_rng(5), set()
    for _ in range(60):
        y, x = np.mgrid[0:80, 0:80] * RES
        turn = rng.uniform(0.0, np.pi)
        z = np.where((x - 1.6) * np.cos(turn) + (y - 1.6) * np.sin(turn) > 0.0, rng.uniform(0.1, 0.2), 0.0)
        z = (z + 0.004 * rng.standard_normal(z.shape)).astype(np.float32)
        faces = np.zeros((*z.shape, 2), np.int16)
        update_faces(faces, z, np.ones(z.shape, bool), RES, 0, 0, *z.shape)
        a, b = rng.uniform(1.2, 2.0, (2, 2))
        d = float(np.hypot(*(b - a)))
        u = (b - a) / d
        got = _tipped(z, np.zeros(z.shape, np.uint16), faces, 0.0, 0.0, RES, *a, *u, d, 0.20, np.radians(15))
        assert got == pytest.approx(tipped_of(z, faces, a, b))
        told.add(tuple(np.sign(got)))
    assert len(told) >= 3


def test_no_wheel_tips_on_ground_that_nobody_saw_or_among_posts() -> None:
    y, x = np.mgrid[0:80, 0:80] * RES
    z = np.where((x - 1.6) * 0.5 + (y - 1.6) * 0.87 > 0.0, 0.19, 0.0).astype(np.float32)
    faces = np.zeros((*z.shape, 2), np.int16)
    update_faces(faces, z, np.ones(z.shape, bool), RES, 0, 0, *z.shape)
    for flag, tips in ((0, 1.0), (FIELD, 0.0), (UNSEEN, 0.0), (VIRTUAL, 0.0)):
        flags = np.full(z.shape, flag, np.uint16)
        got = _tipped(z, flags, faces, 0.0, 0.0, RES, 1.3, 1.6, 1.0, 0.0, 0.6, 0.20, np.radians(15))
        assert got == (tips, 0.0)
