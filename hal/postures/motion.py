"""Joint motions without balance: getting up, sitting down, being limp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hal.limbs import WHEEL_JOINTS, wheel_centres
from hal.lowlevel import LowCommand, LowState
from hal.postures.legs import Legs
from hal.rotation import up_of
from hal.types import Array


@dataclass(frozen=True, slots=True)
class Keyframe:
    """Reach `q` (16,) [rad] within `duration` [s]."""

    duration: float
    q: Array


class Motion:
    """Smooth joint motion through keyframes from where the joints are; holds the last one.

    The torque the motors carry at the start fades out while the springs take over: no drop at the change.
    """

    FADE = 0.4
    """[s]"""

    def __init__(self, state: LowState, frames: list[Keyframe], kp: float, kd: float = 5.0) -> None:
        self._start = state.time
        self._times = state.time + np.cumsum([0.0, *(f.duration for f in frames)])
        self._poses = [state.q.copy(), *(f.q for f in frames)]
        self._tau = state.tau.copy()
        self._tau[WHEEL_JOINTS] = 0.0
        stiffness = np.full(16, kp)
        stiffness[WHEEL_JOINTS] = 0.0
        self._command = LowCommand(state.q.copy(), np.zeros(16), np.zeros(16), stiffness, np.full(16, kd))

    def done(self, time: float) -> bool:
        """The last keyframe's time has come."""
        return bool(time >= self._times[-1])

    def step(self, time: float) -> LowCommand:
        """Command at `time` [s]."""
        k = int(np.clip(np.searchsorted(self._times, time, side="right") - 1, 0, len(self._poses) - 2))
        s = np.clip((time - self._times[k]) / (self._times[k + 1] - self._times[k]), 0.0, 1.0)
        s = s * s * (3.0 - 2.0 * s)
        self._command.q[:] = (1.0 - s) * self._poses[k] + s * self._poses[k + 1]
        self._command.tau[:] = max(1.0 - (time - self._start) / self.FADE, 0.0) * self._tau
        return self._command


def damped(kd: float = 3.0) -> LowCommand:
    """Motors as dampers."""
    zero = np.zeros(16)
    return LowCommand(zero, zero.copy(), zero.copy(), zero.copy(), np.full(16, kd))


def level_stance(legs: Legs, state: LowState, height: float = 0.33) -> Array:
    """(16,) joint angles of a level trunk `height` [m] above ground that is parallel to the trunk now (it lies on
    it)."""
    up = np.array(up_of(state.quaternion))
    centres = wheel_centres(legs.limbs, legs.stand)
    # Seen from the level trunk the ground falls away along the horizontal part of the trunk's up axis.
    slope = -up[:2] / max(up[2], 0.5)
    centres[:, 2] = -(height - legs.limbs.radius) - centres[:, :2] @ slope
    centres[:, 2] = np.clip(centres[:, 2], -0.36, -0.13)
    return legs.angles(centres)
