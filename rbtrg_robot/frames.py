"""map <- odom, looked up by every consumer; the identity until a correction is published."""

from __future__ import annotations

import math
from typing import Any

from rbtrg_robot.convert import MAP, ODOM, yaw_of


class MapFrame:
    """The planar and vertical offset of `odom` in `map` (both are gravity-aligned)."""

    def __init__(self) -> None:
        self.x = 0.0
        self.y = 0.0
        self.z = 0.0
        self.yaw = 0.0

    def take(self, message: Any) -> None:
        """From a tf2_msgs/TFMessage."""
        for transform in message.transforms:
            if transform.header.frame_id == MAP and transform.child_frame_id == ODOM:
                offset = transform.transform.translation
                self.x, self.y, self.z = offset.x, offset.y, offset.z
                self.yaw = yaw_of(transform.transform.rotation)

    def pose2(self, x: float, y: float, yaw: float) -> tuple[float, float, float]:
        """A planar pose in `odom` as one in `map`."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return (
            self.x + c * x - s * y,
            self.y + s * x + c * y,
            math.remainder(yaw + self.yaw, 2 * math.pi),
        )
