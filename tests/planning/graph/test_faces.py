"""Faces: height and direction of what rises within a hand's breadth, and routes that cross it head-on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.graph.faces import update_faces
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel
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
    assert np.abs(faces_of(0.36 * x + 0.1 * y)).max() <= 10, "at the map's border, too"
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
    z = np.where((x * normal[0] + y * normal[1]) > kerb, 0.19, 0.0)
    z += 0.004 * np.random.default_rng(1).standard_normal(z.shape)
    grid = ElevationGrid(z.astype(np.float32), np.ones(z.shape, bool), (0.0, 0.0), RES)
    angles, lengths = [], []
    for controller in (None, "hybrid"):
        params = GraphParams(max_step=0.2, max_slope=0.7, controller=controller, blind_radius=0.0)
        graph = TraversalGraph.build(grid, (1.0, 2.0), params, 0)
        found = plan(graph, grid, PlanRequest((1.0, 2.0), (5.4, 2.0), 0.0), BodyModel())
        angles.append(worst_angle(found.points, normal, kerb))
        lengths.append(found.length)
    assert angles[0] > 45.0
    assert angles[1] < 35.0
    assert lengths[1] < 1.2 * lengths[0]
