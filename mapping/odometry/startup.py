"""The first moment of the odometry: when the robot rests, its IMU and legs tell attitude, velocity and height."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.rotation import rotation, turn
from hal.types import NS, Array
from mapping.odometry.inertial import InertialFilter, about_z
from mapping.odometry.wheels import velocities

SETTLE_TIME = 0.5
"""The robot must have stood still for this long [s] before gravity is taken from its accelerometer,"""
PATIENCE_AT_START = 3.0
"""but a robot that does not stand still starts anyway after this long [s]."""
SWAY_RATE = 0.005
"""Change of the mean turn rate within the window that is no rest [rad/s]."""
START_WINDOW = NS * 7 // 10
"""Samples that are looked at [ns]."""
MOVED_SIGMA, TURNED_SIGMA = 0.3, 0.2
"""Distance and turn of a robot that nobody watched for long, one standard deviation [m, rad]."""
SWAY_SIGMA, COASTING_TIME, PUSH_SPEED = 0.02, 0.4, 0.05
"""For a moment alone it sways [m, rad], coasts for a while [s], and is pushed [m/s, rad/s]: without a pose the gate
holds
it. On open ground scans tell the place worse than that."""


@dataclass(frozen=True, slots=True, eq=False)
class Before:
    """Last known pose of the robot and its scan there: an odometry that is started again goes on from it."""

    pose: Array
    """(4, 4) `odom` <- base_link."""
    cloud: NDArray[np.float32]
    """(n, 3) base_link [m]."""
    stamp: int
    """Of the pose [ns]."""
    speed: float
    """[m/s] then,"""
    rate: float
    """and [rad/s]."""

    def moved(self, end: int) -> tuple[float, float]:
        """Distance and turn until `end` [ns], one standard deviation [m, rad]."""
        gone = (end - self.stamp) / NS
        if gone < 0.0:  # the clock was set
            return MOVED_SIGMA, TURNED_SIGMA
        alone = SWAY_SIGMA + PUSH_SPEED * gone
        return min(MOVED_SIGMA, alone + COASTING_TIME * self.speed), min(
            TURNED_SIGMA, alone + COASTING_TIME * self.rate
        )


class Startup:
    """Waits for rest; gives up waiting after `PATIENCE_AT_START`."""

    def __init__(self) -> None:
        self._first_scan = 0

    def ready(self, end: int, stamps: NDArray[np.int64], imu: Array) -> bool:
        """Whether to start at `end` [ns], given the inertial samples (n, 6) of the last `START_WINDOW`."""
        # A trunk that still sways shows a wrong gravity, and the local map would keep that tilt for good.
        self._first_scan = self._first_scan or end
        settled = resting(imu) and stamps[-1] - stamps[0] >= SETTLE_TIME * NS
        return not len(imu) or settled or end - self._first_scan >= PATIENCE_AT_START * NS


def start(
    state: InertialFilter,
    end: int,
    imu_stamp: NDArray[np.int64],
    imu: Array,
    joint_stamp: NDArray[np.int64],
    joints: Array,
    wheel_noise: Array,
) -> None:
    """Set the filter at `end` [ns] from inertial (n, 6) and joint samples (m, 48; none: z = 0 is base_link)."""
    level = resting(imu)
    velocity, height = None, 0.0
    if len(joints):
        v, _, h = velocities(
            state.limbs,
            joint_stamp[-1:],
            joints[-1:],
            imu_stamp,
            imu,
            np.zeros(3),
            state.lever,
            wheel_noise,
            1.0,
        )
        if math.isfinite(h[0]):
            velocity, height = v[0], float(h[0])
    state.start(end, _unrotated(imu_stamp, imu, end, level), level, velocity, height)


def put_at(state: InertialFilter, before: Before) -> None:
    """Move a filter that was just started to place and heading of `before`, with room for what the robot moved
    since."""
    pose, now = before.pose, state.pose()
    yaw = math.atan2(pose[1, 0], pose[0, 0]) - math.atan2(now[1, 0], now[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    heading = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    about_z(state.x[6:10], yaw)
    state.x[3:6] = heading @ state.x[3:6]
    state.x[:3] = pose[:3, 3] + rotation(state.x[6:10]) @ state.lever
    state.misplaced(*before.moved(state.stamp))


def resting(imu: Array) -> bool:
    """True when samples (n, 6) show neither rotation nor vibration: gyro bias and gravity only."""
    if len(imu) < 20:
        return False
    quiet = imu[:, :3].std(axis=0).max() < 0.03 and imu[:, 3:].std(axis=0).max() < 0.4
    # A bias stays what it is, the last of a sway fades: taken for a bias, 1 deg/s of it tilts the map by a degree.
    half = len(imu) // 2
    first, second = imu[:half, :3].mean(axis=0), imu[half:, :3].mean(axis=0)
    steady = np.abs(first - second).max() < SWAY_RATE
    return bool(quiet and steady and np.abs(imu[:, :3].mean(axis=0)).max() < 0.05)


def _unrotated(stamps: NDArray[np.int64], imu: Array, end: int, level: bool) -> Array:
    """Inertial samples (n, 6) rotated by the gyro into the axes of base_link at `end`, so that their mean shows
    gravity there."""
    if level or not len(imu):
        return imu
    out = imu.copy()
    q = np.array([0.0, 0.0, 0.0, 1.0])
    later = end
    for i in range(len(imu) - 1, -1, -1):
        dt = (later - int(stamps[i])) * 1e-9
        turn(q, *(-dt * imu[i, :3]))
        out[i, 3:] = rotation(q) @ imu[i, 3:]
        later = int(stamps[i])
    out[-1, :3] = imu[-1, :3]
    return out
