"""The attitude of the robot's IMU: gyro and accelerometer, no magnetometer. Driving and impacts tilt it, the heading
drifts."""

from __future__ import annotations

import math

import numpy as np

from hal.lowlevel import LowState
from hal.rotation import up_of
from hal.types import GRAVITY, Array

FILTER_GAIN = 0.2
"""Pull of the accelerometer [1/s]: an attitude error fades with a time constant of 1/FILTER_GAIN. That of a Go2-W's
IMU is not public; inertial units of its class have some seconds."""
LONGEST_STEP = 0.05
"""A step between two samples counts as at most this [s]."""
SETTLED_TIME = 5.0 / FILTER_GAIN
"""The filter has run for this long [s] at rest before its first sample."""


class AttitudeFilter:
    """Mahony's complementary filter (IEEE TAC 53(5), 2008, eq. 48) without its estimate of the gyro's bias.

    The gyro turns the attitude, and the measured specific force pulls its vertical at the rate FILTER_GAIN. As in
    Mahony's implementation every sample counts by its direction alone, however large it is. A speed that changes by 2
    m/s^2 for 0.3 s tilts the attitude by 0.7 deg; one sample of an impact by at most FILTER_GAIN times its duration,
    0.06 deg at 200 Hz. Nothing holds the heading, which begins at the true one."""

    def __init__(self, gyro_bias: Array | None = None, accel_bias: Array | None = None) -> None:
        """Constant errors of its input, (3,) [rad/s] and (3,) [m/s^2], to which it has settled at the start; None for
        none."""
        none = np.zeros(3)
        self._gyro = tuple((none if gyro_bias is None else gyro_bias).tolist())
        self._accel = (none if accel_bias is None else accel_bias).tolist()
        self._q = (1.0, 0.0, 0.0, 0.0)
        self._time: float | None = None

    def restart(self) -> None:
        """The robot was put elsewhere, which no gyro felt: the next state is a start again."""
        self._time = None

    def measure(self, state: LowState) -> None:
        """Replace the true attitude of `state` by the filter's, in place; its gyro and accelerometer already have
        their errors.

        The first state is the start: the filter has been on for a while, with the robot at rest as it is now."""
        if self._time is None:
            w, x, y, z = state.quaternion.tolist()
            self._q = (w, x, y, z)
            force = tuple(
                GRAVITY * up + e for up, e in zip(up_of(state.quaternion), self._accel, strict=True)
            )
            for _ in range(round(SETTLED_TIME / LONGEST_STEP)):
                self._turn(LONGEST_STEP, self._gyro, force)
            self._time = state.time
        dt = min(max(state.time - self._time, 0.0), LONGEST_STEP)
        self._time = state.time
        self._turn(dt, tuple(state.gyro.tolist()), tuple(state.accel.tolist()))
        state.quaternion[:] = self._q

    def _turn(self, dt: float, gyro: tuple[float, ...], accel: tuple[float, ...]) -> None:
        # Plain floats: numpy on three numbers costs more than all the rest.
        w, x, y, z = self._q
        gx, gy, gz = gyro
        ax, ay, az = accel
        length = math.sqrt(ax * ax + ay * ay + az * az)
        if length > 0.0:
            pull = FILTER_GAIN / length
            ux, uy, uz = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
            gx += pull * (ay * uz - az * uy)
            gy += pull * (az * ux - ax * uz)
            gz += pull * (ax * uy - ay * ux)
        gx, gy, gz = 0.5 * dt * gx, 0.5 * dt * gy, 0.5 * dt * gz
        w, x, y, z = (
            w - x * gx - y * gy - z * gz,
            x + w * gx + y * gz - z * gy,
            y + w * gy - x * gz + z * gx,
            z + w * gz + x * gy - y * gx,
        )
        length = math.sqrt(w * w + x * x + y * y + z * z)
        self._q = (w / length, x / length, y / length, z / length)
