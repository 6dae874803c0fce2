"""Tell the robot where it stands in `map`."""

from __future__ import annotations

import math
import time
from typing import Any

from hal.rotation import wrap
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.orders.limits import ANSWER_LIMIT, RESEND_PERIOD
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP, point, yaw_of, yaw_quaternion
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import header

POSE_NEAR = (0.05, 0.03)
"""A robot that is this near [m, rad] is where it was said to be."""


class SetPose(Order):
    """Sent until the robot is there in `map`."""

    hears = (t.TF_STATIC, t.ODOM)
    sends = (t.INITIAL_POSE,)

    def __init__(self, x: float, y: float, yaw: float) -> None:
        """x, y [m], yaw [rad] in `map`."""
        super().__init__(RESEND_PERIOD, ANSWER_LIMIT)
        self._frame = MapFrame()
        self._wanted = x, y, yaw

    def message(self) -> tuple[Topic, msg.Message]:
        """The pose."""
        x, y, yaw = self._wanted
        message = msg.PoseWithCovarianceStamped(header=header(time.time_ns(), MAP))
        message.pose.pose.position = point((x, y, 0.0))
        message.pose.pose.orientation = yaw_quaternion(yaw)
        return t.INITIAL_POSE, message

    def take(self, topic: Topic, message: Any) -> None:
        """The frames, told anew, or a pose of the robot."""
        if t.TF_STATIC.carried(message, topic):
            self._frame.take(message)
        if not t.ODOM.carried(message, topic) or not self._frame.known or math.isnan(self.began):
            return
        pose, (x, y, yaw) = message.pose.pose, self._wanted
        here = self._frame.pose2(pose.position.x, pose.position.y, yaw_of(pose.orientation))
        if math.dist(here[:2], (x, y)) < POSE_NEAR[0] and abs(wrap(here[2] - yaw)) < POSE_NEAR[1]:
            self.outcome = Outcome(True, "the robot stands there now; the map is laid anew")

    def silence(self) -> Outcome:
        """The odometry does not take it."""
        return Outcome(False, "the pose was not taken: the robot must stand")
