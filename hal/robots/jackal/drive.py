"""Velocity straight to the wheels of a robot that cannot move them otherwise (`hal.lowlevel.Locomotion`).

Skid steering slips, so how fast the wheels must turn against each other for a yaw rate depends on the ground: the
gyro closes that loop. At rest the wheels hold their place."""

from __future__ import annotations

import numpy as np

from hal.limbs import MOTORS, SIGN_Y, WHEEL_JOINTS, Limbs
from hal.lowlevel import LowCommand, LowState
from hal.types import PostureCommand, VelocityCommand

SPEED_SLEW, TURN_SLEW = 2.0, 6.0
"""Of the commanded speed [m/s^2] and yaw rate [rad/s^2]."""
YAW_KP, YAW_KI, YAW_MOST = 1.0, 6.0, 4.0
"""Of the loop on the gyro: share of the error, the same for each second [1/s], and what it adds at most [rad/s]."""
WHEEL_KD = 2.5
"""[Nm s/rad]"""
HOLD_KP = 60.0
"""[Nm/rad] of a wheel that holds its place."""
REST_SPEED = 0.05
"""[rad/s] of the wheels from which they hold it."""


class Drive:
    """Speed and yaw rate in, wheel speeds out. `vy`, `climb` and the posture are not followed: the robot has no means
    for them."""

    def __init__(self, limbs: Limbs, period: float = 0.005) -> None:
        """`period`: control period [s]."""
        self.period = period
        self._limbs = limbs
        zero = (np.zeros(len(MOTORS)) for _ in range(5))
        self._out = LowCommand(*zero)
        self.reset()

    def reset(self) -> None:
        """Forget all state."""
        self._vx = self._wz = self._slip = 0.0
        self._held: np.ndarray | None = None

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        """One control tick."""
        dt, out = self.period, self._out
        self._vx += float(np.clip(velocity.vx - self._vx, -SPEED_SLEW * dt, SPEED_SLEW * dt))
        self._wz += float(np.clip(velocity.wz - self._wz, -TURN_SLEW * dt, TURN_SLEW * dt))
        out.kd[WHEEL_JOINTS] = WHEEL_KD
        if self._vx == 0.0 and self._wz == 0.0:
            self._slip = 0.0
            if self._held is None and np.abs(state.dq[WHEEL_JOINTS]).max() < REST_SPEED:
                self._held = state.q[WHEEL_JOINTS].copy()
            out.dq[WHEEL_JOINTS] = 0.0
            out.kp[WHEEL_JOINTS] = 0.0 if self._held is None else HOLD_KP
            out.q[WHEEL_JOINTS] = state.q[WHEEL_JOINTS] if self._held is None else self._held
            return out
        self._held = None
        error = self._wz - float(state.gyro[2])
        self._slip = float(np.clip(self._slip + YAW_KI * error * dt, -YAW_MOST, YAW_MOST))
        turn = self._wz + YAW_KP * error + self._slip
        out.kp[WHEEL_JOINTS] = 0.0
        out.dq[WHEEL_JOINTS] = (self._vx - SIGN_Y * turn * self._limbs.tread) / self._limbs.radius
        return out

    def warning(self) -> str:
        """It does what it is told."""
        return ""
