"""Odometry as a stage: sensor messages in, poses and deskewed clouds out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hal.camera import MountedCamera
from hal.robots import urdf
from hal.rotation import quaternion as from_matrix
from hal.rotation import wrap
from hal.types import NO_POINTS, NS, Extrinsics, MountedLidar
from mapping.elevation.exchange import MapError
from mapping.elevation.poses import checked_pose
from mapping.grid import FARTHEST_PLACE
from mapping.odometry.alone import ALONE, LidarAlone, WheelsAlone
from mapping.odometry.pipeline import LidarInertialOdometry
from mapping.odometry.startup import Before
from mapping.odometry.types import FastPose, ScanOdometry
from mapping.odometry.wheels import WheelOdometry
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import (
    BASE,
    CAMERA,
    IMU,
    LIDAR,
    MAP,
    ODOM,
    LayoutError,
    cloud_msg,
    cloud_points,
    imu_sample,
    joint_sample,
    lidar_scan,
    odometry_msg,
    quaternion,
    rpy_quaternion,
    transform_msg,
    xyz,
    xyzw,
    yaw_of,
)
from rbtrg_robot.wire.frames import MapFrame, Planar, glide, near, offset_of, stands
from rbtrg_robot.wire.messages import array, header, stamp_of

TF_EVERY = 4
"""tf at 50 Hz from the 200 Hz pose."""
SAME_POSE = 0.01
"""A pose that differs less [m, rad] from the present one is a repeat."""
STANDS_FOR = 2 * NS
"""A robot that stands so long [ns] is moved in `map` at once: its driver holds no path that it would lose."""
LONGEST_GLIDE = 0.5
"""Between two scans no more is glided than in this time [s]."""


class OdometryStage:
    """Sensor messages in, poses and deskewed clouds out.

    In: IMU, joints, sweeps of every LiDAR, the robot's pose as an operator tells it. Out: the pose at the end of each
    scan, a pose at 200 Hz for control, wheel odometry, deskewed clouds, tf, health. It decides how far its pose can
    be believed: good, degraded or lost. It never stops the robot: others act on its health."""

    def __init__(
        self,
        odometry: LidarInertialOdometry | LidarAlone | WheelsAlone,
        lidars: tuple[MountedLidar, ...],
        imu: Extrinsics,
        start: tuple[float, float, float],
        cameras: tuple[MountedCamera, ...] = (),
        description: str = "",
    ) -> None:
        """`start`: x, y [m], yaw [rad] of the robot in `map`. `cameras`: of them only the frames are told.
        `description`: URDF of the robot."""
        self._description = description
        self._cameras = cameras
        names = [lidar.name for lidar in lidars]
        own = (t.WHEELS,) if isinstance(odometry, WheelsAlone) else ()
        self.inputs = (
            t.IMU,
            t.JOINTS,
            *own,
            t.INITIAL_POSE,
            t.MAP_STATUS,
            *(t.SWEEPS[name] for name in names),
        )
        self.outputs = (
            t.ODOM, t.POSE, t.WHEEL_ODOM, t.ODOM_HEALTH, *(t.CLOUDS[name] for name in names), t.TF, t.TF_STATIC,
            t.DESCRIPTION,
        )  # fmt: skip
        self._odometry = odometry
        self._start = start
        self._lidars = lidars
        self._sweeps = {t.SWEEPS[name]: name for name in names}
        self._imu = imu
        self._before: msg.Odometry | None = None
        """Where the robot was before this process was restarted: the new odometry goes on from there."""
        self._shift = MapFrame()
        self._target: Planar | None = None
        """Where `odom` is to lie in `map` once its loops are closed; `_start` glides there."""
        self._stood = 0
        """Since when the robot stands [ns]; 0 while it moves."""
        self._announced = False
        self._odom: msg.Odometry | None = None
        self._place_sigma = self._told = 0.0
        """Standard deviation of the place in `odom` [m]: now, and when its offset in `map` was told."""
        self._poses = 0
        self._malformed = 0

    def warm_up(self) -> None:
        """Compile the kernels."""
        self._odometry.warm_up()

    def close(self) -> None:
        """Nothing to release."""

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        outputs: Outputs = []
        try:
            if t.IMU.carried(message, topic):
                fast = self._odometry.add_imu(imu_sample(message))
                if fast is not None:
                    outputs += self._fast(fast)
            elif t.JOINTS.carried(message, topic):
                wheel = self._odometry.add_joints(joint_sample(message))
                if wheel is not None:
                    outputs.append((t.WHEEL_ODOM, self._wheel(wheel)))
            elif t.WHEELS.carried(message, topic) and isinstance(self._odometry, WheelsAlone):
                self._odometry.add_speed(stamp_of(message), xyz(message.twist.twist.linear))
            elif topic in self._sweeps:
                self._odometry.add_scan(lidar_scan(message, self._sweeps[topic]))
            elif t.INITIAL_POSE.carried(message, topic):
                outputs += self._place(message)
            elif t.MAP_STATUS.carried(message, topic):
                offset = message.odom_in_map.tolist()
                if message.location == "found":
                    outputs += self._take_offset(*offset)
                self._target = offset if message.location == "closing" and _possible(offset) else None
            elif t.TF_STATIC.carried(message, topic):  # of the process before this one
                known = MapFrame()
                known.take(message)
                if known.known:
                    self._start = (known.x, known.y, known.yaw)
            elif t.ODOM.carried(message, topic):
                checked_pose(xyz(message.pose.pose.position), xyzw(message.pose.pose.orientation))
                self._before = message
            elif t.CLOUD.carried(message, topic):
                self._resume(message)
        except (LayoutError, MapError):
            self._malformed += 1
        for scan in self._odometry.poll():
            if self._before is not None:
                self._continue_from(self._before.pose.pose, scan)
                self._before = None
            outputs += self._scan(scan)
        return outputs

    def _resume(self, cloud: msg.PointCloud2) -> None:
        """The cloud of the last pose places the first scan; without it the distance that the robot coasted is lost."""
        before = self._before
        if before is None or (stamp := stamp_of(before)) != stamp_of(cloud):
            return
        at, twist, pose = before.pose.pose, before.twist.twist, np.eye(4)
        pose[:3, :3], pose[:3, 3] = checked_pose(xyz(at.position), xyzw(at.orientation))
        points = np.ascontiguousarray(cloud_points(cloud), np.float32)
        speed, rate = math.dist(xyz(twist.linear), (0.0, 0.0, 0.0)), abs(twist.angular.z)
        self._odometry.resume(Before(pose, points, stamp, speed, rate))
        self._before = None

    def _continue_from(self, before: msg.Pose, scan: ScanOdometry) -> None:
        """Both are gravity-aligned, so a heading and a translation make the first pose the last one of before."""
        q = quaternion(scan.orientation)
        self._shift.yaw = wrap(yaw_of(before.orientation) - yaw_of(q))
        x, y, _ = self._shift.pose2(scan.position[0], scan.position[1], 0.0)
        place = before.position
        self._shift.x, self._shift.y = place.x - x, place.y - y
        self._shift.z = place.z - scan.position[2]

    def tick(self, now: int) -> Outputs:
        """The frames and the robot's description, once."""
        if self._announced:
            return []
        self._announced = True
        return [(t.TF_STATIC, self._frames(now)), (t.DESCRIPTION, msg.String(data=self._description))]

    def _frames(self, now: int) -> msg.TFMessage:
        x, y, yaw = self._start
        return msg.TFMessage(
            transforms=[
                transform_msg(now, MAP, ODOM, (x, y, 0.0), rpy_quaternion((0.0, 0.0, yaw))),
                *(_mount_msg(now, LIDAR + lidar.name, lidar.mount) for lidar in self._lidars),
                _mount_msg(now, IMU, self._imu),
                *(_optical_msg(now, camera) for camera in self._cameras),
            ]
        )

    def _place(self, message: msg.PoseWithCovarianceStamped) -> Outputs:
        """An operator tells the robot's pose in `map`. Ignored while it moves: the told place is old when it
        arrives."""
        place, odom = message.pose.pose.position, self._odom
        told = place.x, place.y, yaw_of(message.pose.pose.orientation)
        if odom is None or message.header.frame_id not in ("", MAP) or not _possible(told):
            return []
        return self._take_offset(*offset_of(told, odom))

    def _take_offset(self, x: float, y: float, turn: float) -> Outputs:
        """`odom` lies at x, y [m], turned by `turn` [rad] in `map`. Refused while the robot moves: its driver would
        lose the way."""
        odom = self._odom
        if odom is None or not _possible((x, y, turn)) or not stands(odom):
            return []
        if not near((x, y, turn), self._start, (SAME_POSE, SAME_POSE)):
            self._told = self._place_sigma
            self._start = (x, y, turn)  # otherwise a repeat: the frames stay, and are told again
        return [(t.TF_STATIC, self._frames(stamp_of(odom)))]

    def _glide(self, odom: msg.Odometry, before: msg.Odometry | None) -> Outputs:
        """`odom` on its way to where the closed map has it: slowly while the robot drives, at once where it stands.
        before: the pose of the scan before."""
        now, here = stamp_of(odom), odom.pose.pose
        self._stood = (self._stood or now) if stands(odom) else 0
        if self._target is None or before is None:
            return []
        if self._stood and now - self._stood >= STANDS_FOR:
            self._start = self._target
        else:
            seconds = min(max(now - stamp_of(before), 0) / NS, LONGEST_GLIDE)
            place = here.position.x, here.position.y, yaw_of(here.orientation)
            self._start = glide(self._start, self._target, place, seconds)
        self._told = self._place_sigma
        return [(t.TF_STATIC, self._frames(now))]

    def _fast(self, fast: FastPose) -> Outputs:
        if self._before is not None:
            return []
        self._poses += 1
        position, orientation = self._shift.pose3(fast.position, fast.orientation)
        pose = odometry_msg(fast.stamp, position, orientation, fast.linear, fast.angular, fast.covariance)
        outputs: Outputs = [(t.POSE, pose)]
        if self._poses % TF_EVERY == 0:
            transform = transform_msg(fast.stamp, ODOM, BASE, position, orientation)
            outputs.append((t.TF, msg.TFMessage(transforms=[transform])))
        return outputs

    @staticmethod
    def _wheel(wheel: WheelOdometry) -> msg.Odometry:
        return odometry_msg(wheel.stamp, wheel.position, wheel.orientation, wheel.linear, wheel.angular)

    def _scan(self, scan: ScanOdometry) -> Outputs:
        position, orientation = self._shift.pose3(scan.position, scan.orientation)
        odom = odometry_msg(scan.stamp, position, orientation, scan.linear, scan.angular, scan.covariance)
        counters = {**self._odometry.counters, "malformed": self._malformed}
        health = msg.OdometryHealth(
            header=header(scan.stamp, ODOM),
            health=str(scan.health),
            reason=scan.reason,
            overlap=float(scan.overlap),
            inliers=float(scan.inliers),
            residual=float(scan.residual),
            correction=float(scan.correction),
            place_sigma=math.sqrt(max(scan.place_sigma**2 - self._told**2, 0.0)),
            degenerate=np.ascontiguousarray(scan.degenerate, np.float64),
            degeneracy=float(scan.degeneracy),
            lidar=[lidar.name for lidar in scan.lidars],
            time_offset=array([lidar.offset for lidar in scan.lidars], "float64"),
            time_offset_sigma=array([lidar.offset_sigma for lidar in scan.lidars], "float64"),
            time_applied=array([lidar.applied for lidar in scan.lidars], "float64"),
            calibration=scan.fault,
            counter=list(counters),
            count=array(list(counters.values()), "uint32"),
        )
        before, self._odom, self._place_sigma = self._odom, odom, scan.place_sigma
        outputs: Outputs = [(t.ODOM_HEALTH, health), (t.ODOM, odom), *self._glide(odom, before)]
        if not isinstance(self._odometry, LidarInertialOdometry):  # no pose in between: tf has this one
            transform = transform_msg(scan.stamp, ODOM, BASE, position, orientation)
            outputs.append((t.TF, msg.TFMessage(transforms=[transform])))
        if scan.health != "lost":  # a scan that fits nowhere must not reach the map
            for name in self._sweeps.values():  # an empty one says that nothing came
                cloud = scan.clouds.get(name, NO_POINTS)
                outputs.append((t.CLOUDS[name], cloud_msg(scan.stamp, BASE, cloud)))
        return outputs


def _possible(place: Planar) -> bool:
    """Whether something can lie there."""
    return all(map(math.isfinite, place)) and max(map(abs, place[:2])) < FARTHEST_PLACE


def _mount_msg(now: int, frame: str, mount: Extrinsics) -> Any:
    return transform_msg(now, BASE, frame, mount.translation, rpy_quaternion(mount.rpy))


def _optical_msg(now: int, camera: MountedCamera) -> Any:
    """The optical frame: z along the view, y down (REP 103)."""
    turned = from_matrix(camera.rotation)
    return transform_msg(now, BASE, CAMERA + camera.name, camera.mount.translation, turned)


def build(config: StackConfig) -> OdometryStage:
    """From the stack's configuration."""
    lidars = config.mounted_lidars()
    kind = ALONE.get(config.odometry.without, LidarInertialOdometry)
    size = config.facts.body.length, config.facts.body.width
    odometry = kind(config.odometry, {lidar.name: lidar.mount for lidar in lidars}, config.own_parts, size)
    camera = config.camera.mounted()
    return OdometryStage(
        odometry,
        lidars,
        config.facts.imu,
        config.start_pose(),
        () if camera is None else (camera,),
        urdf(config.facts),
    )
