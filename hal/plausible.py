"""Whether a sample of a sensor is possible: its range, and size and side of gravity in an IMU. One judge for backend
and odometry."""

from __future__ import annotations

import math

import numpy as np

from hal.limbs import MOTORS
from hal.safety.monitors import (
    ACCELERATION,
    GRAVITY_SIDE,
    GRAVITY_SIZE,
    JOINT_ANGLE,
    JOINT_SPEED,
    JOINT_TORQUE,
    MOTOR_LOST,
    TURN_RATE,
    UPRIGHT,
)
from hal.types import GRAVITY, NS, Array

_SMOOTH_TIME = 0.5
"""[s] over which a specific force is averaged: a shock is over, a wrong unit stays."""
_SHOCK_FORCE = 2.0 * GRAVITY
"""[m/s^2] A larger force counts as one of this size: one blow outweighs no half second, a wrong unit does."""
_TUMBLE_RATE = 2.0
"""[rad/s] No robot turns so fast on its feet. A robot that was thrown over flies for more than half a second and
feels no gravity then."""
_TRUST_TIME = 5.0
"""[s] Time constant that draws the gyro's direction to the measured one: a bias of 1 deg/s puts it off by 5 deg."""
_LONGEST_GAP = NS // 5
"""[ns] without a sample after which the gyro tells nothing of the direction."""
WHEELS = np.arange(16) >= 12
"""(16,) of the motors."""


class ImuCheck:
    """Judges the samples of one IMU, in base_link.

    Gravity is always there. Averaged over half a second and rotated by the gyro, the specific force is near 9.8 m/s^2
    and where the gyro predicts. A robot that falls turns both; reversed signs or another unit turn one. At the start
    nothing tells the two apart, so the robot must be on its feet or its belly."""

    def __init__(self, stream: str) -> None:
        """`stream`: as operators call it."""
        self._stream = stream
        self._stamp: int | None = None
        self._mean = self._up = (0.0, 0.0, 0.0)
        """Specific force [m/s^2] and the direction up, by gyro and by what was believed."""
        self._stood = False
        self._spin = 0.0
        """Mean turn rate [rad/s]."""

    def impossible(self, gyro: Array, accel: Array) -> str:
        """Name the value of a sample, (3,) [rad/s] and (3,) [m/s^2], that no such sensor can measure; empty if all
        are possible."""
        for row, values in ((ACCELERATION, accel), (TURN_RATE, gyro)):
            for value in values.tolist():
                if row.outside(value):
                    return row.tell(stream=self._stream, value=value)
        return ""

    def contradicted(self, stamp: int, gyro: Array, accel: Array) -> str:
        """Why gravity contradicts a possible sample at `stamp` [ns]; empty if it does not. Call it for each sample,
        in order."""
        # Plain floats: at the rate of an IMU, numpy on three numbers costs more than all the rest.
        x, y, z = accel.tolist()
        share = min(1.0, _SHOCK_FORCE / (math.hypot(x, y, z) or 1.0))
        a = share * x, share * y, share * z
        wx, wy, wz = gyro.tolist()
        dt = 0.0 if self._stamp is None else stamp - self._stamp
        if self._stamp is None or not 0 <= dt <= _LONGEST_GAP:
            self._stamp, self._mean, dt = stamp, a, 0.0
            self._up = _unit(a)
        self._stamp, dt = stamp, dt / NS

        def turned(v: tuple[float, float, float]) -> tuple[float, float, float]:
            x, y, z = v
            return x - dt * (wy * z - wz * y), y - dt * (wz * x - wx * z), z - dt * (wx * y - wy * x)

        self._mean = _toward(turned(self._mean), a, dt / (_SMOOTH_TIME + dt))
        self._spin += dt / (_SMOOTH_TIME + dt) * (math.hypot(wx, wy, wz) - self._spin)
        self._up = turned(self._up)
        reason = self._gravity()
        if not reason:
            self._up = _unit(_toward(self._up, _unit(self._mean), dt / _TRUST_TIME))
        return reason

    def _gravity(self) -> str:
        size = math.hypot(*self._mean)
        if GRAVITY_SIZE.outside(size) and self._spin < _TUMBLE_RATE:
            return GRAVITY_SIZE.tell(stream=self._stream, value=size)
        direction = _unit(self._mean)
        if not self._stood:
            self._up = direction
            if UPRIGHT.outside(tilt := _between(direction, (0.0, 0.0, 1.0))):
                return UPRIGHT.tell(stream=self._stream, value=tilt)
        self._stood = True
        if GRAVITY_SIDE.outside(off := _between(direction, self._up)):
            return GRAVITY_SIDE.tell(stream=self._stream, value=off)
        return ""


def _toward(v: tuple[float, ...], to: tuple[float, ...], share: float) -> tuple[float, float, float]:
    x, y, z = (a + share * (b - a) for a, b in zip(v, to, strict=True))
    return x, y, z


def _unit(v: tuple[float, ...]) -> tuple[float, float, float]:
    norm = math.hypot(*v) or 1.0
    x, y, z = (a / norm for a in v)
    return x, y, z


def _between(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """[deg]"""
    return math.degrees(
        math.acos(
            max(-1.0, min(1.0, sum(p * q for p, q in zip(a, b, strict=True)) / (math.hypot(*b) or 1.0)))
        )
    )


def impossible_joints(position: Array, velocity: Array, effort: Array) -> str:
    """Which motor, of (16,) [rad], [rad/s], [Nm] in SDK order, tells what it cannot; empty where none does."""
    angle = np.where(WHEELS & np.isfinite(position), 0.0, position)  # wheels turn on and on
    for row, values in ((JOINT_SPEED, velocity), (JOINT_ANGLE, angle), (JOINT_TORQUE, effort)):
        worst = int(np.argmax(np.where(np.isfinite(values), np.abs(values), np.inf)))
        if row.outside(float(values[worst])):
            return row.tell(motor=MOTORS[worst], value=float(values[worst]))
    return ""


def lost_motor(lost: Array, bits: Array) -> str:
    """The motor that lost most messages, of (16,) counts and error bits in SDK order; empty where none lost many."""
    worst = int(np.argmax(lost))
    if MOTOR_LOST.outside(float(lost[worst])):
        return MOTOR_LOST.tell(motor=MOTORS[worst], value=int(lost[worst]), bits=int(bits[worst]))
    return ""
