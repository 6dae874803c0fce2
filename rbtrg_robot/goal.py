"""A goal as the navigator holds it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rbtrg_robot.reasons import Reason


class GoalState(StrEnum):
    """Lifecycle: accepted -> planning -> moving <-> recovering -> one of the terminal states."""

    IDLE = "idle"
    ACCEPTED = "accepted"
    PLANNING = "planning"
    MOVING = "moving"
    RECOVERING = "recovering"
    REACHED = "reached"
    REJECTED = "rejected"
    ABORTED = "aborted"
    CANCELLED = "cancelled"
    PREEMPTED = "preempted"

    @property
    def active(self) -> bool:
        """Still being worked on."""
        return self in _ACTIVE

    @property
    def terminal(self) -> bool:
        """Ended."""
        return self is not GoalState.IDLE and self not in _ACTIVE


_ACTIVE = (GoalState.ACCEPTED, GoalState.PLANNING, GoalState.MOVING, GoalState.RECOVERING)


@dataclass(slots=True)
class Goal:
    """One goal in frame `map`."""

    id: str
    x: float
    y: float
    yaw: float | None
    accepted: int
    """Source clock [ns]."""
    timeout: float = 0.0
    """[s]; 0 = never."""
    state: GoalState = GoalState.ACCEPTED
    reason: Reason = Reason.NONE
    detail: str = ""
    replans: int = 0
    recoveries: int = 0
    frontier: bool = False
    risk: float = 0.0

    @classmethod
    def from_request(cls, message: Any, now: int) -> Goal:
        """From rbtrg_msgs/GoalRequest."""
        yaw = message.yaw if message.has_yaw else None
        return cls(message.id, message.x, message.y, yaw, now, message.timeout)

    @property
    def finite(self) -> bool:
        """All numbers are numbers."""
        return all(math.isfinite(v) for v in (self.x, self.y, self.yaw or 0.0, self.timeout))

    def end(self, state: GoalState, reason: Reason, detail: str = "") -> None:
        """Enter a terminal state."""
        self.state, self.reason, self.detail = state, reason, detail
