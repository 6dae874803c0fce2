"""What stands between a locomotion controller and the motors: limits of each command, and what the motors must not
do."""

from __future__ import annotations

import math

import numpy as np

from hal.lowlevel import LowCommand, LowState
from hal.plausible import lost_motor
from hal.robots.go2w import facts as go2w
from hal.types import Array
from hal.unitree.low.wire import MOTORS

STIFFEST_JOINT = 400.0
"""[Nm/rad], above what any controller of ours asks for (300)."""
DAMPED_INERTIA = np.array([0.014, 0.024, 0.029] * 4 + [0.011] * 4)
"""(16,) [kg m^2] that damping of all hips, all thighs, all calves or all wheels at once has to brake, in the pose where
it is least. Damping above it over the age of the speed that it is computed from makes the joints ring."""
SOFT_START = 1.0
"""[s] in which the stiffness grows from nothing, after the motors were off."""
OVERSPEED_RATIO = 1.25
"""Share of a motor's top speed that it cannot reach by itself: something drives it, or it reads wrong."""
BEYOND_RANGE = 0.2
"""[rad] outside its range that no joint reaches: its encoder lies."""
LASTING_MESSAGES = 5
"""Messages in a row that show it: one may be wrong."""
HOT_WINDING = 90.0
"""[deg C] of a motor's winding; the vendor's own protection begins near 100."""


class Limits:
    """Of one robot's motors. `share` of the torque limits is allowed: less while the controller is tried.
    `law_age` [s]: see `UnitreeConfig`."""

    def __init__(self, share: float = 1.0, law_age: float = 0.001) -> None:
        self._torque = share * go2w.TORQUE_LIMIT
        self._most_damped = DAMPED_INERTIA / law_age
        self._bad = 0
        self._out = LowCommand(*(np.zeros(MOTORS) for _ in range(5)))
        self._since = -math.inf

    def begin(self, time: float) -> None:
        """The motors were off until `time` [s]: stiffness starts from nothing."""
        self._since = time

    def trouble(self, state: LowState, low: np.void) -> str:
        """Why the motors must go soft, in words; empty where they need not. Call once per message."""
        motors = low["motor_state"]
        warm = motors["temperature"][:MOTORS]
        hottest = int(np.argmax(warm))
        if warm[hottest] >= HOT_WINDING:
            return (
                f"motor {go2w.MOTORS[hottest]} has {int(warm[hottest])} deg C: let it cool down, then recover"
            )
        if lost := lost_motor(motors["lost"][:MOTORS], motors["reserve"][:MOTORS, 0]):
            return lost
        found = self._found(state)
        self._bad = self._bad + 1 if found else 0
        return found if self._bad >= LASTING_MESSAGES else ""

    def _found(self, state: LowState) -> str:
        values = np.concatenate([state.q, state.dq, state.tau, state.quaternion, state.gyro, state.accel])
        if not np.isfinite(values).all():
            return "LowState holds a value that is not a number"
        fast = int(np.argmax(np.abs(state.dq) / go2w.SPEED_LIMIT))
        if abs(state.dq[fast]) > OVERSPEED_RATIO * go2w.SPEED_LIMIT[fast]:
            return (
                f"motor {go2w.MOTORS[fast]} turns at {state.dq[fast]:.0f} rad/s, possible are "
                f"{go2w.SPEED_LIMIT[fast]:.0f}"
            )
        out = np.maximum(go2w.JOINT_RANGE[:, 0] - state.q, state.q - go2w.JOINT_RANGE[:, 1])
        far = int(np.argmax(out))
        if out[far] > BEYOND_RANGE:
            return (
                f"joint {go2w.MOTORS[far]} reads {state.q[far]:.2f} rad, {out[far]:.2f} rad outside its range"
            )
        return ""

    def apply(self, command: LowCommand, state: LowState) -> LowCommand | None:
        """The command within all limits, valid until the next call; None where a value of it is not finite.

        Positions stay in the joints' range, speeds and gains below their most, and the torque that a motor will make of
        it, tau + kp (q* - q) + kd (dq* - dq), at its limit at most: all three terms shrink by one factor.
        """
        out = self._out
        for name in ("q", "dq", "tau", "kp", "kd"):
            np.copyto(getattr(out, name), getattr(command, name))
        if not all(np.isfinite(getattr(out, name)).all() for name in ("q", "dq", "tau", "kp", "kd")):
            return None
        np.clip(out.q, go2w.JOINT_RANGE[:, 0], go2w.JOINT_RANGE[:, 1], out=out.q)
        np.clip(out.dq, -go2w.SPEED_LIMIT, go2w.SPEED_LIMIT, out=out.dq)
        np.clip(out.kp, 0.0, STIFFEST_JOINT, out=out.kp)
        out.kp *= self._rise(state.time)
        np.clip(out.kd, 0.0, self._most_damped, out=out.kd)
        torque: Array = np.abs(out.tau + out.kp * (out.q - state.q) + out.kd * (out.dq - state.dq))
        factor = np.minimum(1.0, self._torque / np.maximum(torque, 1e-9))
        for term in (out.tau, out.kp, out.kd):
            term *= factor
        return out

    def _rise(self, time: float) -> float:
        """Share of the stiffness during the soft start."""
        return min(1.0, max(0.0, (time - self._since) / SOFT_START))
