"""Republish a log on the bus, paced like the original. Never what makes a robot move."""

from __future__ import annotations

import math
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

from hal.errors import OperatorError
from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.log.read import Entry, read_run
from rbtrg_robot.topics import Qos, Topic
from rbtrg_robot.wire.bus import Bus

LATE_AFTER = 0.05
"""A message published this late [s] counts as late."""
LONGEST_PAUSE = 60.0
"""A longer silence [s] is no pause but a clock that was set, or a stamp that rolled over: it is told and not waited
for."""
RATE_STEP = 1.1
OF_PROCESSES = frozenset({t.HEARTBEAT, t.JOURNAL})
"""Told by processes that do not run in a replay."""
LATEST_STAMP = 2**63 - 1
"""A stamp on the wire [ns]; a log has room for later ones."""
ROBOT = "robot"
"""The process that moves one."""


class ReplayError(OperatorError):
    """A log is not played here, or no longer; the message says why."""


def alone(bus: Bus) -> Callable[[], None]:
    """Returns a function that raises ReplayError once a robot is on the bus: its stack would take the replay for
    real. Raises it now if one is there."""
    came = threading.Event()

    def check() -> None:
        if came.is_set():
            raise ReplayError(
                "a robot is live on this bus: a log is not played beside it; `rbtrg-robot down`, or bring "
                "the stack up with --without robot"
            )

    if ROBOT in bus.processes():
        came.set()
    check()
    bus.watch_processes(lambda process, alive: came.set() if alive and process == ROBOT else None)
    return check


@dataclass(slots=True)
class Report:
    """Counts of a replay."""

    messages: int = 0
    late: int = 0
    skipped: dict[str, int] = field(default_factory=dict)
    """Messages not published, by topic: unknown or unsafe."""
    worst: float = 0.0
    """Greatest lateness [s]."""
    seconds: float = 0.0
    jumps: list[tuple[float, float]] = field(default_factory=list)
    """Where the log stands still or steps back for longer than LONGEST_PAUSE, and by how much [s]."""


@dataclass(slots=True)
class Controls:
    """State that keys change while playing."""

    rate: float = 1.0
    paused: bool = False
    single: bool = False
    quit: bool = False

    def press(self, key: str) -> None:
        """space: pause; right: next message; up, down: rate; q: quit."""
        if key == " ":
            self.paused = not self.paused
        elif key == "\x1b[C":
            self.single = True
        elif key == "\x1b[A":
            self.rate *= RATE_STEP
        elif key == "\x1b[B":
            self.rate /= RATE_STEP
        elif key in ("q", "\x03"):
            self.quit = True


@contextmanager
def keyboard() -> Iterator[Callable[[], str]]:
    """A function that gives the pressed key or nothing; nothing at all where stdin is no terminal."""
    if not sys.stdin.isatty():
        yield lambda: ""
        return
    before = termios.tcgetattr(sys.stdin)

    def read() -> str:
        if not select.select([sys.stdin], [], [], 0)[0]:
            return ""
        key = sys.stdin.read(1)
        return key + sys.stdin.read(2) if key == "\x1b" else key

    try:
        tty.setcbreak(sys.stdin)
        yield read
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def chosen(entries: Iterator[Entry], patterns: list[str], report: Report) -> Iterator[tuple[Topic, Entry]]:
    """Entries whose topic is known, safe, and fits; the clock always."""
    wanted = set(t.matching(patterns)) | {t.CLOCK}
    for entry in entries:
        topic = t.BY_NAME.get(entry.topic)
        if topic is None or topic.type != entry.type or not topic.safe_to_replay or topic in OF_PROCESSES:
            report.skipped[entry.topic] = report.skipped.get(entry.topic, 0) + 1
        elif topic in wanted:
            yield topic, entry


def play(
    bus: Bus,
    log: Path,
    *,
    controls: Controls,
    check: Callable[[], None],
    start_offset: float = 0.0,
    duration: float = math.inf,
    patterns: list[str],
    key: Callable[[], str] = lambda: "",
    progress: Callable[[float, Controls], None] = lambda _seconds, _controls: None,
    stopping: Callable[[], bool] = lambda: False,
) -> Report:
    """Publish once through. Latched values from before the offset are sent first. `check`: of `alone`. Raises
    LogError, ReplayError."""
    report = Report()
    zero: int | None = None
    latched: dict[Topic, Entry] = {}
    source = position = 0.0
    at = 0
    wall = time.monotonic()
    for log_time, group in groupby(chosen(read_run(log), patterns, report), lambda pair: pair[1].log_time):
        zero = log_time if zero is None else zero
        gap = log_time - zero - at
        if abs(gap) > LONGEST_PAUSE * NS:
            report.jumps.append((position, gap / NS))
            zero += gap
        at = log_time - zero
        position = at / NS
        pairs = list(group)
        if position < start_offset:
            latched |= {topic: entry for topic, entry in pairs if topic.qos is Qos.LATCHED}
            wall, source = time.monotonic(), position
            continue
        if position > start_offset + duration:
            break
        check()
        for topic, entry in latched.items():
            publish(bus, topic, entry, report)
        latched = {}
        while True:
            check()
            pressed = key()
            if pressed:
                now = time.monotonic()
                source += 0.0 if controls.paused else (now - wall) * controls.rate
                wall = now
                controls.press(pressed)
            if controls.quit or stopping():
                report.seconds = position
                return report
            if controls.paused and not controls.single:
                wall = time.monotonic()
                time.sleep(0.02)
                continue
            due = wall + (position - source) / controls.rate
            wait = due - time.monotonic()
            if wait <= 0 or controls.single:
                break
            time.sleep(min(wait, 0.02))
        if controls.single:
            controls.single = False
            wall, source = time.monotonic(), position
        else:
            lateness = time.monotonic() - due
            report.worst = max(report.worst, lateness)
            report.late += len(pairs) if lateness > LATE_AFTER else 0
        for topic, entry in pairs:
            publish(bus, topic, entry, report)
        progress(position, controls)
    report.seconds = position
    return report


def publish(bus: Bus, topic: Topic, entry: Entry, report: Report) -> None:
    """The wire bytes as they were."""
    bus.advertise(topic).put(entry.data, min(entry.publish_time, LATEST_STAMP))
    report.messages += 1
