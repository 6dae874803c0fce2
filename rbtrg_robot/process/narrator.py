"""What happens to goal, mission, robot and map, for whoever looks at the terminal of `up`: every change once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hal.safety.monitors import STRANGER, raised
from hal.types import Phase
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.navigation.goal import arrival
from rbtrg_robot.topics import Topic

MOST_SAID = 100
"""Different words about strangers: they choose their names."""


class Narrator:
    """Takes messages, says what is new in them."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._said: dict[Topic, str] = {}
        self._estop = self._away = False
        self._location = ""
        self._strangers: set[str] = set()

    def take(self, topic: Topic, message: Any) -> None:
        """One message of any topic."""
        if t.GOAL_STATUS.carried(message, topic):
            if message.state not in ("accepted", "idle"):
                detail = f" ({message.detail})" if message.detail else ""
                why = f": {message.reason}{detail}" if message.reason else ""
                chance = arrival(message.p_fail, message.worst) if message.state == "moving" else ""
                self._once(topic, f"goal {message.id[:8]} {message.state}{why}" if message.id else "", chance)
        elif t.MISSION_STATE.carried(message, topic):
            if message.order_id:
                why = message.question or message.reason
                self._once(topic, f"mission {message.name} {message.phase}" + (f": {why}" if why else ""))
        elif t.ROBOT_STATE.carried(message, topic):
            self._robot(message)
        elif t.MAP_STATUS.carried(message, topic):
            if message.location_detail and message.location_detail != self._location:
                self._say(f"map: {message.location_detail}")
            self._location = message.location_detail
            if message.warning or topic in self._said:
                self._once(topic, f"map: {message.warning or 'well again'}")

        elif t.HEARTBEAT.carried(message, topic):
            self.strangers(message.detail)
        elif t.ODOM_HEALTH.carried(message, topic) and (message.calibration or topic in self._said):
            self._once(topic, f"odometry: {message.calibration or 'clocks and mounts are well again'}")

    def strangers(self, detail: str) -> None:
        """Who publishes what belongs to this stack, once; every process that hears it tells so."""
        for words in detail.split("; "):
            if (
                STRANGER in raised(words)
                and words not in self._strangers
                and len(self._strangers) < MOST_SAID
            ):
                self._strangers.add(words)
                self._say(words)

    def _robot(self, state: msg.RobotState) -> None:
        if bool(state.estop) != self._estop:
            self._estop = bool(state.estop)
            self._say(f"e-stop: {state.estop_cause}" if state.estop else "e-stop released")
        away = state.phase == Phase.DISCONNECTED
        if away != self._away:
            self._away = away
            self._say(f"robot {state.phase}: {state.cause}" if away else "robot is back")

    def _once(self, topic: Topic, text: str, more: str = "") -> None:
        """Say `text` when it is new, with what is known `more` then."""
        if text and text != self._said.get(topic):
            self._say(f"{text}, {more}" if more else text)
        self._said[topic] = text
