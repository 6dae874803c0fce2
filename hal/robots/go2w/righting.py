"""Getting from the side or the back onto the belly.

On its side the robot draws the legs under it inwards, so the trunk sinks towards its belly. Then their thighs swing
the feet around behind the trunk and press down on the far side, which lifts the trunk over. On its back the legs of
one side reach over the back, stretch fast and throw the trunk onto its other side, downhill and uphill in turn. After
each try the attitude decides what comes next. The keyframes were found by random search in simulation (friction 0.6
and 0.9)."""

from __future__ import annotations

import numpy as np

from hal.lowlevel import LowCommand, LowState
from hal.postures.legs import UPRIGHT_COSINE, Legs
from hal.robots.go2w import facts as go2w
from hal.rotation import up_of
from hal.types import Array

ON_BACK = -0.6
"""Cosine of the tilt below which it lies on its back."""
NEARLY_UPRIGHT = 0.9
"""Cosine of the tilt above which the wheels are braked."""
FREE_DAMPING, BRAKED_DAMPING = 0.2, 4.0
"""Damping of the wheels [Nms/rad]."""

Frame = tuple[float, float, Array]
"""Duration [s], stiffness [Nm/rad], leg pose (16,) [rad]."""


class Righting:
    """Turns a fallen robot onto its belly. Call `step` once per control tick until `upright` or `failed`."""

    def __init__(self, state: LowState, until: float) -> None:
        """`until`: no new try after this time [s]."""
        self._since, self._until = state.time, until
        self.upright = False
        self.failed = False
        self._frames: list[Frame] = []
        self._from = state.q.copy()
        self._throws = 0
        kd = np.full(16, 4.0)
        self._command = LowCommand(state.q.copy(), np.zeros(16), np.zeros(16), np.zeros(16), kd)

    def step(self, state: LowState) -> LowCommand:
        """One control tick."""
        if self._frames and state.time - self._since >= self._frames[0][0]:
            self._from = self._frames.pop(0)[2]
            self._since = state.time
        if not self._frames:
            self._frames = self._plan(state)
        duration, stiffness, target = self._frames[0]
        s = min((state.time - self._since) / duration, 1.0)
        s = s * s * (3.0 - 2.0 * s)
        self._command.q[:12] = (1.0 - s) * self._from[:12] + s * target[:12]
        self._command.kp[:12] = stiffness
        # Free wheels slide along the ground instead of holding the trunk back; once it is nearly upright they would
        # roll downhill.
        self._command.kd[go2w.WHEEL_JOINTS] = (
            FREE_DAMPING if up_of(state.quaternion)[2] < NEARLY_UPRIGHT else BRAKED_DAMPING
        )
        return self._command

    def _plan(self, state: LowState) -> list[Frame]:
        """Choose the next motion from the attitude."""
        _, left_up, height = up_of(state.quaternion)
        self.upright = height > UPRIGHT_COSINE
        self.failed = not self.upright and state.time > self._until
        if self.upright or self.failed:
            return [(0.3, 120.0, go2w.FOLDED_POSE)]
        if height > ON_BACK:
            return lever_over(low=-1.0 if left_up > 0.0 else 1.0)
        self._throws += 1
        downhill = 1.0 if left_up > 0.0 else -1.0  # the legs of the upper side throw it onto the lower one
        return throw_over(side=downhill if self._throws % 2 == 1 else -downhill)


def legs(side: float, these: tuple[float, float, float], others: tuple[float, float, float]) -> Array:
    """(16,) hip, thigh, calf [rad] of the two legs of `side` (+1 left, -1 right) and of the two others; hips
    outwards."""
    q = np.zeros(16)
    for leg in range(4):
        hip, thigh, calf = these if go2w.SIGN_Y[leg] == side else others
        q[3 * leg : 3 * leg + 3] = hip * go2w.SIGN_Y[leg], thigh, calf
    return np.clip(q, go2w.JOINT_RANGE[:, 0], go2w.JOINT_RANGE[:, 1])


def lever_over(low: float) -> list[Frame]:
    """For a robot that lies on side `low`."""
    return [
        (0.61, 120.0, legs(low, (-1.04, 0.73, -1.12), (-0.20, 1.67, -1.22))),
        (0.64, 120.0, legs(low, (0.55, 3.30, -1.80), (0.15, 1.13, -2.04))),
        (0.39, 120.0, legs(low, (0.29, 1.33, -1.94), (-0.08, 1.32, -1.84))),
        (0.60, 120.0, go2w.FOLDED_POSE),
        (0.40, 120.0, go2w.FOLDED_POSE),
    ]


def throw_over(side: float) -> list[Frame]:
    """For a robot on its back: the legs of `side` throw it onto the other one."""
    return [
        (0.64, 250.0, legs(side, (0.05, 2.89, -2.13), (0.29, 0.41, -2.59))),
        (0.12, 250.0, legs(side, (0.97, 3.08, -0.85), (-0.64, 2.48, -0.85))),
        (0.34, 250.0, legs(side, (0.72, 2.16, -1.01), (-0.76, 2.31, -2.58))),
    ]


LEGS = Legs(go2w.LIMBS, go2w.STAND, go2w.FOLDED_POSE, tall=0.25, angles=go2w.leg_angles, righting=Righting)
"""Folded base_link is 0.17 m above the wheels' lowest points, in stance 0.39 m."""
