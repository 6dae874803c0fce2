"""One run into a recording for maps that close: poses, clouds and joints that belong together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.limbs import stand_height
from hal.rotation import rotation
from hal.types import Array, LidarName
from mapping.closing import Recording
from mapping.elevation.exchange import MapError
from mapping.elevation.poses import Course
from mapping.elevation.sensor import Sensor
from mapping.odometry.contacts import wheel_contacts
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.stages.scans import Scan, Scans
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import LayoutError, cloud_points, joint_sample, xyz, xyzw
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import stamp_of


class Reader:
    """Messages in, scans recorded."""

    def __init__(
        self, recording: Recording, run: int, config: StackConfig, origin: Sequence[float] | None = None
    ) -> None:
        """origin: x, y, z [m], yaw [rad] of `odom` in `map` at the first scan of a recording that goes on."""
        self.frame = MapFrame()
        """Where `odom` lay in `map` at the first scan."""
        if origin is not None:
            self.frame.x, self.frame.y, self.frame.z, self.frame.yaw = origin
            self.frame.known = True
        self._fixed = origin is not None
        self.refused = 0
        """What could not be used."""
        self.until = 2**62
        """Later scans [ns] are left out."""
        self.scans = 0
        self._recording, self._run, self._robot = recording, run, config.facts
        self._sensors = {lidar.name: Sensor.of(lidar) for lidar in config.mounted_lidars()}
        self._names = {t.CLOUDS[name]: name for name in self._sensors}
        self._waiting = Scans(self._sensors)
        self._course = Course()
        self.inputs: tuple[Topic, ...] = (t.ODOM, t.JOINTS, t.TF_STATIC, *self._names)

    def take(self, topic: Topic, message: Any) -> None:
        """One message of `inputs`; what cannot be is left out, as every stage does."""
        try:
            if t.ODOM.carried(message, topic):
                self._waiting.pose(message)
            elif t.JOINTS.carried(message, topic):
                self._waiting.joints(joint_sample(message))
            elif t.TF_STATIC.carried(message, topic):
                if not self._fixed and not (self.scans and self.frame.known):
                    self.frame.take(message)
            else:
                self._waiting.cloud(stamp_of(message), self._names[topic], cloud_points(message))
        except LayoutError:
            self.refused += 1
            return
        self._take_scans()

    def wants(self, pose: Array, stamp: int) -> bool:
        """Whether a scan at a pose (4, 4) in `odom` would be kept."""
        return self._recording.wants(self._run, stamp, pose)

    def scan(self, message: msg.Odometry, clouds: Mapping[LidarName, NDArray[np.float32]]) -> None:
        """A pose and the clouds (n, 3) that belong to it, base_link [m]."""
        self._waiting.pose(message)
        for name, points in clouds.items():
            self._waiting.cloud(stamp_of(message), name, points)
        self._take_scans()

    def _take_scans(self) -> None:
        for scan in self._waiting.take():
            self._record(scan)

    def _record(self, scan: Scan) -> None:
        if scan.stamp > self.until:
            return
        pose = np.eye(4)
        try:
            q = xyzw(scan.odom.pose.pose.orientation)
            pose[:3, 3] = xyz(scan.odom.pose.pose.position)
            self._course.follow(pose[:3, 3], scan.stamp)
            pose[:3, :3] = rotation(q / np.linalg.norm(q))
        except MapError:
            self.refused += 1
            return
        joints = scan.joints
        limbs = self._robot.limbs
        below = stand_height(limbs, self._robot.pose if joints is None else joints.position)
        contacts = np.empty((0, 3)) if joints is None else wheel_contacts(limbs, joints)
        clouds = [(self._sensors[name], points) for name, points in scan.clouds.items()]
        self.scans += 1
        self._recording.add(self._run, scan.stamp, pose, clouds, below, contacts)

    @property
    def origin(self) -> Array:
        """(4,) of `odom` in `map`: x, y, z [m], yaw [rad]."""
        return np.array([self.frame.x, self.frame.y, self.frame.z, self.frame.yaw])
