"""What comes, goes, hangs and hides: the map under a simulated LiDAR in a hall with boxes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hal.lidar import LIDARS, LidarSimulator, OrientedBox
from hal.lidar.caster import NumbaCaster, Surface
from hal.types import MountedLidar
from mapping.elevation.map import ElevationMap
from mapping.elevation.sensor import Sensor
from mapping.elevation.tiles import LIDAR

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
HEIGHT = 0.40
SPEC = LIDARS["xt16"].decimated(2)
PERIOD = SPEC.period


def hall(pit: bool = False) -> NumbaCaster:
    """12 x 8 m of level ground inside 1.2 m walls, optionally with a pit of 0.3 m at x 2.0..2.6, y -0.5..0.5."""
    height = np.zeros((161, 241), np.float32)
    height[:3] = height[-3:] = 1.2
    height[:, :3] = height[:, -3:] = 1.2
    if pit:
        height[70:91, 160:173] = -0.3
    return NumbaCaster(Surface(height, 0.05, (-6.0, -4.0)))


def run(
    seconds: float,
    boxes: Callable[[float], tuple[OrientedBox, ...]],
    pose: Callable[[float], float] = lambda t: 0.0,
    caster: NumbaCaster | None = None,
    watch: Callable[[float, ElevationMap], None] = lambda t, m: None,
    seed: int = 7,
) -> ElevationMap:
    """A map after `seconds`; `boxes(t)` stand in the hall, base_link is at x = `pose(t)` at the end of each scan."""
    lidar = LidarSimulator(SPEC, SPEC.mount, caster or hall(), seed=seed)
    elevation = ElevationMap()
    mount = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # yaw of 90 deg
    stamp = PERIOD
    for k in range(round(seconds * 1e9 / PERIOD)):
        t = k * PERIOD * 1e-9
        lidar.set_boxes(boxes(t))
        place = np.array([pose(t), 0.0, HEIGHT])
        scan = None
        for part in (0, 1):  # the scan is taken from where the robot is, no distortion to take out
            scan = lidar.advance(stamp + part * (PERIOD - 1), place, LEVEL[[3, 0, 1, 2]]) or scan
        scan = lidar.advance(stamp + PERIOD, place, LEVEL[[3, 0, 1, 2]]) or scan
        stamp += PERIOD + 1
        if scan is None:
            continue
        p = scan.points
        points = np.stack([p["x"], p["y"], p["z"]], axis=1) @ mount.T + np.array(SPEC.mount.translation)
        elevation.fuse(
            points.astype(np.float32),
            place,
            LEVEL,
            stamp,
            Sensor.of(MountedLidar("main", SPEC.name, SPEC.mount)),
        )
        if k % 3 == 2:
            elevation.clean()
        watch(t, elevation)
    return elevation


def box(x: float, y: float, size: tuple[float, float], top: float, bottom: float = 0.0) -> OrientedBox:
    return OrientedBox((x, y, 0.5 * (top + bottom)), (*size, top - bottom))


def heights(elevation: ElevationMap, x: float, y: float, half: float) -> np.ndarray:
    return elevation.window(x, y, half).layers["elevation"]


@pytest.mark.parametrize("seed", [2, 6, 7])
def test_an_obstacle_appears_at_once_and_is_gone_soon_after_it_went(seed: int) -> None:
    """With these seeds a mixed pixel before its face, seen often enough to count, is left when it has gone."""
    high: dict[float, int] = {}

    def watch(t: float, elevation: ElevationMap) -> None:
        high[round(t, 1)] = int((heights(elevation, 2.4, 0.0, 0.24) > 0.1).sum())

    thing = (box(2.4, 0.0, (0.4, 0.4), 0.5),)
    elevation = run(4.0, lambda t: thing if 1.0 <= t < 2.0 else (), watch=watch, seed=seed)
    times = sorted(high)
    assert max(high[t] for t in times if t < 1.0) == 0
    assert high[min(t for t in times if t >= 1.3)] > 5
    assert max(high[t] for t in times if t > 3.5) == 0
    # the ground that was seen before it came is back, not a hole in the map
    ground = elevation.window(2.4, 0.0, 0.24).layers
    assert (ground["source"] == LIDAR).any()
    assert np.nanmax(np.abs(ground["elevation"])) < 0.04


def test_cleaning_never_takes_ground_walls_or_poles_away() -> None:
    things = (box(2.5, 0.5, (0.05, 0.05), 1.0), box(0.0, 1.2, (5.0, 0.01), 0.5))
    marked: list[tuple[int, int]] = []

    def watch(t: float, elevation: ElevationMap) -> None:
        pole = (heights(elevation, 2.5, 0.5, 0.08) > 0.5).sum()
        wall = elevation.window(0.0, 1.2, 2.0).layers["elevation"]
        rows = slice(wall.shape[0] // 2 - 1, wall.shape[0] // 2 + 2)
        if t >= 1.0:
            marked.append(
                (int(pole), int((np.nanmax(np.nan_to_num(wall[rows], nan=-1.0), axis=0) > 0.2).sum()))
            )

    elevation = run(5.0, lambda t: things, pose=lambda t: 0.3 * np.sin(t), watch=watch)
    poles, walls = zip(*marked, strict=True)
    assert min(poles) >= 1
    assert min(walls) >= 0.95 * max(walls) > 80
    layers = elevation.window(0.0, -2.0, 1.5).layers
    seen = layers["source"] == LIDAR
    assert seen.mean() > 0.2
    assert np.abs(layers["elevation"][seen]).max() < 0.04


def test_a_beam_overhead_is_no_obstacle_and_a_low_one_is() -> None:
    for bottom, blocked in ((1.1, False), (0.5, True)):
        beam = (box(2.5, 0.0, (0.2, 3.0), bottom + 0.3, bottom),)
        elevation = run(3.0, lambda t, b=beam: b, pose=lambda t: 0.2 * t)
        high = heights(elevation, 2.5, 0.0, 0.2) > 0.3
        assert high.any() == blocked, f"beam at {bottom} m"


def test_a_wall_keeps_its_height_while_the_robot_comes_closer() -> None:
    wall = (box(3.0, 0.0, (0.2, 2.0), 0.9),)
    elevation = run(6.0, lambda t: wall, pose=lambda t: min(0.4 * t, 1.8))
    face = heights(elevation, 2.92, 0.0, 0.5)
    column = np.nanmax(face[:, face.shape[1] // 2 - 1 : face.shape[1] // 2 + 2], axis=1)
    assert (column > 0.7).mean() > 0.95


def test_a_pit_is_never_bridged_over() -> None:
    elevation = run(4.0, lambda t: (), pose=lambda t: -1.0 + 0.25 * t, caster=hall(pit=True))
    layers = elevation.window(2.3, 0.0, 0.22).layers
    assert not ((layers["trusted"] > 0.5) & (layers["elevation"] > -0.1)).any()
    filled = elevation.window(2.3, 0.0, 0.6).grid(filled=True)
    middle = filled.height.shape[0] // 2
    assert filled.height[middle, middle] < -0.03


def test_height_drift_of_the_odometry_is_mostly_taken_out() -> None:
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(-3, 3, 0.06), np.arange(-3, 3, 0.06))
    maps = {}
    for rate in (0.0, 0.005):  # [m/s] upwards
        maps[rate] = elevation = ElevationMap()
        for k in range(300):
            z = np.full(x.size, -HEIGHT) + rng.normal(0, 0.005, x.size)
            points = np.column_stack([x.ravel(), y.ravel(), z]).astype(np.float32)
            points = points[rng.random(len(points)) < 0.08]  # a cell is seen again after one or two seconds
            elevation.fuse(points, (0.0, 0.0, HEIGHT + rate * 0.1 * k), LEVEL, k * 10**8)
    assert abs(maps[0.0].alignment.height) < 0.003
    assert -0.155 < maps[0.005].alignment.height < -0.08
    assert abs(np.nanmedian(maps[0.005].grid().height)) < 0.07
