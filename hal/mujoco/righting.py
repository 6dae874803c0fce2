"""Getting from the side or the back onto the belly."""

from __future__ import annotations

import numpy as np

from hal import go2w
from hal.lowlevel import LowCommand, LowState

UPRIGHT = 0.85
"""Cosine of the tilt from which the robot may get up."""
TIMEOUT = 12.0
"""[s]"""


class Righting:
    """See the module. `step` once per control tick until `upright` or `failed`."""

    def __init__(self, state: LowState) -> None:
        self._start = state.time
        self.upright = False
        self.failed = False
        kp = np.full(16, 60.0)
        kp[go2w.WHEELS] = 0.0
        self._command = LowCommand(np.array(state.q), np.zeros(16), np.zeros(16), kp, np.full(16, 4.0))

    def step(self, state: LowState) -> LowCommand:
        """One control tick."""
        self.failed = state.time - self._start > TIMEOUT
        return self._command
