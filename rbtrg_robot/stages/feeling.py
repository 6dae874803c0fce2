"""What the robot process makes of a touch: the robot stands, the map hears of it, the operator reads it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hal.limbs import Limbs
from hal.robots import Body
from hal.safety import monitors
from hal.safety.gate_types import MotionLimits
from hal.safety.touch import FACE_HEIGHT, Touch, TouchWatch
from hal.types import NS, ImuSample, JointSample, VelocityCommand
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.wire.convert import MAP, point, yaw_quaternion
from rbtrg_robot.wire.messages import header

HOLD_FOR = NS
"""[ns] for which nothing moves but away from it: the map has it by then, and the guard stops before it..."""
TOLD_FOR = 10 * NS
"""... and for which the operator reads of it at least."""


class Feeling:
    """In: IMU, joints, what is driven, the guard's limits. Out: what was touched. It decides whether the map explains
    what holds the robot."""

    def __init__(self, limbs: Limbs, body: Body) -> None:
        self._watch = TouchWatch(limbs, body.sprung_mass, body.touch_force)
        self._half = body.length / 2
        self._limits: MotionLimits | None = None
        self._last: tuple[Touch, int, str] | None = None
        """The last touch, when [ns] it was, and in words."""

    def imu(self, sample: ImuSample) -> None:
        """Between joint samples."""
        self._watch.imu(sample)

    def guard(self, limits: MotionLimits | None) -> None:
        """The newest; None without any."""
        self._limits = limits

    def joints(
        self,
        sample: JointSample,
        driven: VelocityCommand,
        place_of: Callable[[], tuple[NDArray[np.float64], float] | None],
        speed: float | None = None,
    ) -> Outputs:
        """`place_of` is asked at a touch: position (3,) [m] and yaw [rad] of base_link in `map`; `speed`: measured,
        forward [m/s]; None where nobody knows it."""
        near = self._limits is None or self._limits.near_body
        touch = self._watch.joints(
            sample, driven.vx, driven.wz, self._uneven(driven.vx), speed, near_body=near
        )
        if touch is None:
            return []
        outputs: Outputs = []
        where = "a place that nobody knows"
        if (place := place_of()) is not None:
            (x, y, z), yaw = place[0].tolist(), place[1]
            ahead = touch.way * self._half
            x += ahead * math.cos(yaw) - touch.left * math.sin(yaw)
            y += ahead * math.sin(yaw) + touch.left * math.cos(yaw)
            towards = yaw_quaternion(yaw if touch.way > 0.0 else yaw + math.pi)
            outputs.append(
                (t.TOUCHED, msg.PoseStamped(header(sample.stamp, MAP), msg.Pose(point((x, y, z)), towards)))
            )
            where = f"({x:.1f}, {y:.1f})"
        self._last = touch, sample.stamp, monitors.TOUCHED.tell(where=where)
        return outputs

    def may_climb(self, vx: float) -> bool:
        """Whether the map has a face that a wheel may be lifted onto."""
        return self._uneven(vx) > FACE_HEIGHT

    def limits(self, now: int) -> MotionLimits | None:
        """The guard's, and no motion but away from what was just touched."""
        if self._limits is None or self._last is None or not 0 <= now - self._last[1] < HOLD_FOR:
            return self._limits
        (way, _), _, words = self._last
        held = replace(self._limits, left=0.0, right=0.0, reason=words)
        return replace(held, forward=0.0) if way > 0.0 else replace(held, backward=0.0)

    def words(self, now: int) -> str:
        """Of the last touch; empty where it is long ago."""
        return self._last[2] if self._last is not None and 0 <= now - self._last[1] < TOLD_FOR else ""

    def _uneven(self, vx: float) -> float:
        """[m]; infinite where no guard tells."""
        if self._limits is None:
            return math.inf
        return self._limits.uneven_behind if vx < 0.0 else self._limits.uneven_ahead
