"""Tilt of the trunk from the IMU alone. It does not depend on odometry, so the safety gate can trust it."""

from __future__ import annotations

import math

from hal.types import NS, ImuSample


class TiltFilter:
    """Complementary filter of the gravity direction: the gyro turns it, the accelerometer pulls it back slowly."""

    def __init__(self, time_constant: float = 2.0) -> None:
        """time_constant [s]: longer rejects driving accelerations better, shorter forgets gyro bias faster."""
        self.time_constant = time_constant
        self._up: tuple[float, float, float] | None = None
        self._stamp = 0

    def update(self, sample: ImuSample) -> float | None:
        """Angle between trunk z and gravity [rad] after this sample; None before the first usable one."""
        # Plain floats: at the rate of the IMU, numpy on three numbers costs more than all the rest.
        ax, ay, az = sample.accel.tolist()
        wx, wy, wz = sample.gyro.tolist()
        norm = math.sqrt(ax * ax + ay * ay + az * az)
        if not math.isfinite(norm + wx + wy + wz):
            return self.tilt
        if self._up is None:
            if norm > 1.0:
                self._up, self._stamp = (ax / norm, ay / norm, az / norm), sample.stamp
            return self.tilt
        dt = min(max((sample.stamp - self._stamp) / NS, 0.0), 0.1)
        self._stamp = sample.stamp
        x, y, z = self._up
        # A fixed direction seen from a turning body: up - dt (gyro x up).
        x, y, z = (
            x - dt * (wy * z - wz * y),
            y - dt * (wz * x - wx * z),
            z - dt * (wx * y - wy * x),
        )
        # Far from 1 g the accelerometer measures shocks or free fall, not gravity.
        if 0.5 * 9.81 < norm < 1.5 * 9.81:
            pull = dt / self.time_constant
            x, y, z = x + pull * (ax / norm - x), y + pull * (ay / norm - y), z + pull * (az / norm - z)
        length = math.sqrt(x * x + y * y + z * z)
        self._up = (x / length, y / length, z / length)
        return self.tilt

    @property
    def tilt(self) -> float | None:
        """[rad] in [0, pi]; None before the first sample."""
        return None if self._up is None else math.acos(max(-1.0, min(1.0, self._up[2])))

    @property
    def lean(self) -> tuple[float, float]:
        """x and y of the upward direction in the trunk; 0 before the first sample."""
        return (0.0, 0.0) if self._up is None else self._up[:2]
