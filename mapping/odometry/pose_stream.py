"""Poses between scans: the fast pose for control and the wheel-leg-inertial odometry.

Both answer at once with the samples that have arrived; the filter behind the scan poses never depends on them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hal.rotation import quaternion, rotation
from hal.types import Array
from mapping.odometry.health import Health, HealthMonitor
from mapping.odometry.inertial import InertialConfig, InertialFilter
from mapping.odometry.intake import SampleBuffer
from mapping.odometry.types import FastPose
from mapping.odometry.wheels import WheelOdometry, leg_velocity, velocities

NONE = np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3))


class PoseStream:
    """Two filters beside the one that the scans correct."""

    def __init__(
        self,
        params: InertialConfig,
        smoothing: float,
        imu: SampleBuffer,
        joints: SampleBuffer,
        monitor: HealthMonitor,
    ) -> None:
        """`smoothing` [s]: time constant with which scan corrections fade in. The buffers are the odometry's own."""
        self.fast = InertialFilter(params)
        self.dead = InertialFilter(params)
        self.scale = 1.0
        """Driven per rolled distance, as the scans taught."""
        self._smoothing = smoothing
        self._imu, self._joints, self._monitor = imu, joints, monitor
        self._noise = np.array(params.wheel_noise)
        self._offset = np.zeros(6)
        self._offset_stamp = 0
        self._wheel: tuple[NDArray[np.int64], Array, Array] = NONE

    def start(self, state: InertialFilter) -> None:
        """Begin with the state of the scan filter."""
        self.fast.copy_from(state)
        self.dead.copy_from(state)
        self._offset[:] = 0.0
        self._wheel = NONE

    def on_imu(self, stamp: int, row: Array, health: Health, reason: str) -> FastPose | None:
        """The pose at `stamp` [ns], given a new inertial row (6,); `health` of the newest scan. None for the past."""
        if stamp <= self.fast.stamp:
            return None
        self.fast.advance(stamp, np.array([stamp]), row[None, :], *self._wheel)
        self._wheel = NONE
        gap, limit = self._monitor.gap(stamp), self._monitor.params
        if gap > limit.gap_lost:
            health, reason = Health.LOST, f"no usable scan for {gap:.1f} s"
        elif gap > 2.0 * limit.gap_degraded and health is Health.GOOD:
            health, reason = Health.DEGRADED, f"no usable scan for {gap:.1f} s"
        s = self.fast.output(self._faded())
        return FastPose(stamp, s.position, s.orientation, s.linear, s.angular, s.covariance, health, reason)

    def on_joints(self, stamp: int, row: Array) -> WheelOdometry | None:
        """Wheel-leg-inertial odometry at `stamp` [ns], given a joint row (48,). None for the past."""
        if stamp <= self.dead.stamp:
            return None
        linear, sigma, contact = np.empty(3), np.empty(3), np.empty(4, np.bool_)
        imu_stamp, imu = self._imu.between(self.dead.stamp, stamp)
        newest = imu[-1] if len(imu) else self.dead.u
        angular = newest[:3] - self.dead.x[10:13]
        leg_velocity(
            self.dead.limbs, row[:16], row[16:32], row[32:], angular, self._noise, linear, sigma, contact
        )
        linear[0] *= self.scale
        at_imu = self.dead.at_imu(linear, angular)
        wheel = np.array([stamp]), at_imu[None, :], sigma[None, :]
        self.dead.advance(stamp, imu_stamp, imu, *wheel)
        self._wheel = wheel
        s = self.dead.output(np.zeros(6))
        touching = (bool(contact[0]), bool(contact[1]), bool(contact[2]), bool(contact[3]))
        return WheelOdometry(stamp, s.position, s.orientation, linear, angular, s.covariance, touching)

    def rejoin(self, state: InertialFilter) -> None:
        """Continue the fast pose from the corrected scan filter; the step becomes an offset that fades."""
        stamp = self.fast.stamp
        before = self.fast.output(self._faded())
        self.fast.copy_from(state)
        if stamp > state.stamp:
            imu_stamp, imu = self._imu.between(state.stamp, stamp)
            self.fast.advance(stamp, imu_stamp, imu, *self._velocities(state, imu_stamp, imu, stamp))
        after = self.fast.output(np.zeros(6))
        self._offset[:3] = before.position - after.position
        turned = rotation(after.orientation).T @ rotation(before.orientation)
        self._offset[3:] = 2.0 * quaternion(turned)[:3]
        self._offset_stamp = self.fast.stamp
        if not np.abs(self._offset).max() < 1.0:  # a new clock or a first pose: nothing to continue
            self._offset[:] = 0.0

    def move_clock(self, stamp: int) -> None:
        """The source clock was set to `stamp` [ns]."""
        self.fast.move_clock(stamp)
        self.dead.move_clock(stamp)
        self._offset_stamp = stamp
        self._wheel = NONE

    def _velocities(
        self, state: InertialFilter, imu_stamp: NDArray[np.int64], imu: Array, until: int
    ) -> tuple[NDArray[np.int64], Array, Array]:
        stamps, rows = self._joints.between(state.stamp, until)
        out, sigma, _ = velocities(
            state.limbs, stamps, rows, imu_stamp, imu, state.x[10:13], state.lever, self._noise, self.scale
        )
        return stamps, out, sigma

    def _faded(self) -> Array:
        age = max(self.fast.stamp - self._offset_stamp, 0) * 1e-9
        return math.exp(-age / self._smoothing) * self._offset
