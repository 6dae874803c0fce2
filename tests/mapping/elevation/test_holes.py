"""How wide a hole is, from rim to rim: what the map tells planner and guard."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.lidar import LIDARS, LidarSimulator
from hal.lidar.caster import NumbaCaster, Surface
from hal.rotation import rotation_rpy
from hal.safety.monitors import HOLE_WIDTH, taken_out
from hal.types import MountedLidar
from mapping.elevation.exchange import HOLE, SOURCES
from mapping.elevation.holes import LEAST_DEPTH, WIDEST_HOLE, Crossing, mark_holes, widths
from mapping.elevation.map import ElevationMap
from mapping.elevation.sensor import Sensor

RES, N = 0.04, 60
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def slit(cells: int, angle: float, *, deep: float = 0.3, seen: bool = False, fall: float = 0.0) -> tuple:
    """A slit of so many cells at `angle` [rad] through the middle: height, source, trusted, points, bound."""
    y, x = np.mgrid[:N, :N] - N // 2
    across = x * math.cos(angle) + y * math.sin(angle)
    inside = (across > 0.0) & (across < cells + 0.5)
    height = np.float32(fall * RES) * np.abs(x).astype(np.float32)
    height[inside] = -deep if seen else np.nan
    bound = np.where(inside, np.float32(-deep), np.float32(np.inf)).astype(np.float32)
    trusted = ~inside | seen
    source = np.where(trusted, 2, 0).astype(np.uint8)
    points = np.where(trusted, 10, 0).astype(np.uint8)
    return height, source, trusted, points, bound


def measure(ground: tuple, drop: float = 0.24) -> np.ndarray:
    out = np.zeros((N, N), np.float32)
    widths(*ground, RES, drop, out)
    return out[N // 2 - 6 : N // 2 + 7, N // 2 - 4 : N // 2 + 24]


@given(st.integers(2, 8), st.floats(0.0, math.pi / 2), st.booleans())
@settings(deadline=None, max_examples=40)
def test_the_width_is_that_between_the_rims_whatever_its_direction(
    cells: int, angle: float, seen: bool
) -> None:
    told = measure(slit(cells, angle, deep=0.3, seen=seen))
    told = told[told > 0.0]
    assert len(told) > 0
    # A cell of each rim counts half; between two of the eight directions a slit is 2 % wider, and a lattice has
    # corners.
    assert (cells - 0.5) * RES < np.median(told) < (cells + 2.6) * RES


@pytest.mark.parametrize(
    "ground",
    [
        slit(4, 0.0, deep=0.5 * LEAST_DEPTH),
        slit(4, 0.0, deep=0.2, seen=True),
        slit(round(WIDEST_HOLE / RES) + 2, 0.0),
        slit(8, 0.0, deep=0.3, fall=0.9),
    ],
    ids=["no ray went down", "a floor that is driven on", "an edge that goes down", "a valley"],
)
def test_what_is_no_hole_has_no_width(ground: tuple) -> None:
    if np.isnan(ground[0]).any() and ground[0][0, 0] > 0.5:  # the slopes go on to where they meet
        ground[4][ground[4] < np.inf] = -0.02
    assert not measure(ground).any()


def test_points_that_scatter_before_the_far_wall_make_it_no_narrower() -> None:
    plain = slit(5, 0.0)
    height, source, trusted, points, bound = slit(5, 0.0)
    before = N // 2 + 5
    for row in range(N):  # few points a little low, or as high as the rim
        height[row, before] = -0.04 if row % 2 else 0.0
        points[row, before] = 10 if row % 2 else 2
        source[row, before], trusted[row, before], bound[row, before] = 2, True, np.inf
    told = measure((height, source, trusted, points, bound))
    assert np.median(told[told > 0.0]) == pytest.approx(np.median(measure(plain)[measure(plain) > 0.0]))


def test_a_single_cell_that_has_it_wide_marks_nothing() -> None:
    height, source, trusted, points, bound = slit(2, 0.0)
    scratch = np.zeros((N, N), np.float32)
    wide = slit(4, 0.0)
    for mine, theirs in zip((height, source, trusted, points, bound), wide, strict=True):
        mine[N // 2] = theirs[N // 2]
    mark_holes(height, source, trusted, points, bound, RES, 0.13, 0.24, scratch)
    assert (source <= 2).all()
    mark_holes(*wide, RES, 0.13, 0.24, scratch)
    assert (wide[1][10:-10] > 2).any(axis=1).all()


@pytest.mark.parametrize("seen", [False, True])
def test_a_floor_between_two_bars_is_none(seen: bool) -> None:
    height, source, trusted, points, bound = slit(8, 0.0, deep=0.15, seen=seen)
    bars = np.full_like(height, -0.15)
    bars[:, N // 2 - 2 : N // 2 + 11] = height[:, N // 2 - 2 : N // 2 + 11]  # two or three cells each
    assert not measure((bars, source, trusted, points, bound), drop=0.1).any()


def test_a_notch_in_a_wall_and_a_ditch_before_a_wall_are_none() -> None:
    height, source, trusted, points, bound = slit(4, 0.0, deep=0.5, seen=True)
    notch, ditch = np.zeros_like(height), height.copy()
    notch[N // 2 - 1 : N // 2 + 1] = 0.6
    notch[N // 2 - 1 : N // 2 + 1, N // 2 + 1 : N // 2 + 4] = 0.0
    ditch[:, N // 2 + 5 :] = 0.6
    for ground in (notch, ditch):
        assert not measure((ground, source, trusted, points, bound)).any()


def approach(width: float, angle: float, near: float) -> Iterator[ElevationMap]:
    """The map of a robot of `max_gap` 0.12 m that drives at 0.45 m/s towards a slit 2 m deep, until its front is `near`
    [m] before it."""
    res, origin, edge = 0.01, (-1.5, -1.0), 1.6
    y, x = np.mgrid[:201, :501] * res + np.array([origin[1], origin[0]])[:, None, None]
    across = (x - edge) * math.cos(angle) + y * math.sin(angle)
    height = np.where((across > 1e-6) & (across < width - 1e-6), -2.0, 0.0).astype(np.float32)
    height[:3] = height[-3:] = height[:, :3] = 1.2
    caster, period = NumbaCaster(Surface(height, res, origin)), LIDARS["xt16"].period
    lidars = [
        (LidarSimulator(LIDARS[n].decimated(step), LIDARS[n].mount, caster, seed=1, name=name),
        Sensor.of(MountedLidar(name, n, LIDARS[n].mount)))
        for name, n, step in (("main", "xt16", 2), ("head", "l1", 1))
    ]  # fmt: skip
    rng, elevation, stamp = np.random.default_rng(1), ElevationMap(crossing=Crossing(0.12, 0.24)), period
    for k in range(int((edge - 0.35 - near) / 0.045) + 1):
        place = np.array([0.045 * k, 0.0, 0.42 + 0.004 * rng.normal()])
        for lidar, sensor in lidars:
            scan = None
            for part in (0, period - 1, period):
                scan = lidar.advance(stamp + part, place, LEVEL[[3, 0, 1, 2]]) or scan
            assert scan is not None
            p, mount = scan.points, lidar.mount
            xyz = np.stack([p["x"], p["y"], p["z"]], axis=1) @ rotation_rpy(*mount.rpy).T + mount.translation
            elevation.fuse(xyz.astype(np.float32), place, LEVEL, stamp + period, sensor)
            if k % 3 == 2:
                elevation.clean()
        stamp += period + 1
    yield elevation


def rows_marked(elevation: ElevationMap) -> int:
    """Of the 11 rows that the body takes, how many show a wide hole."""
    source = elevation.window(1.6, 0.0, 0.5).layers["source"]
    middle = len(source) // 2
    return int((source[middle - 5 : middle + 6] == HOLE).any(axis=1).sum())


@pytest.mark.parametrize(("width", "angle"), [(0.16, 0.0), (0.2, 0.0), (0.2, 45.0), (0.3, 20.0)])
def test_a_robot_that_comes_along_is_told_in_time(width: float, angle: float) -> None:
    (elevation,) = approach(width, math.radians(angle), 0.25)
    assert rows_marked(elevation) >= 3
    with taken_out(HOLE_WIDTH.name):
        assert rows_marked(elevation) == 0


@pytest.mark.parametrize("angle", [0.0, 20.0])
def test_a_crack_that_the_robot_crosses_is_none(angle: float) -> None:
    (elevation,) = approach(0.1, math.radians(angle), 0.1)
    assert rows_marked(elevation) == 0


def test_each_source_has_a_name() -> None:
    assert len(SOURCES) == HOLE + 1
