"""What the robot process makes of a touch: it stands, says where, lets go after a while, and lifts wheels only onto
what the map has."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hal.robots import describe
from hal.robots.go2w import facts as go2w
from hal.safety.gate_types import MotionLimits
from hal.types import NS, ImuSample, JointSample, VelocityCommand
from rbtrg_robot import topics as t
from rbtrg_robot.stages.feeling import HOLD_FOR, TOLD_FOR, Feeling
from rbtrg_robot.wire.convert import yaw_of

FREE = (1.0, 1.0, 1.0, 1.0, "")


class Pressed:
    """A robot that drives at `vx` while something pushes at its body with 100 N [wheels carry nothing that would
    explain it]."""

    def __init__(self, vx: float = 0.4, uneven: float = 0.0, *, near_body: bool = False) -> None:
        self.feeling = Feeling(go2w.LIMBS, describe().body)
        limits = MotionLimits(0, *FREE, uneven_ahead=uneven, uneven_behind=uneven, near_body=near_body)
        self.feeling.guard(limits)
        self.vx = vx
        self.now = NS

    def push(self, place: Any = (np.array([2.0, 1.0, 0.4]), math.pi / 2)) -> list[Any]:
        out: list[Any] = []
        for _ in range(5):
            self.now += NS // 50
            accel = np.array([-math.copysign(100.0, self.vx) / describe().body.sprung_mass, 0.0, 9.81])
            self.feeling.imu(ImuSample(self.now, np.zeros(3), accel))
            joints = JointSample(self.now, go2w.STAND.copy(), np.zeros(16), np.zeros(16))
            out += self.feeling.joints(joints, VelocityCommand(self.now, self.vx), lambda: place)
        return out


@pytest.mark.parametrize("vx", [0.4, -0.4])
def test_it_holds_motion_towards_what_was_touched_and_turns_and_tells_where(vx: float) -> None:
    robot = Pressed(vx)
    ((topic, told),) = robot.push()[:1]
    assert topic is t.TOUCHED
    way = math.copysign(1.0, vx)
    assert told.pose.position.x == pytest.approx(2.0)
    assert told.pose.position.y == pytest.approx(1.0 + 0.35 * way)
    assert math.sin(yaw_of(told.pose.orientation)) == pytest.approx(way)
    limits = robot.feeling.limits(robot.now)
    assert limits is not None
    assert (limits.forward, limits.backward) == ((0.0, 1.0) if vx > 0.0 else (1.0, 0.0))
    assert limits.left == limits.right == 0.0
    words = f"touched something that the LiDAR does not see at (2.0, {1.0 + 0.35 * way:.1f})"
    assert limits.reason == robot.feeling.words(robot.now) == words
    later = robot.feeling.limits(robot.now + HOLD_FOR)
    assert later is not None
    assert (later.forward, later.left, later.reason) == (1.0, 1.0, "")
    assert robot.feeling.words(robot.now + HOLD_FOR) == words
    assert robot.feeling.words(robot.now + TOLD_FOR) == ""


def test_where_nobody_knows_the_place_it_stands_all_the_same() -> None:
    robot = Pressed()
    assert robot.push(None) == []
    limits = robot.feeling.limits(robot.now)
    assert limits is not None
    assert limits.forward == 0.0
    assert "a place that nobody knows" in limits.reason


def test_what_the_map_tells_is_no_touch_and_may_be_climbed() -> None:
    wall = Pressed(uneven=0.3, near_body=True)
    assert not wall.push()
    assert wall.feeling.words(wall.now) == ""
    assert wall.feeling.may_climb(0.3)
    assert not Pressed().feeling.may_climb(0.3)
    assert Feeling(go2w.LIMBS, describe().body).may_climb(0.3), "without a guard nobody tells"
