"""The watches on both sides of the cable."""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

from hal.unitree import api, guardian
from hal.unitree.api import ObstaclesAvoid, Request, Response, Sport
from hal.unitree.guardian import LONGEST_SILENCE, Guardian, Order, watch
from hal.unitree.layout import CDR_HEADER
from hal.unitree.motion import GO2W_WHEELS, INSIST_TIME
from hal.unitree.sentry import Sentry, run
from tests.hal.unitree.test_motion import low as low_state


class Link:
    """Keeps what is sent; answers when told to."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, Request]] = []
        self.answers: list[Response] = []

    def send(self, service: str, request: Request) -> None:
        self.sent.append((service, request))

    def responses(self, _service: str) -> list[Response]:
        out, self.answers = self.answers, []
        return out

    def take(self, _topic: str) -> list[bytes]:
        return []

    def reachable(self, _service: str) -> bool:
        return True


def move(vx: float) -> tuple[str, Request]:
    return api.SPORT, Request(1, Sport.MOVE, api.compact({"x": vx, "y": 0.0, "z": 0.0}), True)


@pytest.fixture
def link() -> Link:
    return Link()


@pytest.fixture
def sentry(link: Link) -> Sentry:
    return Sentry(Order(link, avoid=False, wheels=GO2W_WHEELS))


def test_silent_while_moves_come_and_after_a_stop(sentry: Sentry, link: Link) -> None:
    for k in range(100):
        sentry.step(0.02 * k, [move(0.5)])
    for ending in (
        [move(0.0)],
        [(api.SPORT, Request(2, Sport.STOP_MOVE))],
        [(api.SPORT, Request(3, Sport.DAMP))],
    ):
        sentry.step(2.0, [move(0.5), *ending])
        sentry.step(5.0, [])
    assert link.sent == []


@pytest.mark.parametrize("number", [0, 1007, 1015, 1027, 1034, 2048])
def test_what_another_program_asks_the_sport_service_ends_no_move(
    sentry: Sentry, link: Link, number: int
) -> None:
    """Speed levels, gaits, questions: one that came last before the driver died had the robot roll on for its
    second."""
    sentry.step(1.0, [move(0.5), (api.SPORT, Request(2, number))])
    sentry.step(2.0, [])
    assert [(s, r.api) for s, r in link.sent] == [(api.SPORT, Sport.STOP_MOVE)]


def test_stops_the_robot_when_moves_cease_and_insists_until_confirmed(sentry: Sentry, link: Link) -> None:
    sentry.step(1.0, [move(-0.2)])
    sentry.step(1.0 + 0.9 * LONGEST_SILENCE, [])
    assert link.sent == []
    sentry.step(1.0 + 1.1 * LONGEST_SILENCE, [])
    assert [(s, r.api) for s, r in link.sent] == [(api.SPORT, Sport.STOP_MOVE)]
    link.answers.append(Response(link.sent[0][1].id, Sport.STOP_MOVE, 0))
    sentry.step(1.0 + INSIST_TIME, [])
    assert len(link.sent) == 1


def test_stops_the_obstacle_avoidance_as_well_where_it_drives(sentry: Sentry, link: Link) -> None:
    parameter = api.compact({"x": 0.4, "y": 0.0, "yaw": 0.0, "mode": 0})
    sentry.step(1.0, [(api.OBSTACLES_AVOID, Request(1, ObstaclesAvoid.MOVE, parameter, True))])
    sentry.step(2.0, [(api.OBSTACLES_AVOID, Request(2, ObstaclesAvoid.SWITCH_GET))])
    assert [(s, r.api) for s, r in link.sent] == [
        (api.SPORT, Sport.STOP_MOVE),
        (api.OBSTACLES_AVOID, ObstaclesAvoid.MOVE),
    ]


@pytest.mark.parametrize(
    "parameter",
    ["", "[]", "{", '{"x": "fast"}', '{"x": null}', '{"x": 1' + 400 * "0" + "}", 10**5 * "["],
    ids=len,
)
def test_a_move_that_cannot_be_read_neither_ends_nor_begins_anything(
    sentry: Sentry, link: Link, parameter: str
) -> None:
    sentry.step(1.0, [(api.SPORT, Request(1, Sport.MOVE, parameter, True))])
    sentry.step(2.0, [])
    assert link.sent == []
    sentry.step(3.0, [move(0.5)])
    sentry.step(3.1, [(api.SPORT, Request(1, Sport.MOVE, parameter, True))])
    sentry.step(3.2, [])
    assert len(link.sent) == 1


def test_without_the_extra_it_says_how_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "cyclonedds.core", None)
    monkeypatch.setattr(sys, "argv", ["sentry", "lo"])
    assert run() == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("sentry: ")
    assert "pip install 'rbtrg-robot[unitree]'" in line


def test_a_guardian_whose_driver_dies_as_it_gives_its_sign_stops_the_robot(link: Link) -> None:
    """It notices by its sign that nobody reads, not by the end of its orders: it ended then and left the robot
    rolling."""
    orders, tell = os.pipe()
    read, signs = os.pipe()
    os.write(tell, b"m")
    os.close(read)
    try:
        watch(Order(link, False, GO2W_WHEELS), orders, signs)
    finally:
        for end in (orders, tell, signs):
            os.close(end)
    assert {(s, r.api) for s, r in link.sent} == {(api.SPORT, Sport.STOP_MOVE)}
    assert len(link.sent) > 1, "it insists until it is confirmed"


@pytest.mark.parametrize("how", ["dies", "hangs"])
def test_a_guardian_that_can_say_nothing_stops_the_robot(
    link: Link, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its words go into a log on a full disk, or to a terminal that was closed: it ended by that before its first
    StopMove."""

    class Full:
        def write(self, _text: str) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        def flush(self) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(sys, "stderr", Full())
    orders, tell = os.pipe()
    read, signs = os.pipe()
    os.write(tell, b"m")
    if how == "dies":
        os.close(tell)
    else:
        threading.Timer(2 * LONGEST_SILENCE, os.close, [tell]).start()
    try:
        watch(Order(link, False, GO2W_WHEELS), orders, signs)
    finally:
        for end in (orders, read, signs):
            os.close(end)
    assert {(s, r.api) for s, r in link.sent} == {(api.SPORT, Sport.STOP_MOVE)}


class Rolling(Link):
    """Beside a robot that rolls at 0.5 m/s, whatever it is told."""

    def take(self, topic: str) -> list[bytes]:
        if topic != guardian.LOW_STATE:
            return []
        tick = time.monotonic_ns() // 2_000_000 % 2**31
        return [CDR_HEADER + low_state(0.5, tick=tick)[0].tobytes()]


def test_a_driver_that_pauses_and_comes_back_is_not_stopped_by_what_was_begun_for_it() -> None:
    """A pause of 0.18 s ended in Damp 1.5 s later, while the driver drove on as it should."""
    link = Rolling()
    orders, tell = os.pipe()
    read, signs = os.pipe()
    watcher = threading.Thread(target=watch, args=(Order(link, False, GO2W_WHEELS), orders, signs))
    watcher.start()

    def drive(seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            os.write(tell, b"m")
            time.sleep(0.02)

    try:
        drive(0.3)
        begun = time.monotonic() + 10 * LONGEST_SILENCE
        while not link.sent and time.monotonic() < begun:  # the driver is silent until the guardian acts
            time.sleep(0.01)
        assert link.sent, "the guardian stops the robot of a silent driver"
        drive(0.2)
        told = len(link.sent)
        drive(2.5)
        assert link.sent[told:] == []
    finally:
        os.write(tell, b"i")
        os.close(tell)
        watcher.join(10.0)
        for end in (orders, read, signs):
            os.close(end)
    assert Sport.DAMP not in [request.api for _, request in link.sent]


def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lines: str) -> None:
    """Let a guardian be this shell script."""
    script = tmp_path / "guardian"
    script.write_text(f"#!/bin/sh\n{lines}\n")
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))


@dataclass
class Clock:
    """The guardian's `time`, set by hand."""

    now: float = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(guardian, "time", made)
    return made


@pytest.mark.parametrize("lines", ["exec sleep 60", "while true; do printf .; sleep 0.05; done"])
def test_a_guardian_that_never_gets_ready_is_lost(
    lines: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    program(tmp_path, monkeypatch, lines)
    watch = Guardian("lo", 0, avoid=False, wheels=GO2W_WHEELS)
    clock.now = 0.9 * guardian.START_TIME
    assert watch.alive(), "it may take a moment"
    clock.now = 1.1 * guardian.START_TIME
    assert not watch.alive()
    assert not watch.ready
    watch.kill()
    assert not psutil.pid_exists(watch.pid)


def test_a_guardian_that_hangs_is_lost_and_can_be_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    program(tmp_path, monkeypatch, "while true; do printf r; sleep 0.05; done")
    watch = Guardian("lo", 0, avoid=False, wheels=GO2W_WHEELS)
    watch.wait_ready(10.0)
    os.kill(watch.pid, signal.SIGSTOP)
    os.waitid(os.P_PID, watch.pid, os.WSTOPPED)
    assert watch.alive(), "what it said before is heard"
    clock.now += 0.9 * guardian.LOST_AFTER
    assert watch.alive()
    clock.now += 0.2 * guardian.LOST_AFTER
    assert not watch.alive()
    watch.kill()
    assert not psutil.pid_exists(watch.pid)
