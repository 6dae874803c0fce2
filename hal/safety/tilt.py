"""How far the trunk is tipped, from the IMU alone: independent of odometry, so the safety gate can trust it."""

from __future__ import annotations

import math

import numpy as np

from hal.types import NS, Array, ImuSample


class TiltFilter:
    """Complementary filter of the gravity direction: the gyro turns it, the accelerometer pulls it back slowly."""

    def __init__(self, time_constant: float = 2.0) -> None:
        """time_constant [s]: longer rejects driving accelerations better, shorter forgets gyro bias faster."""
        self.time_constant = time_constant
        self._up: Array | None = None
        self._stamp = 0

    def update(self, sample: ImuSample) -> float | None:
        """Angle between trunk z and gravity [rad] after this sample; None before the first usable one."""
        norm = float(np.linalg.norm(sample.accel))
        if not (math.isfinite(norm) and np.isfinite(sample.gyro).all()):
            return self.tilt
        if self._up is None:
            if norm > 1.0:
                self._up, self._stamp = sample.accel / norm, sample.stamp
            return self.tilt
        dt = min(max((sample.stamp - self._stamp) / NS, 0.0), 0.1)
        self._stamp = sample.stamp
        up = self._up - dt * np.cross(sample.gyro, self._up)  # a fixed direction seen from a turning body
        # Far from 1 g the accelerometer measures shocks or free fall, not gravity.
        if 0.5 * 9.81 < norm < 1.5 * 9.81:
            up = up + dt / self.time_constant * (sample.accel / norm - up)
        self._up = up / np.linalg.norm(up)
        return self.tilt

    @property
    def tilt(self) -> float | None:
        """[rad] in [0, pi]; None before the first sample."""
        return None if self._up is None else math.acos(max(-1.0, min(1.0, float(self._up[2]))))
