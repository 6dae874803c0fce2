"""map <- odom, looked up by every consumer; constant until a correction is published, which jumps or glides.

In simulation `map` is the scene's own frame and the offset is the start pose the robot was given; on hardware it is
the identity unless the configuration says where the robot starts.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from hal.types import Array
from rbtrg_robot import msg
from rbtrg_robot.msg import Odometry, TFMessage
from rbtrg_robot.wire.convert import MAP, ODOM, yaw_of
from rbtrg_robot.wire.messages import time_msg

Planar = tuple[float, float, float]
"""x, y [m], yaw [rad]."""

GLIDE_SPEEDS = (0.02, math.radians(0.1))
"""How fast the robot, the origin of `odom` [m/s] and the heading [rad/s] move in `map` while its loops are closed as
the robot drives: in a second less than a cell, up to 10 m away. The map and its readers keep up with that."""
LEAST_JUMP = (0.05, math.radians(0.25))
"""An offset that differs by less [m], [rad] from the one before is a piece of a glide, even if some were not heard."""


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
        offset jumped: what was worked out in `map` is elsewhere now."""
        before = self.offset if self.known else None
        for transform in message.transforms:
            if transform.header.frame_id == MAP and transform.child_frame_id == ODOM:
                offset, yaw = transform.transform.translation, yaw_of(transform.transform.rotation)
                if all(map(math.isfinite, (offset.x, offset.y, offset.z, yaw))):
                    self.x, self.y, self.z, self.yaw = offset.x, offset.y, offset.z, yaw
                    self.known = True
        return before is not None and not near(before, self.offset, LEAST_JUMP)

    @property
    def offset(self) -> Planar:
        """x, y [m], yaw [rad]."""
        return self.x, self.y, self.yaw

    def pose2(self, x: float, y: float, yaw: float) -> Planar:
        """A planar pose in `odom` as one in `map`."""
        return laid(self.offset, (x, y, yaw))

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


def laid(offset: Planar, place: Planar) -> Planar:
    """A place in `odom` as one in `map`, where `odom` lies at `offset`."""
    c, s = math.cos(offset[2]), math.sin(offset[2])
    x, y, yaw = place
    return offset[0] + c * x - s * y, offset[1] + s * x + c * y, wrap(yaw + offset[2])


def near(a: Planar, b: Planar, within: tuple[float, float]) -> bool:
    """Whether two offsets differ by less than `within` [m], [rad]."""
    return math.dist(a[:2], b[:2]) < within[0] and abs(wrap(a[2] - b[2])) < within[1]


def glide(offset: Planar, target: Planar, place: Planar, seconds: float) -> Planar:
    """The offset of `odom` in `map` so many `seconds` later on its way to `target`, by `GLIDE_SPEEDS`. place: the
    robot's in `odom`."""
    here, there = laid(offset, place), laid(target, place)
    turn = wrap(target[2] - offset[2])
    moves = max(math.dist(here[:2], there[:2]), math.dist(offset[:2], target[:2]))
    needs = max(moves / GLIDE_SPEEDS[0], abs(turn) / GLIDE_SPEEDS[1])
    if needs <= seconds:
        return target
    share = seconds / needs
    x, y = (a + share * (b - a) for a, b in zip(offset[:2], target[:2], strict=True))
    return x, y, wrap(offset[2] + share * turn)


def offset_of(place: Planar, odom: Odometry) -> Planar:
    """Offset of `odom` in `map` of a robot that stands at `place` in `map`."""
    here = odom.pose.pose
    return offset_between(place, (here.position.x, here.position.y, yaw_of(here.orientation)))


def offset_between(place: Planar, here: Planar) -> Planar:
    """The same of one that is `here` in `odom`."""
    turn = wrap(place[2] - here[2])
    c, s = math.cos(turn), math.sin(turn)
    return place[0] - c * here[0] + s * here[1], place[1] - s * here[0] - c * here[1], turn


STANDING_SPEEDS = (0.05, 0.1)
"""Speed [m/s] and yaw rate [rad/s] below which a robot stands."""


def stands(odom: Odometry) -> bool:
    """By a nav_msgs/Odometry."""
    twist = odom.twist.twist
    return (
        math.hypot(twist.linear.x, twist.linear.y) < STANDING_SPEEDS[0]
        and abs(twist.angular.z) < STANDING_SPEEDS[1]
    )


def closed_map(prior: msg.MapPrior, there: Array, here: Array, higher: float, until: int) -> msg.MapPrior:
    """A map of this run as the stack goes on with it. there, here (4,): x, y, z [m], yaw [rad] of base_link in it and
    in `odom` at its newest scan, `until` [ns]; higher: how much higher [m] the stack's map lay then."""
    x, y, z, yaw = there.tolist()
    a, b, c, turn = here.tolist()
    offset = offset_between((x, y, yaw), (a, b, turn))
    return replace(prior, odom_in_map=np.array([*offset, z - c - higher]), until=time_msg(until))
