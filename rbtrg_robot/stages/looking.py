"""One look at the ground ahead: nose down, and level again."""

from __future__ import annotations

from hal.safety.trunk import LEVEL_LAG, STANDING_TIME, TILT_RATE
from hal.types import NS

HOLD_TIME = 0.25
"""[s] at the lowest: two sweeps."""


class Look:
    """Schedule of the trunk for a look. It begins when the robot has stood for `STANDING_TIME`, and follows at
    `TILT_RATE`, as the gate requires. Times in ns."""

    def __init__(self, pitch: float) -> None:
        """`pitch` [rad], nose down."""
        self._pitch = pitch
        way = pitch / TILT_RATE
        self._down, self._whole = (
            round((way + HOLD_TIME) * NS),
            round((2.0 * way + HOLD_TIME + LEVEL_LAG) * NS),
        )
        self._begun: int | None = None
        self.over = False
        """The trunk is level again."""

    def step(self, now: int, zero_since: int) -> float:
        """The pitch [rad] to command now, 0 for none. `zero_since`: no velocity was commanded from then on."""
        if self._begun is None and now - zero_since >= STANDING_TIME * NS:
            self._begun = now
        if self._begun is None:
            return 0.0
        self.over = now - self._begun >= self._whole
        return self._pitch if now - self._begun < self._down else 0.0
