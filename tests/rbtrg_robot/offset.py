"""Where `odom` lies in `map`, as odometry says it."""

from __future__ import annotations

from typing import Any

import numpy as np

from rbtrg_robot import topics as t
from rbtrg_robot.wire.convert import rpy_quaternion, transform_msg


def map_offset(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Any:
    """tf2_msgs/TFMessage of odom at x, y [m], yaw [rad] in map."""
    turn = rpy_quaternion((0.0, 0.0, yaw))
    return t.TF_STATIC.kind(transforms=[transform_msg(0, "map", "odom", np.array([x, y, 0.0]), turn)])
