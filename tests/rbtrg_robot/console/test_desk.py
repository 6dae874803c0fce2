"""Velocities and stops of a page, without a browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.console.desk import Desk, Page
from rbtrg_robot.console.feed import Feed
from rbtrg_robot.console.server import Serving
from rbtrg_robot.latch import number
from rbtrg_robot.topics import Role
from rbtrg_robot.wire.bus import Received
from rbtrg_robot.wire.messages import encode, header, stamp_of


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


def test_a_stop_that_is_told_as_confirmed_stands_in_the_state_already() -> None:
    calls: list[tuple[Callable[..., object], tuple[Any, ...]]] = []
    loop: Any = SimpleNamespace(call_soon_threadsafe=lambda call, *args: calls.append((call, args)))
    sent: list[msg.RobotCommand] = []
    inbox: list[Any] = []
    bus: Any = SimpleNamespace(
        advertise=lambda _topic: None,
        publish=lambda _topic, message, _stamp: sent.append(message),
        wake=lambda: None,
        take=lambda _limit: inbox,
        open=lambda received: received.decode(),
    )
    config = load(None, [])
    feed = Feed(bus, config.capabilities(), loop)
    desk = Desk(config, bus, feed, loop)
    console = Serving(desk, feed, *[cast(Any, None)] * 4)
    for latched in (False, True):
        if latched:
            desk.stop()
        latch = number(1, sent[-1].latch) if latched else 0
        state = msg.RobotState(header=header(1, ""), estop=latched, latch=latch)
        inbox[:] = [Received(t.ROBOT_STATE, encode(state), 1, 1)]
        console.turn(bus)
    while desk.stop_state["state"] != "confirmed":
        call, args = calls.pop(0)
        call(*args)
    assert feed.known()["robot"]["estop"] is True
