"""map <- odom, looked up by every consumer; constant until a correction is published.

In simulation `map` is the scene's own frame and the offset is the start pose the robot was given; on hardware it is
the identity unless the configuration says where the robot starts.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from rbtrg_robot.msg import Odometry, TFMessage
from rbtrg_robot.wire.convert import MAP, ODOM, yaw_of

Planar = tuple[float, float, float]
"""x, y [m], yaw [rad]."""


class MapFrame:
    """The offset of `odom` in `map`; both are gravity-aligned, so it is a translation and a heading."""

    def __init__(self) -> None:
        self.known = False
        self.x = 0.0
        self.y = 0.0
        self.z = 0.0
        self.yaw = 0.0

    def take(self, message: TFMessage) -> bool:
        """Take the offset from a tf2_msgs/TFMessage; an offset that is not finite is ignored. Returns whether a known
        offset changed."""
        before = (self.x, self.y, self.z, self.yaw) if self.known else None
        for transform in message.transforms:
            if transform.header.frame_id == MAP and transform.child_frame_id == ODOM:
                offset, yaw = transform.transform.translation, yaw_of(transform.transform.rotation)
                if all(map(math.isfinite, (offset.x, offset.y, offset.z, yaw))):
                    self.x, self.y, self.z, self.yaw = offset.x, offset.y, offset.z, yaw
                    self.known = True
        return before not in (None, (self.x, self.y, self.z, self.yaw))

    def pose2(self, x: float, y: float, yaw: float) -> Planar:
        """A planar pose in `odom` as one in `map`."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return (
            self.x + c * x - s * y,
            self.y + s * x + c * y,
            wrap(yaw + self.yaw),
        )

    def pose3(
        self, position: NDArray[np.float64], orientation: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position (3,) and orientation x, y, z, w in `odom` as in `map`."""
        px, py, pz = position.tolist()  # plain floats: numpy's cost three times as much
        x, y, _ = self.pose2(px, py, 0.0)
        c, s = math.cos(self.yaw / 2), math.sin(self.yaw / 2)
        qx, qy, qz, qw = orientation.tolist()
        turned = np.array([c * qx - s * qy, c * qy + s * qx, c * qz + s * qw, c * qw - s * qz])
        return np.array([x, y, pz + self.z]), turned


def offset_of(place: Planar, odom: Odometry) -> Planar:
    """Offset of `odom` in `map` of a robot that stands at `place` in `map`."""
    here = odom.pose.pose
    turn = wrap(place[2] - yaw_of(here.orientation))
    c, s = math.cos(turn), math.sin(turn)
    x = place[0] - c * here.position.x + s * here.position.y
    y = place[1] - s * here.position.x - c * here.position.y
    return x, y, turn


STANDING = (0.05, 0.1)
"""Speed [m/s] and yaw rate [rad/s] below which a robot stands."""


def stands(odom: Odometry) -> bool:
    """By a nav_msgs/Odometry."""
    twist = odom.twist.twist
    return math.hypot(twist.linear.x, twist.linear.y) < STANDING[0] and abs(twist.angular.z) < STANDING[1]
