"""`stop`: the emergency stop on the bus, as fast as a process can start.

It imports the standard library and zenoh only (`access.identity`, `latch` and `orders.limits` keep to that too). The
command's key and bytes are made by hand here, and a test compares them with those of `wire`. It needs no run folder:
if there is none, or nobody answers there, it tries the default port. It sends until the robot says that it stopped
for this stop; an earlier state, or one of another stop, is no answer. With RBTRG_CONNECT it stops the robot of that
computer and no other, because another robot's answer would be taken for its own."""

from __future__ import annotations

import json
import os
import struct
import threading
import time
from typing import Any

import zenoh
from zenoh.handlers import Callback

from rbtrg_robot.access.identity import client_tls, problem, remote
from rbtrg_robot.latch import confirms, new_name
from rbtrg_robot.orders.limits import REPEAT_PERIOD, STOP_PATIENCE, USE_HARDWARE, WORRY_AFTER
from rbtrg_robot.scope import Scope, meant
from rbtrg_robot.terminal import say

DEFAULT = "tcp/127.0.0.1:7447"
"""Endpoint of a stack that was given no other."""
STOP_KEY = "robot/stop/rbtrg_msgs::msg::dds_::RobotCommand_/"
STOP_HASH = "RIHS01_4796778b41b2cd20cd02d5d4330de2a265dd8ca80c524e4b029d547a33025ca2"
STATE_KEY = "robot/state/rbtrg_msgs::msg::dds_::RobotState_/*"


def command(words: list[str]) -> int:
    """`rbtrg-robot stop [--robot NAME]`; returns the exit status. An unknown word prevents no stop."""
    robot = meant()
    for number, word in enumerate(words):
        if word == "--robot" and number + 1 < len(words):
            robot = words[number + 1]
        elif word.startswith("--robot="):
            robot = word.partition("=")[2]
        elif words[max(number - 1, 0)] != "--robot":
            say(f"rbtrg-robot: stop does not know {word!r}; stopping anyway", error=True)
    try:
        return stop(robot)
    except KeyboardInterrupt:
        return 130


def stop(robot: str, patience: float = STOP_PATIENCE) -> int:
    """Send the stop until the robot confirms it; 0 then, 1 after `patience` [s]. Prints what happened."""
    deadline = time.monotonic() + patience
    told = threading.Event()

    def tell() -> None:
        if not told.is_set():
            told.set()
            far = remote()
            wrong = problem(far.folder) if far is not None else ""
            why = wrong or f"nothing answers on {', '.join(endpoint for endpoint, _ in places(robot))}"
            hung = (
                "" if far is not None or not _is_up(robot) else "; `rbtrg-robot down` ends a stack that hangs"
            )
            say(f"rbtrg-robot: {why}; still trying, {USE_HARDWARE}{hung}", error=True)

    worry = threading.Timer(
        WORRY_AFTER, tell
    )  # a computer that takes the connection and is silent costs 10 s
    worry.daemon = True
    worry.start()
    try:
        while time.monotonic() < deadline:
            for endpoint, prefix in places(robot):
                session = _open(endpoint)
                if session is not None:
                    told.set()
                    with session:
                        return _send(session, prefix, deadline)
            tell()
            time.sleep(REPEAT_PERIOD)
    finally:
        worry.cancel()
    return 1


def _is_up(robot: str) -> bool:
    """A stack of this name holds its lock, whether it answers or not."""
    try:
        from rbtrg_robot.process.runfiles import read_state

        return bool(read_state(robot))
    except Exception:  # noqa: BLE001  whatever is wrong with that folder: this is a hint
        return False


def places(robot: str) -> list[tuple[str, str]]:
    """Endpoints and key prefixes to try in turn: that of another computer, or what the stack of this name wrote down
    and the default."""
    far = remote()
    if far is not None:
        return [(far.endpoint, Scope.wanted(far.domain, robot))]
    default = (DEFAULT, Scope.wanted(0, robot))
    try:
        from rbtrg_robot.run_folder import run_dir

        state = json.loads((run_dir() / f"{robot}.json").read_text())
        written = (str(state["endpoint"]), Scope.of(int(state["domain"]), robot).prefix)
        return list(dict.fromkeys([written, default]))
    except Exception:  # noqa: BLE001  whatever is wrong with that folder: the default port is tried
        return [default]


def _open(endpoint: str) -> zenoh.Session | None:
    far = remote()
    settings: dict[str, Any] = {
        "mode": "client",
        "connect": {"endpoints": [endpoint], "timeout_ms": 0},
        "listen": {"endpoints": []},
        "scouting": {"multicast": {"enabled": False}},
    }
    if far is not None:
        settings["transport"] = {"link": {"tls": client_tls(far.folder)}}
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
    except zenoh.ZError:
        return None


def _send(session: zenoh.Session, prefix: str, deadline: float) -> int:
    confirmed = threading.Event()
    causes: list[str] = []
    name = new_name()

    def heard(sample: zenoh.Sample) -> None:
        latched = latch_in(sample.payload.to_bytes())
        if latched is not None and confirms(latched[1], name):
            causes.append(latched[0])
            confirmed.set()

    publisher = session.declare_publisher(
        f"{prefix}/{STOP_KEY}{STOP_HASH}",
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )
    sender = os.urandom(16)
    sent, worried = 0, time.monotonic() + WORRY_AFTER
    while time.monotonic() < deadline:
        sent += 1
        now = time.time_ns()
        publisher.put(order(now, name), attachment=struct.pack("<qqB16s", sent, now, 16, sender))
        if sent == 1:
            session.declare_subscriber(f"{prefix}/{STATE_KEY}", Callback(heard, indirect=False))
        if confirmed.wait(REPEAT_PERIOD):
            say(f"stopped: {causes[0]}")
            return 0
        if worried and time.monotonic() > worried:
            worried = 0.0
            say(
                f"rbtrg-robot: the robot has not confirmed yet; still sending, {USE_HARDWARE}",
                error=True,
            )
    say(f"rbtrg-robot: the robot does not confirm `stop`; {USE_HARDWARE}", error=True)
    return 1


def order(stamp: int, name: int) -> bytes:
    """CDR of the rbtrg_msgs/RobotCommand that stops; `stamp` in ns, `name` of this stop."""
    body = struct.pack("<iI", *divmod(stamp, 1_000_000_000))
    for text in (b"", b"stop", b"operator"):  # frame, mode, cause
        body += bytes(-len(body) % 4) + struct.pack("<I", len(text) + 1) + text + b"\0"
    body += bytes(-len(body) % 8) + struct.pack("<q", name)
    return b"\0\1\0\0" + body


def latch_in(payload: bytes) -> tuple[str, int] | None:
    """Cause and number of the emergency stop in a rbtrg_msgs/RobotState; None if it is not latched or the bytes are
    broken."""
    body = payload[4:]
    place = 8  # behind the stamp

    def text() -> str:
        nonlocal place
        place += -place % 4
        (length,) = struct.unpack_from("<I", body, place)
        if place + 4 + length > len(body):
            raise ValueError("a text ends behind the message")
        place += 4 + length
        return body[place - length : place - 1].decode()

    try:
        for _ in ("frame", "phase", "cause"):
            text()
        latched = body[place]
        place += 1
        cause = text()
        (number,) = struct.unpack_from("<q", body, place + -place % 8)
    except (struct.error, ValueError, IndexError):
        return None
    return (cause, number) if latched else None
