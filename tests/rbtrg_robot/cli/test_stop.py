"""`rbtrg-robot stop`: small, by hand the same bytes as the wire's, and never content with having tried once."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli import stop as module
from rbtrg_robot.cli.stop import command, latch_in, order, places, stop
from rbtrg_robot.config import load
from rbtrg_robot.latch import number
from rbtrg_robot.process.runfiles import RunLock
from rbtrg_robot.scope import NAMED, ROBOT, Scope
from rbtrg_robot.wire import keys
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import encode, header
from tests.places import ROOT
from tools.bench.ports import free_endpoint

HEAVY = {"numpy", "rosbags", "typer", "pydantic", "numba", "yaml", "rich", "rbtrg_robot.topics"}


def test_key_and_bytes_are_those_of_the_wire() -> None:
    assert keys.key(t.ROBOT_STOP, Scope(7)) == f"7/{module.STOP_KEY}{module.STOP_HASH}"
    assert keys.key(t.ROBOT_STATE, Scope(7)).rpartition("/")[0] == f"7/{module.STATE_KEY}".rpartition("/")[0]
    stamp = 1_700_000_000_123_456_789
    message = msg.RobotCommand(header=header(stamp, ""), mode="stop", cause="operator")
    message.latch = 2**24 - 1
    assert order(stamp, 2**24 - 1) == encode(message)
    config = load()
    assert (config.endpoint, config.domain) == (module.DEFAULT, 0)


@pytest.mark.parametrize("cause", ["", "operator", "Not-Aus", "ü" * 7])
@pytest.mark.parametrize("phase", ["stopped", "moving"])
def test_the_latch_is_read_as_the_wire_reads_it(phase: str, cause: str) -> None:
    state = msg.RobotState(
        header=header(5, "base_link"),
        phase=phase,
        cause=cause,
        estop=True,
        estop_cause=cause,
        latch=2**60 + 7,
    )
    assert latch_in(encode(state)) == (cause, 2**60 + 7)
    state.estop = False
    assert latch_in(encode(state)) is None
    for length in range(len(encode(state)[:70])):
        assert latch_in(encode(state)[:length]) is None


def test_nothing_heavy_is_imported_before_it_is_sent() -> None:
    script = (
        "import sys; sys.argv = ['rbtrg-robot', 'stop'];"
        "from rbtrg_robot.cli import entry, stop;"
        "stop.stop = lambda robot: print(robot, *(m for m in sys.modules)) or 0;"
        "stop.places('go2w');"
        "entry.main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT, timeout=60
    )
    robot, *modules = done.stdout.split()
    assert robot == "go2w"
    assert not HEAVY & set(modules)


class Robot:
    """A robot that latches at the n-th stop it hears. Until then it tells of a stop that somebody else released long
    ago."""

    def __init__(self, endpoint: str, latches_at: int, name: str = ROBOT, *, router: bool = True) -> None:
        self.heard = 0
        self._latch = 77
        self._latches_at = latches_at
        self._end = threading.Event()
        self._bus = Bus(endpoint, "robot", Scope.of(0, name), router=router)
        self._bus.subscribe([t.ROBOT_STOP])
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.is_set():
            for received in self._bus.take(0.05):
                message = received.decode()
                self.heard += message.mode == "stop"
                if self.heard >= self._latches_at:
                    self._latch = number(self._latch + 1, message.latch)
            whose = "operator" if self.heard >= self._latches_at else "somebody else"
            state = msg.RobotState(estop=True, estop_cause=whose, latch=self._latch)
            self._bus.publish(t.ROBOT_STATE, state, 0)

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self._bus.close()


@pytest.fixture
def endpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A free one, and a run folder of one's own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return free_endpoint()


@pytest.fixture
def robot(endpoint: str) -> Iterator[Robot]:
    """It needs to hear three stops."""
    made = Robot(endpoint, 3)
    yield made
    made.close()


def test_it_sends_until_the_robot_confirms(
    robot: Robot, endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lock = RunLock("alpha")
    alpha = Robot(endpoint, 3, "alpha", router=False)
    try:
        lock.write_state(endpoint=endpoint, domain=0)
        assert command(["--robot", "alpha"]) == 0
    finally:
        alpha.close()
        lock.release()
    assert alpha.heard >= 3
    assert robot.heard == 0, "another robot on the same router"
    assert capsys.readouterr().out == "stopped: operator\n"


def test_without_a_name_it_stops_whatever_robot_the_default_port_has(
    robot: Robot, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "DEFAULT", endpoint)
    alpha = Robot(endpoint, 1, "alpha", router=False)
    try:
        assert command([]) == 0
    finally:
        alpha.close()
    assert min(robot.heard, alpha.heard) >= 1


def test_the_environment_may_name_the_robot(
    robot: Robot, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "DEFAULT", endpoint)
    monkeypatch.setenv(NAMED, "alpha")
    alpha = Robot(endpoint, 3, "alpha", router=False)
    try:
        assert command([]) == 0
    finally:
        alpha.close()
    assert (robot.heard, alpha.heard >= 3) == (0, True)


@pytest.mark.parametrize("written", ["", "{", '{"endpoint": "tcp/127.0.0.1:1", "domain": 0}'])
def test_without_a_run_folder_it_tries_the_default_port(
    robot: Robot, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: str
) -> None:
    monkeypatch.setattr(module, "DEFAULT", endpoint)
    if written:
        (tmp_path / "rbtrg").mkdir()
        (tmp_path / "rbtrg" / "go2w.json").write_text(written)
    else:
        monkeypatch.setenv("XDG_RUNTIME_DIR", "/dev/null/nowhere")
    assert stop("go2w") == 0
    assert robot.heard >= 3


def test_a_robot_that_never_confirms_hears_it_again_and_again(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "DEFAULT", endpoint)
    deaf = Robot(endpoint, 10**6)
    try:
        assert stop("go2w", patience=2.0) == 1
    finally:
        deaf.close()
    assert deaf.heard >= 5
    assert "use the hardware stop" in capsys.readouterr().err


def test_where_nobody_answers_it_goes_on_trying_and_says_so(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "DEFAULT", endpoint)
    assert places("go2w") == [(endpoint, "0/**")]
    assert stop("go2w", patience=0.5) == 1
    assert f"nothing answers on {endpoint}; still trying, use the hardware stop" in capsys.readouterr().err


def test_beside_a_supervisor_that_hangs_it_says_so_before_the_connection_ends(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert module.WORRY_AFTER == 1.0
    monkeypatch.setattr(module, "WORRY_AFTER", 0.05)
    monkeypatch.setattr(module, "DEFAULT", endpoint)
    said: list[str] = []

    def hangs(_endpoint: str) -> None:
        if said:
            return
        end = time.monotonic() + 20.0
        while not (words := capsys.readouterr().err) and time.monotonic() < end:
            time.sleep(0.01)
        said.append(words)

    monkeypatch.setattr(module, "_open", hangs)
    lock = RunLock("go2w")
    try:
        lock.write_state(robot="go2w")
        assert stop("go2w", patience=0.2) == 1
    finally:
        lock.release()
    assert f"nothing answers on {endpoint}; still trying, use the hardware stop" in said[0]
    assert "`rbtrg-robot down` ends a stack that hangs" in said[0]


def test_a_word_it_does_not_know_keeps_nothing_from_being_stopped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stopped: list[str] = []
    monkeypatch.setattr(module, "stop", lambda name: stopped.append(name) or 0)
    assert command(["--robot=beta", "--now"]) == 0
    assert stopped == ["beta"]
    assert "'--now'" in capsys.readouterr().err
