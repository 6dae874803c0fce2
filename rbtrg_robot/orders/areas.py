"""Where the robot stays in and keeps out of, told anew."""

from __future__ import annotations

import time
import uuid
from collections.abc import Sequence
from typing import Any

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.orders.limits import ANSWER_LIMIT, RESEND_PERIOD
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP
from rbtrg_robot.wire.messages import header


class SetAreas(Order):
    """All drawn areas from now on, sent until they count or are refused."""

    hears = (t.AREAS,)
    sends = (t.AREAS_REQUEST,)

    def __init__(self, areas: Sequence[msg.GroundArea]) -> None:
        super().__init__(RESEND_PERIOD, ANSWER_LIMIT)
        self._wanted = msg.Areas(
            header=header(time.time_ns(), MAP), id=uuid.uuid4().hex[:12], areas=list(areas)
        )

    def message(self) -> tuple[Topic, msg.Message]:
        """The areas."""
        return t.AREAS_REQUEST, self._wanted

    def take(self, topic: Topic, message: Any) -> None:
        """What counts now."""
        if message.id == self._wanted.id:
            kept = sum(area.keep_out for area in message.areas)
            words = f"{kept} keep-out and {len(message.areas) - kept} allowed areas are drawn"
            self.outcome = Outcome(not message.refused, message.refused or words)

    def silence(self) -> Outcome:
        """Elevation is gone."""
        return Outcome(False, "the elevation process does not answer; see `rbtrg-robot status`")
