"""Which of the robot's states become samples."""

from __future__ import annotations

from hal.types import NS, Phase, RobotState

QUIET_PERIOD = NS // 25
"""[ns] between samples while nothing changes."""


class News:
    """A state is a sample when its phase or cause is new, and every `QUIET_PERIOD`."""

    def __init__(self) -> None:
        self._told: tuple[Phase, str] | None = None
        self._told_at = 0

    def of(self, state: RobotState) -> list[RobotState]:
        """The state where it is one, stamps growing."""
        due = state.stamp - self._told_at >= QUIET_PERIOD or (state.phase, state.cause) != self._told
        if not due or state.stamp <= self._told_at:
            return []
        self._told, self._told_at = (state.phase, state.cause), state.stamp
        return [state]
