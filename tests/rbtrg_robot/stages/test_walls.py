"""The fence as walls in the map that is planned on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hal.safety.geofence import Fence, Geofence
from mapping.grid import ElevationGrid
from rbtrg_robot.stages.walls import WALL_HEIGHT, WALL_ROOM, wall_up, windows

RES = 0.05
SHAPES = {
    "a square": [(1.0, 1.0), (3.0, 1.0), (3.0, 2.5), (1.0, 2.5)],
    "turned and dented": [(0.5, 1.7), (2.0, 0.4), (3.6, 1.4), (2.1, 1.6), (2.4, 2.8)],
    "half off the map": [(-2.0, -1.0), (1.0, -1.0), (1.3, 2.0), (-1.5, 2.2)],
    "thinner than a cell": [(0.5, 0.5), (3.0, 2.0), (3.0, 2.01)],
}


@pytest.mark.parametrize("keep_out", [True, False])
@pytest.mark.parametrize("name", SHAPES)
def test_walls_stand_where_the_robot_must_not_be(name: str, keep_out: bool) -> None:
    rng = np.random.default_rng(3)
    height = rng.normal(0.0, 0.1, (60, 80)).astype(np.float32)
    trusted = rng.random((60, 80)) > 0.5
    grid = ElevationGrid(height.copy(), trusted.copy(), (0.013, -0.021), RES, virtual=~trusted)
    polygon = Geofence.of(SHAPES[name], keep_out=keep_out)
    wall_up(grid, Fence((polygon,)))
    raised = grid.height - height > 0.5 * WALL_HEIGHT
    assert np.array_equal(grid.height[~raised], height[~raised])
    assert grid.trusted[raised].all()
    assert not grid.virtual[raised].any()
    assert np.array_equal(grid.trusted[~raised], trusted[~raised])
    r0, c0, r1, c1 = windows(Fence((polygon,)), RES)[0]
    for r, c in np.ndindex(grid.shape):
        outside = polygon.outside(0.013 + c * RES, -0.021 + r * RES)
        away = outside if keep_out else abs(outside)
        if away <= WALL_ROOM:
            assert raised[r, c], (r, c)
        if raised[r, c]:
            assert away <= WALL_ROOM + 1.5 * RES, (r, c)
            assert r0 <= r < r1
            assert c0 <= c < c1
    assert raised.any()
    assert math.isfinite(grid.height.max())
