"""Inertial dead reckoning: an error-state Kalman filter on gyro, accelerometer, wheel velocity and scan poses.

State x (16,): position of the IMU in `odom` [m], its velocity in `odom` [m/s], orientation x, y, z, w of `odom` <-
`base_link`, gyro bias [rad/s], accelerometer bias [m/s^2]. Error state (15,): position, velocity (both `odom`),
rotation (`base_link`), gyro bias, accelerometer bias. The filter follows the IMU instead of base_link, so that
neither the gyro has to be differentiated nor a lever arm enters the propagation. Solà, "Quaternion kinematics for the
error-state Kalman filter", 2017."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from hal.limbs import Limbs
from hal.robots import describe
from hal.rotation import rotation, rotation_vector, skew, turn, wrap
from hal.types import GRAVITY, Array
from mapping.odometry.inertial_kernels import correct, output, run, settle

AT_REST, MOVING_TILT = 0.1, 3.0
"""Tilt error of the accelerometer at the start beside that of its bias, one standard deviation [deg]. Of 24 simulated
starts, whose trunk still sways a little, 0.07 about each axis."""

AT_STANDSTILL = 0.01
"""Velocity of a body that stands, one standard deviation [m/s]."""
STILL_RATE = 0.003
"""Mean turn rate of a sweep beside the bias while the robot stands, one standard deviation [rad/s]: noise and the
rest of a sway."""


class InertialConfig(BaseModel):
    """Noise of the inertial and wheel measurements, as seen by the filter (vibration and slip included)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    gyro_noise: float = Field(default=0.0010, gt=0, description="white noise density [rad/s/sqrt(Hz)]")
    accel_noise: float = Field(default=0.03, gt=0, description="white noise density [m/s^2/sqrt(Hz)]")
    gyro_bias_walk: float = Field(default=2e-5, gt=0, description="bias random walk [rad/s^2/sqrt(Hz)]")
    accel_bias_walk: float = Field(default=5e-4, gt=0, description="bias random walk [m/s^3/sqrt(Hz)]")
    gyro_bias: float = Field(default=0.01, gt=0, description="initial standard deviation [rad/s]")
    accel_bias: float = Field(default=0.05, gt=0, description="initial standard deviation [m/s^2]")
    wheel_noise: tuple[float, float, float] = Field(
        default=(0.1, 0.1, 0.05),
        description="wheel velocity, white part per 50 Hz sample, body x, y, z [m/s]",
    )
    imu_position: tuple[float, float, float] = Field(
        default_factory=lambda: describe().imu.translation, description="IMU in base_link [m]"
    )
    limbs: Limbs = Field(
        default_factory=lambda: describe().limbs,
        exclude=True,
        description="the robot's own; set there, not here",
    )


@dataclass(frozen=True, slots=True, eq=False)
class BaseState:
    """base_link in `odom`."""

    position: Array
    """(3,) [m]"""
    orientation: Array
    """(4,) x, y, z, w."""
    linear: Array
    """(3,) [m/s], base_link."""
    angular: Array
    """(3,) [rad/s], base_link."""
    covariance: Array
    """(6, 6) position, rotation about the axes of `odom`."""


class InertialFilter:
    """The state at `stamp`, advanced by samples and corrected by scan poses."""

    WHEEL_GATE = 5.0
    """Wheel velocities further off [standard deviations] are refused."""

    def __init__(self, params: InertialConfig) -> None:
        self.params = params
        self.stamp = 0
        self.x = np.zeros(16)
        self.x[9] = 1.0
        self.p = np.eye(15)
        self.u = np.zeros(6)
        self.lever, self.limbs = np.array(params.imu_position), params.limbs
        self._noise = np.array(
            [params.gyro_noise, params.accel_noise, params.gyro_bias_walk, params.accel_bias_walk]
        )

    def start(self, stamp: int, imu: Array, level: bool, velocity: Array | None, height: float) -> None:
        """Begin at the origin, heading 0, gravity-aligned.

        `imu` (n, 6): samples up to `stamp`; `level`: they were taken at rest, so their means give tilt and gyro bias;
        `velocity` (3,) of the body [m/s] if the wheels tell; `height`: base_link above z = 0 [m]."""
        s = self.params
        self.stamp = stamp
        self.x[:] = 0.0
        self.x[9] = 1.0
        self.u[:] = imu[-1] if len(imu) else (0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY)
        if len(imu):
            mean = imu.mean(axis=0)
            roll = math.atan2(mean[4], mean[5])
            pitch = math.atan2(-mean[3], math.hypot(mean[4], mean[5]))
            turn(self.x[6:10], 0.0, pitch, 0.0)
            turn(self.x[6:10], roll, 0.0, 0.0)
            if level:
                self.x[10:13] = mean[:3]
        rot = rotation(self.x[6:10])
        self.x[:3] = rot @ self.lever + (0.0, 0.0, height)
        moving = velocity is None and not level
        if velocity is not None:
            self.x[3:6] = rot @ velocity
        tilt = math.radians(AT_REST if level else MOVING_TILT)
        sigma = np.concatenate(
            [
                [1e-3] * 3,
                [1.0 if moving else 0.1] * 3,
                [tilt, tilt, 1e-3],
                [s.gyro_bias * (0.5 if level else 1.0)] * 3,
                [s.accel_bias] * 3,
            ]
        )
        self.p = np.diag(sigma**2)
        # A bias of the accelerometer is in the tilt that it told: what parts the two later corrects both.
        lean = skew(rot[2]) / GRAVITY
        self.p[6:9, 12:15] = s.accel_bias**2 * lean
        self.p[12:15, 6:9] = self.p[6:9, 12:15].T
        self.p[6:9, 6:9] += s.accel_bias**2 * lean @ lean.T

    def advance(
        self,
        end: int,
        imu_stamp: NDArray[np.int64],
        imu: Array,
        wheel_stamp: NDArray[np.int64],
        wheel: Array,
        wheel_sigma: Array,
    ) -> tuple[NDArray[np.int64], Array]:
        """Propagate to `end` [ns]; see `run`. Returns the track: stamps (k,) and IMU poses (k, 10) from the old to
        the new stamp."""
        rows = len(imu_stamp) + 2
        stamps, track = np.empty(rows, np.int64), np.empty((rows, 10))
        rows = run(
            self.x, self.p, self.u, self.stamp, end,
            imu_stamp, imu, wheel_stamp, wheel, wheel_sigma,
            self._noise, self.WHEEL_GATE, stamps, track,
        )  # fmt: skip
        self.stamp = max(end, self.stamp)
        return stamps[:rows], track[:rows]

    def update_pose(self, pose: Array, covariance: Array) -> None:
        """Correct with a measured base_link pose (4, 4) in `odom`. covariance (6, 6): position in `odom` [m],
        rotation in base_link [rad]."""
        rot = rotation(self.x[6:10])
        residual = np.concatenate(
            [pose[:3, 3] + pose[:3, :3] @ self.lever - self.x[:3], rotation_vector(rot.T @ pose[:3, :3])]
        )
        rows = [0, 1, 2, 6, 7, 8]
        # The measured position belongs to base_link; through the lever arm its rotation error moves the IMU.
        lever = np.eye(6)
        lever[:3, 3:] = -pose[:3, :3] @ skew(self.lever)
        r = lever @ covariance @ lever.T
        gain = np.linalg.solve(self.p[np.ix_(rows, rows)] + r, self.p[rows]).T
        correct(self.x, gain @ residual)
        a = np.eye(15)
        a[:, rows] -= gain
        self.p = a @ self.p @ a.T + gain @ r @ gain.T
        self.p = 0.5 * (self.p + self.p.T)

    def hold(self, x: Array, variance: Array, rate: float) -> None:
        """The body stood since the state `x` (16,), whose x, y and heading had the `variance` (3,). These are kept;
        only the trunk may have swayed. The mean `rate` of the gyro about z [rad/s] is bias; gravity tells the biases
        about x and y."""
        self.x[:2] = x[:2]
        then, now = rotation(x[6:10]), rotation(self.x[6:10])
        about_z(self.x[6:10], math.atan2(then[1, 0], then[0, 0]) - math.atan2(now[1, 0], now[0, 0]))
        over_ground = [0, 1, 8]
        kept = np.ones(15)
        kept[over_ground] = np.sqrt(variance / np.diag(self.p)[over_ground]).clip(max=1.0)
        self.p = kept[:, None] * self.p * kept
        rows = [3, 4, 5, 11]
        r = np.diag([AT_STANDSTILL**2] * 3 + [STILL_RATE**2])
        gain = np.linalg.solve(self.p[np.ix_(rows, rows)] + r, self.p[rows]).T
        correct(self.x, gain @ np.append(-self.x[3:6], rate - self.x[12]))
        self.p -= gain @ self.p[rows]
        self.p = 0.5 * (self.p + self.p.T)

    def creep(self, pose: Array, most: float) -> None:
        """Turn the heading of a body that stands towards that of a measured `pose` (4, 4), by `most` [rad] at most."""
        now = rotation(self.x[6:10])
        off = math.atan2(pose[1, 0], pose[0, 0]) - math.atan2(now[1, 0], now[0, 0])
        about_z(self.x[6:10], min(max(wrap(off), -most), most))

    def refuse(self, x: Array) -> None:
        """What was integrated since the state `x` (16,) is impossible. The body is taken to be where it was then, at
        rest, with room for what it may have moved. Its attitude is that of the gyro."""
        self.x[:6], self.x[10:] = x[:6], x[10:]
        settle(self.x, self.p)

    def misplaced(self, moved: float, turned: float) -> None:
        """The body was put elsewhere, about `moved` [m] and `turned` [rad] from here; how fast it is stays known."""
        self.p[:3, :3] += moved**2 * np.eye(3)
        self.p[6:9, 6:9] += turned**2 * np.eye(3)

    def pose(self) -> Array:
        """(4, 4) `odom` <- base_link."""
        out = np.eye(4)
        out[:3, :3] = rotation(self.x[6:10])
        out[:3, 3] = self.x[:3] - out[:3, :3] @ self.lever
        return out

    def output(self, offset: Array) -> BaseState:
        """State of base_link, shifted by `offset` (6,): position in `odom` [m], rotation in base_link [rad]."""
        flat, covariance = np.empty(13), np.empty((6, 6))
        output(self.x, self.p, self.u, self.lever, offset, flat, covariance)
        return BaseState(flat[:3], flat[3:7], flat[7:10], flat[10:], covariance)

    def at_imu(self, linear: Array, angular: Array) -> Array:
        """Velocity (3,) of the IMU point from that of base_link, base_link axes [m/s]."""
        (wx, wy, wz), (x, y, z) = angular, self.lever
        return linear + np.array([wy * z - wz * y, wz * x - wx * z, wx * y - wy * x])

    def move_clock(self, stamp: int) -> None:
        """The source clock was set: the pose stays, the time in between is unknown."""
        self.stamp = stamp
        settle(self.x, self.p)

    def copy_from(self, other: InertialFilter) -> None:
        """Take over the state of another filter."""
        self.stamp, self.x, self.p, self.u = other.stamp, other.x.copy(), other.p.copy(), other.u.copy()


def about_z(q: Array, yaw: float) -> None:
    """Turn the orientation `q` (4,) x, y, z, w in place by `yaw` [rad] about the z axis of the world."""
    c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    x, y, z, w = q
    q[:] = c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z
