"""Odometry for a log that lacks a sensor: LiDAR alone, or wheels and IMU alone. The health of every pose says what it
can do.

Both take what `mapping.odometry.pipeline` takes and return what it returns. Neither is `good`: without an IMU a quick
turn is found late, without a LiDAR the position drifts without bound."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.rotation import quaternion, rotation_vector
from hal.types import NS, Array, Extrinsics, ImuSample, JointSample, LidarName, LidarScan
from mapping.odometry.calibration import Calibration
from mapping.odometry.deskew import mount_matrix
from mapping.odometry.health import Health
from mapping.odometry.inbox import Inbox
from mapping.odometry.inertial import InertialFilter
from mapping.odometry.intake import Sweep, TopicClock, clean_scan
from mapping.odometry.own import OwnFilter, OwnPart
from mapping.odometry.registration.engines import MAP_VOXEL, quality
from mapping.odometry.registration.planes import VoxelPlanes
from mapping.odometry.registration.voxels import voxel_down_sample
from mapping.odometry.startup import START_WINDOW, Before, Startup, start
from mapping.odometry.types import OdometryConfig, ScanOdometry
from mapping.odometry.wheels import velocities

ALONE_RANGE, ALONE_VOXEL = 100.0, 0.5
"""Range and voxels of KISS-ICP [m]. Where nothing tells the motion, far walls hold what rings on level ground do not.
Ten scans of a car at 7 m/s (OS0-8): 0.74 m a scan with these, 0.3 m with points up to 20 m."""
FITTING_SHARE = 0.7
"""Share of the points on known planes that lie on them, below which a scan fits nowhere."""
POSITION_SIGMA, ROTATION_SIGMA = 0.05, math.radians(1.0)
"""Of a pose of KISS-ICP relative to its map: a tenth of its voxels."""
REPORT_PERIOD = NS // 10
"""[ns] between two poses of wheels and IMU."""


class LidarAlone:
    """KISS-ICP as its package runs it: the motion of the last scan predicts the next one and deskews it. Vizzo et
    al., RA-L 2023."""

    words = "LiDAR alone: no IMU"

    def __init__(
        self,
        params: OdometryConfig,
        mounts: Mapping[LidarName, Extrinsics],
        own: Sequence[OwnPart] = (),
        size: tuple[float, float] | None = None,
    ) -> None:
        """`mounts`: each LiDAR in base_link; only the main one is registered. `own`: parts of the robot beside its
        body, whose `size` is length and width [m]."""
        self._own = OwnFilter(own, mounts, size)
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        config = KISSConfig()
        config.data.max_range = ALONE_RANGE
        config.data.min_range = 0.0
        config.mapping.voxel_size = ALONE_VOXEL
        config.registration.max_num_threads = 1  # two threads do not give the same bytes twice
        self._kiss = KissICP(config)
        self._params = params
        self.counters: Counter[str] = Counter()
        self.calibration = Calibration(mounts, params.max_time_offset)
        self._mount = mount_matrix(mounts["main"])
        self._planes = VoxelPlanes(MAP_VOXEL, params.max_range)
        self._clock = TopicClock("scan", 2, self.counters)
        self._sweeps: deque[Sweep] = deque()
        self._last = 0

    def add_imu(self, _sample: ImuSample) -> None:
        """Not used."""

    def add_joints(self, _sample: JointSample) -> None:
        """Not used."""

    def add_scan(self, scan: LidarScan) -> None:
        """Take a scan; `poll` processes it."""
        admitted = self._clock.admit(scan.stamp) if scan.name == "main" else "drop"
        if admitted == "jump":
            self._sweeps.clear()
            self._last = 0
        if admitted != "drop":
            p = self._params
            sweep = clean_scan(scan, p.min_range, ALONE_RANGE, p.max_points, self.counters)
            self._sweeps.extend([self._own.take_out(sweep, self.counters)] if sweep is not None else [])

    def resume(self, _before: Before) -> None:
        """A log is not resumed: its first scan is the start."""

    def poll(self) -> list[ScanOdometry]:
        """Every scan that came since the last call."""
        out = []
        while self._sweeps:
            sweep = self._sweeps.popleft()
            if sweep.end <= self._last:
                self.counters["scan_backward"] += 1
            elif sweep.problem:
                self.counters["scan_unusable"] += 1
            else:
                out.append(self._register(sweep))
        return out

    def warm_up(self) -> None:
        """Compile the kernels."""
        quality(self._planes, np.zeros((1, 3)), np.eye(4))

    def _register(self, sweep: Sweep) -> ScanOdometry:
        points = sweep.xyz.astype(np.float64) @ self._mount[:3, :3].T + self._mount[:3, 3]
        before, self._last, since = self._kiss.last_pose, sweep.end, self._last
        cloud, _ = self._kiss.register_frame(points, np.empty(0) if sweep.untimed else sweep.time)
        pose, delta = self._kiss.last_pose, np.linalg.inv(before) @ self._kiss.last_pose
        near = np.linalg.norm(cloud, axis=1) <= self._params.max_range
        cloud = np.ascontiguousarray(cloud[near], np.float32)
        frame = voxel_down_sample(cloud, 0.5 * MAP_VOXEL)
        match = quality(self._planes, frame, np.ascontiguousarray(pose))
        place = POSITION_SIGMA**2 + match.born
        known = self._planes.empty or match.overlap >= self._params.health.overlap_lost
        fits = known and match.inliers >= FITTING_SHARE
        self._planes.insert(frame, match.pose, place)
        dt = (sweep.end - since) / NS if since else math.inf
        return ScanOdometry(
            stamp=sweep.end,
            position=pose[:3, 3].copy(),
            orientation=quaternion(pose[:3, :3]),
            linear=delta[:3, 3] / dt,
            angular=rotation_vector(delta[:3, :3]) / dt,
            covariance=np.diag([POSITION_SIGMA**2] * 3 + [ROTATION_SIGMA**2] * 3),
            health=Health.DEGRADED if fits else Health.LOST,
            reason=self.words
            if fits
            else f"{self.words}; {match.overlap:.0%} of the scan overlaps the map, {match.inliers:.0%} of that fits it",
            overlap=match.overlap,
            inliers=match.inliers,
            residual=match.residual,
            degenerate=np.array([0.0, 0.0, 1.0]),
            degeneracy=0.0,
            correction=0.0,
            clouds={"main": cloud} if fits else {},
            place_sigma=math.sqrt(place),
        )


class WheelsAlone:
    """Dead reckoning of wheels and IMU: `velocities` of the legs, or the speed that a robot on other wheels reports."""

    words = "wheels and IMU alone: no LiDAR, the place drifts"

    def __init__(
        self,
        params: OdometryConfig,
        mounts: Mapping[LidarName, Extrinsics],
        own: Sequence[OwnPart] = (),
        size: tuple[float, float] | None = None,
    ) -> None:
        """`mounts`, `own`, `size`: what every odometry is given; no sweep is looked at."""
        self._params = params.model_copy(update={"use_joints": True})
        self.counters: Counter[str] = Counter()
        self.calibration = Calibration(mounts, params.max_time_offset)
        self._inbox = Inbox(
            self._params,
            self.counters,
            self._follow_clock,
            dict.fromkeys(mounts, 0),
            OwnFilter(own, mounts, size),
        )
        self._filter = InertialFilter(params.inertial)
        self._noise = np.array(params.inertial.wheel_noise)
        self._lever = np.array(params.inertial.imu_position)
        self._speeds: deque[tuple[int, Array]] = deque()
        self._startup = Startup()
        self._began = False
        self._due = 0

    def add_imu(self, sample: ImuSample) -> None:
        """Take an inertial sample."""
        self._due = self._due or int(sample.stamp) + REPORT_PERIOD
        self._inbox.take_imu(sample)

    def add_joints(self, sample: JointSample) -> None:
        """Take a joint sample."""
        self._inbox.take_joints(sample)

    def add_speed(self, stamp: int, linear: Array) -> None:
        """Velocity (3,) of base_link [m/s] that the robot's own wheel odometry tells."""
        if np.isfinite(linear).all() and (not self._speeds or stamp > self._speeds[-1][0]):
            self._speeds.append((stamp, np.asarray(linear, np.float64)))

    def add_scan(self, _scan: LidarScan) -> None:
        """Not used."""

    def resume(self, _before: Before) -> None:
        """A log is not resumed."""

    def poll(self) -> list[ScanOdometry]:
        """The pose ten times a second, once wheels and IMU have passed it."""
        out: list[ScanOdometry] = []
        now = self._inbox.now
        while self._due and now >= self._due + self._params.patience * NS:
            if (pose := self._advance(self._due)) is not None:
                out.append(pose)
            self._due += REPORT_PERIOD
        return out

    def warm_up(self) -> None:
        """Nothing that would be late: a log waits."""

    def _advance(self, end: int) -> ScanOdometry | None:
        state, inbox = self._filter, self._inbox
        if not self._began:
            imu_stamp, imu = inbox.imu.between(end - START_WINDOW, end)
            if len(imu) < 5 or not self._startup.ready(end, imu_stamp, imu):
                return None
            joint_stamp, joints = inbox.joints.between(end - NS // 15, end)
            start(state, end, imu_stamp, imu, joint_stamp, joints, self._noise)
            self._began = True
            return None
        imu_stamp, imu = inbox.imu.between(state.stamp, end, beyond=1)
        wheel_stamp, wheel, sigma = self._wheels(end, imu_stamp, imu)
        state.advance(end, imu_stamp, imu, wheel_stamp, wheel, sigma)
        inbox.forget(end - NS)
        base = state.output(np.zeros(6))
        silent = [name for name, n in (("IMU", len(imu)), ("wheels", len(wheel))) if not n]
        return ScanOdometry(
            stamp=end,
            position=base.position,
            orientation=base.orientation,
            linear=base.linear,
            angular=base.angular,
            covariance=base.covariance,
            health=Health.LOST if silent else Health.DEGRADED,
            reason=f"{self.words}; nothing from {' and '.join(silent)}" if silent else self.words,
            overlap=0.0,
            inliers=0.0,
            residual=0.0,
            degenerate=np.array([0.0, 0.0, 1.0]),
            degeneracy=0.0,
            correction=0.0,
            clouds={},
            place_sigma=math.sqrt(float(np.linalg.eigvalsh(base.covariance[:2, :2])[-1])),
        )

    def _wheels(
        self, end: int, imu_stamp: NDArray[np.int64], imu: Array
    ) -> tuple[NDArray[np.int64], Array, Array]:
        """Stamps (m,), velocities (m, 3) of the IMU in base_link, standard deviations (m, 3)."""
        state = self._filter
        joint_stamp, joints = self._inbox.joints.between(state.stamp, end)
        if len(joints):
            wheel, sigma, _ = velocities(
                state.limbs,
                joint_stamp,
                joints,
                imu_stamp,
                imu,
                state.x[10:13],
                self._lever,
                self._noise,
                1.0,
            )
            return joint_stamp, wheel, sigma
        while self._speeds and self._speeds[0][0] <= state.stamp:
            self._speeds.popleft()
        taken = [pair for pair in self._speeds if pair[0] <= end]
        turning = state.output(np.zeros(6)).angular
        wheel = np.array([state.at_imu(linear, turning) for _, linear in taken]).reshape(-1, 3)
        return np.array([s for s, _ in taken], np.int64), wheel, np.tile(self._noise, (len(taken), 1))

    def _follow_clock(self, stamp: int) -> None:
        self._filter.move_clock(stamp)
        self._speeds.clear()
        self._due = stamp + REPORT_PERIOD


ALONE: dict[str, Any] = {"imu": LidarAlone, "lidar": WheelsAlone}
"""By the sensor that is not there (`odometry.without`)."""
