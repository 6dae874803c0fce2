"""Which monitors a stack in lockstep raises, by what its operator could read."""

from __future__ import annotations

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
        self._words: dict[str, None] = {}
        stack.host.listen(self._hear, list(TOLD))

    def _hear(self, topic: Topic, payload: bytes, _now: int) -> None:
        message = decode(payload, topic.kind)
        self._words |= dict.fromkeys(filter(None, (getattr(message, field) for field in TOLD[topic])))

    @property
    def words(self) -> str:
        """All that was told, each once, in lines."""
        return "\n".join(self._words)

    @property
    def monitors(self) -> list[str]:
        """Names of the rows of `hal.safety.monitors` that were raised."""
        return [monitor.name for monitor in raised(self.words)]
