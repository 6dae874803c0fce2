"""Velocities of a page, without a browser."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

from rbtrg_robot.config import load
from rbtrg_robot.console.desk import Desk, Page
from rbtrg_robot.topics import Role


def test_hands_that_let_go_are_heard_however_late_and_late_velocities_are_not() -> None:
    told: list[float] = []
    bus: Any = SimpleNamespace(
        advertise=lambda _topic: None,
        publish=lambda _topic, message, _stamp: told.append(message.twist.linear.x),
    )
    feed: Any = object()
    slots: Any = SimpleNamespace(feed=feed)
    loop: Any = None
    desk = Desk(load(None, []), bus, feed, loop)
    page = Page(1, Role.OPERATOR, slots)

    def drive(v: float, late: float) -> None:
        wish = {"do": "drive", "v": v, "w": 0.0, "t": 1000.0 * (time.monotonic() - late)}
        desk.do(page, wish, lambda *_answer: None)

    drive(0.3, 0.0)
    drive(0.4, 0.5)
    assert told == [0.3], "what waited in a network is not driven"
    drive(0.0, 5.0)
    assert told == [0.3, 0.0]
    drive(0.0, 5.0)
    assert told == [0.3, 0.0], "who does not drive takes no motion away"
    drive(0.3, 0.0)
    desk.leave(page)
    assert told == [0.3, 0.0, 0.3, 0.0], "its page was closed"
    assert desk.lease.holder(time.monotonic()) == 0
