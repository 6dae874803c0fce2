"""A photo that the log keeps."""

from __future__ import annotations

from typing import Any

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import stamp_of

ASK_AGAIN, TIME_LIMIT = 2.0, 30.0
"""[s] between two requests, and for all of them: the camera's process loads what it needs with the first."""


class TakePhoto(Order):
    """Asked for until one comes."""

    hears = (t.PHOTO,)
    sends = (t.PHOTO_REQUEST,)

    def __init__(self, owner: str) -> None:
        super().__init__(ASK_AGAIN, TIME_LIMIT)
        self._owner = owner

    def message(self) -> tuple[Topic, msg.Message]:
        """The request."""
        return t.PHOTO_REQUEST, msg.String(data=self._owner)

    def take(self, topic: Topic, message: Any) -> None:
        """A photo."""
        self.outcome = Outcome(True, f"photo {stamp_of(message)}.jpg is in the log")

    def silence(self) -> Outcome:
        """No camera."""
        return Outcome(False, "the camera gives no picture; see `rbtrg-robot status`")
