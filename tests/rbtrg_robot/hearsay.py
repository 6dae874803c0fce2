"""What other processes tell the one that is tested: where `odom` lies in `map`, and that nothing is in the way."""

from __future__ import annotations

from typing import Any

import numpy as np

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.wire.convert import BASE, rpy_quaternion, transform_msg
from rbtrg_robot.wire.messages import header


def map_offset(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Any:
    """tf2_msgs/TFMessage of odom at x, y [m], yaw [rad] in map."""
    turn = rpy_quaternion((0.0, 0.0, yaw))
    return t.TF_STATIC.kind(transforms=[transform_msg(0, "map", "odom", np.array([x, y, 0.0]), turn)])


def all_clear(now: int) -> msg.MotionLimits:
    """The guard allows 1 m/s and 1 rad/s everywhere."""
    return msg.MotionLimits(header=header(now, BASE), forward=1.0, backward=1.0, left=1.0, right=1.0)
