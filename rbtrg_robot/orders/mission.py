"""What an operator tells the mission process: run, update, pause, resume, skip, stop, answer."""

from __future__ import annotations

import math
import time
import uuid
from typing import Any

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.missions.words import line
from rbtrg_robot.orders.limits import ANSWER_LIMIT, RESEND_PERIOD
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.orders.who import me
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import header


class Present:
    """Tells once a second that an operator watches."""

    PERIOD = 1.0
    """[s]"""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._due = -math.inf

    def __call__(self, *_: Any) -> None:
        """Call in every turn."""
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self.PERIOD
            stamp = time.time_ns()
            self._bus.publish(t.PRESENCE, msg.Presence(header=header(stamp, ""), owner=me()), stamp)


class TellMission(Order):
    """One request, sent until the state of the mission names it."""

    hears = (t.MISSION_STATE,)
    sends = (t.MISSION_REQUEST,)

    def __init__(self, action: str, **fields: Any) -> None:
        """`fields` of rbtrg_msgs/MissionRequest."""
        super().__init__(RESEND_PERIOD, ANSWER_LIMIT)
        self.state: msg.MissionState | None = None
        """With which it was answered."""
        fields = {"owner": me(), **fields}
        stamp = header(time.time_ns(), "map")
        self._request = msg.MissionRequest(header=stamp, id=uuid.uuid4().hex[:12], action=action, **fields)

    def message(self) -> tuple[Topic, msg.Message]:
        """The request."""
        return t.MISSION_REQUEST, self._request

    def take(self, topic: Topic, message: Any) -> None:
        """A MissionState."""
        if message.request == self._request.id:
            self.state = message
            refused = f"refused: {message.refused}" if message.refused else ""
            self.outcome = Outcome(not refused, refused or line(message), message.phase)

    def silence(self) -> Outcome:
        """The mission process is gone."""
        return Outcome(False, "the mission process does not answer")
