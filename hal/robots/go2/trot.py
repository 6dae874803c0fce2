"""A simple trot (`hal.lowlevel.Locomotion`): diagonal pairs of feet swing in turn, where they land follows from the speed.

Feet follow a path in the trunk's frame by joint springs. Those on the ground move back as the trunk is to move forward and
carry its weight by their Jacobians; the path is turned against the trunk's tilt, which keeps it level. It knows no terrain: a
foot that meets a face early presses on it.
"""

from __future__ import annotations

import math

import numpy as np

from hal.limbs import MOTORS, SX, SY, Limbs, leg_angles, wheel_centres, wheel_jacobians
from hal.lowlevel import LowCommand, LowState
from hal.rotation import up_of
from hal.types import GRAVITY, Array, PostureCommand, VelocityCommand

STRIDE = 0.36
"""[s] of one cycle: each pair of feet stands for half of it."""
LIFT = 0.06
"""[m] by which a foot swings above the ground."""
SLEW, TURN_SLEW = 1.0, 3.0
"""Of the commanded speed [m/s^2] and yaw rate [rad/s^2]."""
KP, KD = 100.0, 2.0
"""Of the legs' joints [Nm/rad], [Nm s/rad]."""
LEVEL = 0.5
"""[m/m] by which a foot that stands is pushed down where the trunk hangs low."""
CATCH = 0.20
"""[s] A trunk that drifts by 1 m/s puts its feet so many metres further out."""
LAG = 0.15
"""[s] of the estimate of its own velocity."""
DROP = 0.02
"""[m] below the ground's plane to which a foot reaches that lands."""
FASTEST = 15.0
"""[rad/s] of a joint's wanted speed."""
TRIM, TRIM_MOST = 0.8, 0.25
"""[1/s] by which the feet are moved faster as long as the trunk is slower than wanted, and at most [m/s]."""
TURNS = np.array([1.0, 1.0, 3.0])
"""The same of the yaw rate [rad/s] counts so many times: feet that turn slip."""
STOPS = 0.02
"""[m/s], [rad/s] below which it stands on all four."""


class Trot:
    """Velocity and yaw rate in, joint angles out. Posture and `climb` are not followed."""

    def __init__(self, limbs: Limbs, stand: Array, mass: float, period: float = 0.005) -> None:
        """`stand`: (16,) [rad]; `mass`: whole robot [kg]; `period`: control period [s]."""
        self.period = period
        self._limbs, self._mass = limbs, mass
        self._feet = wheel_centres(limbs, stand)
        self._out = LowCommand(*(np.zeros(len(MOTORS)) for _ in range(5)))
        self._out.kp[:12], self._out.kd[:12] = KP, KD
        self.reset()

    def reset(self) -> None:
        """Forget all state."""
        self._phase = 0.0
        self._walks = self._begun = False
        self._vx = self._vy = self._wz = 0.0
        self._seen = np.zeros(3)
        """Velocity by the feet that stand [m/s] and yaw rate by the gyro [rad/s]."""
        self._trim = np.zeros(3)
        """Beyond the commanded velocity [m/s] and yaw rate [rad/s]."""
        self._target = self._feet.copy()
        self._from = self._feet.copy()
        """Where each foot lifted off."""

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        """One control tick."""
        dt, out = self.period, self._out
        self._vx += float(np.clip(velocity.vx - self._vx, -SLEW * dt, SLEW * dt))
        self._vy += float(np.clip(velocity.vy - self._vy, -SLEW * dt, SLEW * dt))
        self._wz += float(np.clip(velocity.wz - self._wz, -TURN_SLEW * dt, TURN_SLEW * dt))
        moves = max(abs(self._vx), abs(self._vy), abs(self._wz)) > STOPS
        stands = np.ones(4, bool)
        if self._walks or moves:
            before, self._phase = self._phase, self._phase + dt / STRIDE
            # It halts once both pairs have been put where they stand by default.
            self._walks = moves or self._phase % 1.0 > before % 1.0 or float(np.abs(self._off()).max()) > 0.02
            share = (self._phase + np.where(SX * SY > 0.0, 0.0, 0.5)) % 1.0
            stands = share < 0.5
        self._measure(state, stands)
        self._place(stands, (self._phase + np.where(SX * SY > 0.0, 0.0, 0.5)) % 1.0)
        up = np.array(up_of(state.quaternion))
        feet = self._target.copy()
        tilt = (feet[:, :2] @ up[:2]) / max(float(up[2]), 0.5)
        # A foot in the air follows the ground below a tilted trunk, one that stands presses against the tilt.
        feet[:, 2] += np.where(stands, LEVEL, -1.0) * tilt
        q = leg_angles(self._limbs, feet)
        out.dq[:12] = np.clip((q - out.q)[:12] / dt, -FASTEST, FASTEST) if self._begun else 0.0
        out.q[:], self._begun = q, True
        self._carry(state, stands, up)
        return out

    def warning(self) -> str:
        """It does what it is told."""
        return ""

    def _off(self) -> Array:
        return np.asarray((self._target - self._feet)[:, :2])

    def _measure(self, state: LowState, stands: Array) -> None:
        """Velocity by the feet that stand: their motion against the trunk, backwards."""
        jacobian, centres = wheel_jacobians(self._limbs, state.q), wheel_centres(self._limbs, state.q)
        legs = state.dq[:12].reshape(4, 3)
        slips = np.einsum("kij,kj->ki", jacobian, legs) + np.cross(state.gyro, centres)
        if stands.any():
            told = np.append(-slips[stands].mean(axis=0)[:2], state.gyro[2])
            self._seen += self.period / LAG * (told - self._seen)

    def _place(self, stands: Array, share: Array) -> None:
        """Move the path of each foot on by one tick."""
        wanted = np.array([self._vx, self._vy, self._wz])
        error = wanted - self._seen if self._walks else -self._trim / TRIM
        self._trim = np.clip(self._trim + TRIM * self.period * error, -TRIM_MOST, TRIM_MOST)
        moved = wanted + self._trim * TURNS
        for leg in range(4):
            x, y = self._feet[leg, :2]
            drift = moved[:2] + moved[2] * np.array([-y, x])
            if stands[leg]:
                self._target[leg, :2] -= drift * self.period
                self._target[leg, 2] += 10.0 * self.period * (self._feet[leg, 2] - self._target[leg, 2])
                self._from[leg] = self._target[leg]
                continue
            s = 2.0 * (share[leg] - 0.5)
            land = self._feet[leg, :2] + 0.25 * STRIDE * drift + CATCH * (self._seen - wanted)[:2]
            land = np.clip(land, self._feet[leg, :2] - 0.15, self._feet[leg, :2] + 0.15)
            smooth = s * s * (3.0 - 2.0 * s)
            self._target[leg, :2] = (1.0 - smooth) * self._from[leg, :2] + smooth * land
            self._target[leg, 2] = self._feet[leg, 2] + LIFT * math.sin(math.pi * s) - DROP * s**4

    def _carry(self, state: LowState, stands: Array, up: Array) -> None:
        """Torques by which the feet that stand carry the trunk."""
        jacobian = wheel_jacobians(self._limbs, state.q)
        share = self._mass * GRAVITY / max(int(stands.sum()), 1)
        for leg in range(4):
            force = -share * up if stands[leg] else np.zeros(3)
            self._out.tau[3 * leg : 3 * leg + 3] = jacobian[leg].T @ force
