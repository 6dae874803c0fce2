"""Returns from the robot itself are taken out, and parts that nobody told of are noticed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from hal.go2w import L1_MOUNT, XT16_MOUNT
from hal.rotation import rotation_rpy
from hal.safety.monitors import OWN_PARTS, taken_out
from mapping.odometry.own import BODY, DRIVEN, SPARE, OwnFilter, OwnPart, OwnParts

ANTENNA = OwnPart(low=(-0.22, 0.25, -0.1), high=(-0.19, 0.28, 0.2))
MOUNTS = {"main": XT16_MOUNT, "head": L1_MOUNT}


@pytest.mark.parametrize("name", ["main", "head"])
def test_the_filter_equals_numpy(name: str) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.8, 0.8, (4000, 3))
    turn, place = rotation_rpy(*MOUNTS[name].rpy), np.array(MOUNTS[name].translation)
    local = ((points - place) @ turn).astype(np.float32)
    inside = np.zeros(len(points), bool)
    for part in (BODY, ANTENNA):
        inside |= ((points > part.low) & (points < part.high)).all(axis=1)
    edge = np.zeros(len(points), bool)
    for part in (BODY, ANTENNA):
        edge |= (np.minimum(np.abs(points - part.low), np.abs(points - part.high)) < 1e-5).any(axis=1)

    others = OwnFilter([ANTENNA], MOUNTS).others(name, local)

    assert inside.any()
    assert not inside.all()
    np.testing.assert_array_equal(others[~edge], ~inside[~edge])
    np.testing.assert_allclose(OwnFilter([], MOUNTS).in_base(name, local), points, atol=1e-6)


@pytest.mark.parametrize(
    ("low", "high"),
    [((0, 0, 0), (0, 1, 1)), ((0, 0, 0), (0.1, -0.1, 0.1)), ((0, 0, 0), (0.1, 1.5, 0.1)), ((-0.9, 0, 0), (0.9, 0.1, 0.1))],
)  # fmt: skip
def test_a_box_that_would_blind_the_robot_is_refused(low: tuple, high: tuple) -> None:
    with pytest.raises(ValidationError):
        OwnPart(low=low, high=high)


def scene(walls: float) -> np.ndarray:
    """(n, 3) points on two walls beside a lane of half width `walls` along x, 12 m long."""
    x, z = np.meshgrid(np.arange(-2.0, 10.0, 0.02), np.arange(0.1, 0.9, 0.04))
    sides = [np.stack([x, np.full_like(x, y), z], axis=-1).reshape(-1, 3) for y in (-walls, walls)]
    return np.concatenate(sides)


def seen_from(
    world: np.ndarray, x: float, yaw: float, part: OwnPart | None, rng: np.random.Generator
) -> tuple:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_rpy(0.0, 0.0, yaw), (x, 0.0, 0.4)
    points = (world - pose[:3, 3]) @ pose[:3, :3]
    if part is not None:
        own = rng.uniform(part.low, part.high, (12, 3))
        points = np.concatenate([points, own])
    return points + rng.normal(0.0, 0.01, points.shape), pose


def drive(part: OwnPart | None, walls: float = 0.6, *, turn: bool = True, wide: float = 0.05) -> OwnParts:
    """Along a lane, weaving by `wide` [rad], with a turn of 156 deg at its end."""
    rng, parts, world = np.random.default_rng(1), OwnParts(), scene(walls)
    for k in range(60):
        parts.look(*seen_from(world, 0.05 * k, wide * math.sin(0.4 * k), part, rng))
    for k in range(40 if turn else 0):
        parts.look(*seen_from(world, 3.0, math.radians(4.0 * k), part, rng))
    return parts


def test_a_part_that_nobody_told_of_is_told_with_its_box() -> None:
    (found,) = drive(ANTENNA).found
    assert all(f <= a for f, a in zip(found.low, ANTENNA.low, strict=True))
    assert all(f >= a for f, a in zip(found.high, ANTENNA.high, strict=True))
    assert max(np.subtract(found.size, ANTENNA.size)) <= 2 * SPARE + 0.16, "a voxel to each side at most"
    told = drive(ANTENNA).words
    assert str(found) in told
    assert "moves with the robot" in told
    with taken_out(OWN_PARTS.name):
        assert drive(ANTENNA).words == ""


@pytest.mark.parametrize("walls", [0.45, 0.6, 0.75])
@pytest.mark.parametrize("wide", [0.0, 0.3])
def test_walls_that_the_robot_drives_along_are_none(walls: float, wide: float) -> None:
    assert drive(None, walls, wide=wide).found == ()


def test_before_it_has_turned_nothing_is_told() -> None:
    assert drive(ANTENNA, turn=False).found == ()


def test_a_robot_that_stands_tells_nothing() -> None:
    rng, parts = np.random.default_rng(1), OwnParts()
    for _ in range(200):
        parts.look(*seen_from(scene(0.5), 0.0, 0.0, ANTENNA, rng))
    assert parts.found == ()
    assert DRIVEN > 0.0
