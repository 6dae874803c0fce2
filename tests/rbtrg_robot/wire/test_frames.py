"""`odom` in `map`: jumps are told, glides are slow and come to their end."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rbtrg_robot import msg
from rbtrg_robot.wire.convert import MAP, ODOM, rpy_quaternion, transform_msg
from rbtrg_robot.wire.frames import GLIDE_SPEEDS, MapFrame, Planar, glide, laid, near, wrap


def told(offset: Planar) -> msg.TFMessage:
    x, y, yaw = offset
    return msg.TFMessage(
        transforms=[transform_msg(0, MAP, ODOM, (x, y, 0.0), rpy_quaternion((0.0, 0.0, yaw)))]
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_glide_keeps_its_limits_and_ends_where_it_is_to(seed: int) -> None:
    rng = np.random.default_rng(seed)
    offset = (*rng.uniform(-50, 50, 2).tolist(), rng.uniform(-math.pi, math.pi))
    target = (
        *(np.array(offset[:2]) + rng.uniform(-1, 1, 2)).tolist(),
        wrap(offset[2] + rng.uniform(-0.02, 0.02)),
    )
    place = (*rng.uniform(-100, 100, 2).tolist(), 0.3)
    frame, steps = MapFrame(), 0
    frame.take(told(offset))
    while offset != target:
        before, offset = offset, glide(offset, target, place, 0.1)
        steps += 1
        assert math.dist(before[:2], offset[:2]) <= 0.1 * GLIDE_SPEEDS[0] + 1e-12
        assert abs(wrap(offset[2] - before[2])) <= 0.1 * GLIDE_SPEEDS[1] + 1e-12
        # along a chord, not an arc: the robot is a hair faster
        assert math.dist(laid(before, place)[:2], laid(offset, place)[:2]) <= 0.101 * GLIDE_SPEEDS[0] + 1e-12
        assert not frame.take(told(offset)), "no reader begins anew"
        assert steps < 10_000
    assert near(frame.offset, target, (1e-9, 1e-9))


@pytest.mark.parametrize("offset", [(0.06, 0.0, 0.0), (0.0, 0.0, 0.006), (0.0, -3.0, 1.0)])
def test_a_jump_is_told(offset: Planar) -> None:
    frame = MapFrame()
    assert not frame.take(told((0.0, 0.0, 0.0))), "the first one is none"
    assert frame.take(told(offset))
    assert not frame.take(told(offset))
    assert not frame.take(told((math.nan, 0.0, 0.0)))
    assert near(frame.offset, offset, (1e-9, 1e-9))
