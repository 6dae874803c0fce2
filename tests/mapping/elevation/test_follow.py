"""A map that goes on with another one of the same ground: what the other does not know stays, moved."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.types import NS
from mapping.elevation.map import ElevationMap, Move
from mapping.elevation.mirror import MapMirror

SECOND = NS
BOX = (2.0, 1.0)
"""Middle of a box of half a metre [m]."""


def look(elevation: ElevationMap, x: float, y: float, yaw: float, z: float, stamp: int, reach: float) -> None:
    """What a robot sees up to `reach` [m] that stands at x, y, z + 0.4 [m] by its odometry, in truth at the origin."""
    col, row = np.meshgrid(np.arange(-reach, reach, 0.02), np.arange(-reach, reach, 0.02))
    box = np.maximum(np.abs(col - BOX[0]), np.abs(row - BOX[1])) < 0.25
    points = np.stack([col, row, np.where(box, 0.5, 0.0) - 0.4], -1).reshape(-1, 3).astype(np.float32)
    turned = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    for k in range(4):
        elevation.fuse(points, (x, y, z + 0.4), turned, stamp + k * SECOND // 10)


def height(elevation: ElevationMap, x: float, y: float) -> float:
    grid = elevation.grid()
    r = grid.resolution
    return float(grid.height[round((y - grid.origin[1]) / r), round((x - grid.origin[0]) / r)])


def mirrored(mirror: MapMirror, elevation: ElevationMap) -> None:
    while patches := elevation.take_patches():
        for patch in patches:
            mirror.apply(patch)


@pytest.mark.parametrize("glided", [False, True])
def test_what_the_other_does_not_know_stays_where_it_belongs(glided: bool) -> None:
    turn, shift, lift = 0.02, (0.4, -0.28), 0.1
    other, elevation, mirror = ElevationMap(), ElevationMap(), MapMirror()
    look(other, *shift, turn, lift, SECOND, 1.2)  # without the box
    look(elevation, 0.0, 0.0, 0.0, 0.0, SECOND, 1.2)
    look(elevation, 0.0, 0.0, 0.0, 0.0, 20 * SECOND, 3.0)
    mirrored(mirror, elevation)
    before, epoch = elevation.alignment.height, elevation.epoch
    begin = 40 * SECOND if not glided else 10 * SECOND
    move = Move((*shift, turn), lift, begin, 40 * SECOND)
    patches = [other.read(box) for box in other.boxes()]
    assert elevation.follow(patches, other.cloud.points, 10 * SECOND, move) > 1000
    assert elevation.epoch == epoch
    assert elevation.alignment.height - before == pytest.approx(lift)
    left = 2.0 / 3.0 if glided else 1.0
    x, y = BOX
    moved = x + left * (shift[0] - turn * y), y + left * (shift[1] + turn * x)
    assert height(elevation, *moved) == pytest.approx(0.5 + lift, abs=0.02)
    assert height(elevation, moved[0] - 0.6, moved[1]) == pytest.approx(lift, abs=0.02)
    mirrored(mirror, elevation)
    mine, theirs = elevation.grid().trusted, mirror.grid().trusted
    assert theirs.sum() == mine.sum() > 10_000, "readers forget what is gone"


def test_what_was_seen_before_gives_way() -> None:
    other, elevation = ElevationMap(), ElevationMap()
    look(other, 0.0, 0.0, 0.0, 0.0, SECOND, 1.0)
    look(elevation, 0.0, 0.0, 0.0, 0.0, SECOND, 3.0)
    patches = [other.read(box) for box in other.boxes()]
    elevation.follow(patches, other.cloud.points, 5 * SECOND, Move((0.0, 0.0, 0.0), 0.0, 0, 5 * SECOND))
    assert elevation.store.counts()[1] == other.store.counts()[1]
