"""Velocities of a page, without a browser."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

from rbtrg_robot import msg
from rbtrg_robot.config import load
from rbtrg_robot.console.desk import Desk, Page
from rbtrg_robot.topics import Role
from rbtrg_robot.wire.messages import header, stamp_of


def test_a_velocity_echoes_what_its_page_saw_and_the_robot_judges_it() -> None:
    told: list[tuple[float, int]] = []
    frames: list[dict[str, Any]] = []
    bus: Any = SimpleNamespace(
        advertise=lambda _topic: None,
        publish=lambda _topic, message, _stamp: told.append((message.twist.linear.x, stamp_of(message))),
    )
    feed: Any = SimpleNamespace(state=msg.RobotState(header=header(9_500_000_000, "")))
    slots: Any = SimpleNamespace(feed=feed, tell=lambda _kind, content: frames.append(content))
    loop: Any = None
    desk = Desk(load(None, []), bus, feed, loop)
    page = Page(1, Role.OPERATOR, slots)

    def drive(v: float, seen: object) -> None:
        desk.do(page, {"do": "drive", "v": v, "w": 0.0, "seen": seen}, lambda *_answer: None)

    drive(0.3, "9000000000")
    assert told.pop() == (0.3, 9_000_000_000)
    for nonsense in (None, "", "-1", "1e9", "9" * 400, {}, "\u0663"):
        drive(0.3, nonsense)
        assert told.pop() == (0.3, 0), "the robot refuses it"
    drive(0.0, "9100000000")
    assert told.pop() == (0.0, 9_100_000_000)
    drive(0.0, "9100000000")
    assert told == [], "who does not drive takes no motion away"
    drive(0.3, "9100000000")
    told.clear()
    desk.alive(page, time.monotonic(), {"seen": "6500000000"})
    assert frames == [{"delay": 3.0}], "a page whose link is slow from the start reads it"
    desk.leave(page)
    assert told == [(0.0, 9_500_000_000)], "its page was closed"
    assert desk.lease.holder(time.monotonic()) == 0
