"""Places of the obstacles at a time."""

from __future__ import annotations

from hal.lidar.caster import OrientedBox
from hal.mujoco.config import Obstacle


def present(obstacle: Obstacle, time: float) -> bool:
    """Whether it is there `time` [s] after connect."""
    return obstacle.appear <= time < obstacle.disappear


def box_at(obstacle: Obstacle, time: float) -> OrientedBox:
    """Its place `time` [s] after connect, if it is there."""
    x, y, z = obstacle.centre
    age = time - obstacle.appear
    vx, vy = obstacle.velocity
    return OrientedBox((x + vx * age, y + vy * age, z), obstacle.size, obstacle.yaw)
