"""A LiDAR whose unit or mount is wrong is told while the robot stands; uneven ground is not taken for that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hal.lidar.caster import NumbaCaster, Surface
from hal.lidar.spec import LIDARS
from hal.rotation import rotation_rpy
from hal.safety.monitors import GROUND_HEIGHT, raised, taken_out
from hal.types import NS, GroundTruth, LidarScan
from mapping.odometry.ground_height import SURE_SWEEPS, GroundHeight
from mapping.odometry.health import Health
from tests.mapping.odometry.test_pipeline import Driven
from tools.synthetic import arena_run
from tools.synthetic_motion import Motion

FOOT = 0.3048
STAND = 0.41
"""[m] of base_link above the plane under the wheels."""
WHEELS = np.array([(x, y) for x in (0.21, -0.21) for y in (-0.2, 0.2)])
X, Y = np.meshgrid(np.arange(-12.0, 12.0, 0.05), np.arange(-12.0, 12.0, 0.05))
Ground = Callable[[np.ndarray, np.ndarray], np.ndarray]


def level(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.0 * x


def room(side: float) -> Ground:
    """Walls all around."""
    return lambda x, y: np.where(np.maximum(np.abs(x), np.abs(y)) < side / 2, 0.0, 2.5)


def corridor(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.where((np.abs(y) < 0.9) & (np.abs(x) < 9.0), 0.0, 2.5)


def rubble(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Blocks of 0.4 m and up to 0.3 m high."""
    heights = np.random.default_rng(5).uniform(0.0, 0.3, (64, 64))
    return heights[(np.floor(x / 0.4) + 32).astype(int), (np.floor(y / 0.4) + 32).astype(int)]


GROUNDS: dict[str, Ground] = {
    "level": level,
    "slope": lambda x, y: 0.36 * x,
    "side slope": lambda x, y: 0.3 * y,
    "foot of a ramp": lambda x, y: 0.36 * np.maximum(x, 0.0),
    "ramp that ends at a terrace": lambda x, y: np.minimum(0.36 * (x + 1.0), 0.6),
    "beside a kerb": lambda x, y: np.where(y > 0.35, 0.2, 0.0),
    "astride a kerb": lambda x, y: np.where(y > 0.0, 0.15, 0.0),
    "between kerbs": lambda x, y: np.where(np.abs(y) > 0.8, 0.25, 0.0),
    "on a pallet": lambda x, y: np.where(np.maximum(np.abs(x), np.abs(y)) < 0.6, 0.15, 0.0),
    "on a bridge": lambda x, y: np.where(np.abs(y) < 0.6, 0.0, -1.0),
    "at the edge of a terrace": lambda x, y: np.where(x > 0.5, -1.0, 0.0),
    "stairs": lambda x, y: 0.17 * np.floor((x + 0.15) / 0.3),
    "rubble": rubble,
    "a small room": room(3.0),
    "a hall": room(7.0),
    "a corridor": corridor,
}


def stands(ground: Ground, lidar: str, unit: float = 1.0, *, turned: bool = False) -> GroundHeight:
    """What is told of a LiDAR after enough sweeps of a robot that stands at the origin; `unit`: what it takes for a
    metre [m]; `turned`: it hangs upside down, and nobody knows."""
    height = ground(X, Y)
    caster = NumbaCaster(Surface(height.astype(np.float32), 0.05, (float(X[0, 0]), float(Y[0, 0]))))
    spec = LIDARS[lidar].decimated(1 if lidar == "l1" else 8)
    under = np.column_stack([WHEELS, ground(WHEELS[:, 0], WHEELS[:, 1])])
    slope = np.linalg.lstsq(np.column_stack([WHEELS, np.ones(4)]), under[:, 2], rcond=None)[0]
    normal = np.array([-slope[0], -slope[1], 1.0]) / np.linalg.norm([slope[0], slope[1], 1.0])
    ahead = np.cross([0.0, 1.0, 0.0], normal) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], normal))
    base = np.column_stack([ahead, np.cross(normal, ahead), normal])
    at = np.array([0.0, 0.0, slope[2]]) + STAND * normal
    mount = spec.mount
    place, turn = np.array(mount.translation), rotation_rpy(*mount.rpy)
    if turned:
        turn = turn @ rotation_rpy(np.pi, 0.0, 0.0)
    told = GroundHeight("main", place)
    rng = np.random.default_rng(1)
    for sweep in range(SURE_SWEEPS):
        rays = spec.pattern(sweep).directions.astype(np.float64)
        origins = np.tile(at + base @ place, (len(rays), 1))
        ranges = caster.cast(origins.astype(np.float32), (rays @ (base @ turn).T).astype(np.float32))
        ranges = ranges / unit + rng.normal(0.0, spec.range_sigma, len(ranges))
        seen = rays[ranges < 20.0] * ranges[ranges < 20.0, None]
        mounted = rotation_rpy(*mount.rpy)
        told.look(seen @ mounted.T + place, (under - at) @ base)
    return told


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("lidar", ["xt16", "mid360", "l1"])
def test_no_ground_is_taken_for_a_wrong_unit(ground: str, lidar: str) -> None:
    assert stands(GROUNDS[ground], lidar).words == ""


@pytest.mark.parametrize("lidar", ["xt16", "l1"])
def test_a_lidar_that_is_right_is_not_asked_again(lidar: str) -> None:
    assert not stands(level, lidar).asks


@pytest.mark.parametrize("ground", ["level", "slope", "a hall"])
@pytest.mark.parametrize("unit", [FOOT, 0.5, 2.0, 1 / FOOT])
def test_another_unit_is_told(ground: str, unit: float) -> None:
    words = stands(GROUNDS[ground], "xt16", unit).words
    assert GROUND_HEIGHT in raised(words)
    seen = float(words.partition("level ground ")[2].split()[0])
    assert seen == pytest.approx((STAND + 0.116) / unit, rel=0.05)


def test_a_sweep_that_shows_no_ground_changes_nothing() -> None:
    told = stands(level, "xt16", FOOT)
    words = told.words
    told.look(np.ones((1, 3)), np.column_stack([WHEELS, np.full(4, -STAND)]))
    assert words
    assert told.words == words


def test_a_lidar_that_hangs_upside_down_is_told() -> None:
    assert "m above itself" in stands(room(7.0), "xt16", turned=True).words


@pytest.mark.parametrize("unit", [FOOT, 2.0])
def test_nothing_is_believed_of_such_a_lidar_from_the_start(unit: float) -> None:
    run = arena_run("xt16", duration=2.0, seed=4)
    run = replace(run, lidar=LIDARS["xt16"].decimated(8), motion=Motion(kind="standstill"))
    wrong = []
    for s in run.samples():
        if isinstance(s, LidarScan):
            points = s.points.copy()
            for axis in "xyz":
                points[axis] /= unit
            s = replace(s, points=points)
        wrong += [] if isinstance(s, GroundTruth) else [s]
    out = Driven(wrong)
    assert out.scans
    assert {s.health for s in out.scans} == {Health.LOST}
    assert all(GROUND_HEIGHT in raised(s.reason) for s in out.scans)
    assert out.scans[0].stamp - wrong[0].stamp < NS
    with taken_out(GROUND_HEIGHT.name):
        assert Health.GOOD in {s.health for s in Driven(wrong).scans}
