"""Which monitors a stack in lockstep raises, by what its operator could read."""

from __future__ import annotations

import re

from hal.safety.monitors import raised
from rbtrg_robot import topics as t
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import decode

TOLD: dict[Topic, tuple[str, ...]] = {
    t.ROBOT_STATE: ("cause", "estop_cause", "hold"),
    t.ODOM_HEALTH: ("reason", "calibration"),
    t.MAP_STATUS: ("warning", "detail"),
    t.TRACKER_STATE: ("hold",),
    t.MOTION_LIMITS: ("reason",),
    t.GOAL_STATUS: ("reason", "detail"),
}
"""Fields that an operator reads."""


class Raised:
    """Listens from now on."""

    def __init__(self, stack: Lockstep) -> None:
        self._words: dict[str, str] = {}
        """By what is the same however far, fast or late."""
        stack.host.listen(self._hear, list(TOLD))

    def _hear(self, topic: Topic, payload: bytes, _now: int) -> None:
        message = decode(payload, topic.kind)
        for word in filter(None, (getattr(message, field) for field in TOLD[topic])):
            self._words.setdefault(re.sub(r"[\d.]+", "", word), word)

    @property
    def words(self) -> str:
        """All that was told, in lines, each once and with its first figures."""
        return "\n".join(self._words.values())

    @property
    def monitors(self) -> list[str]:
        """Names of the rows of `hal.safety.monitors` that were raised."""
        return [monitor.name for monitor in raised(self.words)]
