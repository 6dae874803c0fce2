"""Groups messages into scans of the elevation stage by their stamps, so the order of arrival does not matter."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hal.limbs import MOTORS
from hal.types import JointSample, LidarName
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import BASE, MAP, ODOM, cloud_msg, joint_msg, odometry_msg, transform_msg
from rbtrg_robot.wire.messages import stamp_of

WAIT_SCANS = 2
"""A scan whose cloud or joints are missing is dropped once this many newer ones have come."""
KEPT_POSES, KEPT_CLOUDS, KEPT_JOINTS = 50, 10, 100
"""Kept at most."""


class Scan(NamedTuple):
    """All of one sweep; clouds (n, 3) float32 in base_link [m]."""

    stamp: int
    odom: msg.Odometry
    clouds: dict[LidarName, NDArray[np.float32]]
    joints: JointSample | None


class Scans:
    """Poses, clouds and joints that wait for each other."""

    def __init__(self, lidars: Collection[LidarName]) -> None:
        """`lidars`: whose clouds make a whole scan."""
        self._lidars = set(lidars)
        self._poses: OrderedDict[int, msg.Odometry] = OrderedDict()
        self._clouds: OrderedDict[int, dict[LidarName, NDArray[np.float32]]] = OrderedDict()
        self._joints: list[JointSample] = []

    def pose(self, message: msg.Odometry) -> None:
        """The pose at the end of a scan."""
        self._poses[stamp_of(message)] = message

    def cloud(self, stamp: int, lidar: LidarName, points: NDArray[np.float32]) -> None:
        """The deskewed cloud of a LiDAR, (n, 3) in base_link [m]."""
        self._clouds.setdefault(stamp, {})[lidar] = points

    def joints(self, sample: JointSample) -> None:
        """A sample of the joints; they come in order."""
        self._joints.append(sample)
        del self._joints[:-KEPT_JOINTS]

    def forget(self) -> None:
        """Drop poses and clouds that wait: the map begins anew."""
        self._poses.clear()
        self._clouds.clear()

    def take(self) -> Iterator[Scan]:
        """Scans that are whole, oldest first. `forget` may be called on the way."""
        for stamp in sorted(self._poses.keys() & self._clouds.keys()):
            if stamp not in self._clouds:  # forgotten meanwhile
                break
            joints = self._joints_at(stamp)
            newer = sum(1 for other in self._clouds if other > stamp)
            if (joints is None or self._clouds[stamp].keys() != self._lidars) and newer < WAIT_SCANS:
                break
            yield Scan(stamp, self._poses.pop(stamp), self._clouds.pop(stamp), joints)
            for waiting in (self._poses, self._clouds):
                for old in [s for s in waiting if s < stamp]:
                    del waiting[old]
        while len(self._poses) > KEPT_POSES:
            self._poses.popitem(last=False)
        while len(self._clouds) > KEPT_CLOUDS:
            self._clouds.popitem(last=False)

    def _joints_at(self, stamp: int) -> JointSample | None:
        """The last sample at or before `stamp`, once a later one shows that it is the last."""
        if not self._joints or self._joints[-1].stamp < stamp:
            return None
        before = [j for j in self._joints if j.stamp <= stamp]
        return before[-1] if before else self._joints[0]


def rehearsal(clouds: tuple[Topic, ...]) -> Iterator[tuple[Topic, msg.Message]]:
    """One scan as the wire brings it: what comes from there is read-only, and numba compiles for that apart."""
    turned = (0.0, 0.0, 0.0, 1.0)
    points = np.array([[2.0, 0.1 * k, -0.4] for k in range(8)], np.float32)
    still = np.zeros(len(MOTORS))
    yield t.TF_STATIC, msg.TFMessage(transforms=[transform_msg(0, MAP, ODOM, np.zeros(3), turned)])
    yield t.JOINTS, joint_msg(JointSample(0, still, still, still))
    for topic in clouds:
        yield topic, cloud_msg(0, BASE, points)
    yield t.ODOM, odometry_msg(0, np.zeros(3), turned, np.zeros(3), np.zeros(3))
