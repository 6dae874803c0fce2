"""An emergency stop and a mission outlive the stack that was told of them."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from rbtrg_robot import msg
from rbtrg_robot.process.latch import LatchFile
from rbtrg_robot.wire.messages import decode, encode
from tests.rbtrg_robot.process.command import SPARSE, command
from tools.bench.ports import free_port

OTHERS = ("odometry", "elevation", "planner", "navigator", "tracker")
pytestmark = pytest.mark.timeout(300)


class Robot:
    """Robot and mission process alone under a supervisor of their own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._port = free_port()

    def run(self, *arguments: str) -> str:
        done = command(self._folder, *arguments)
        done.check_returncode()
        return done.stdout

    def up(self) -> str:
        without = [word for name in (*OTHERS, *self.optional()) for word in ("--without", name)]
        place = ("--port", str(self._port), "--log-dir", str(self._folder / "logs"))
        return self.run("up", "--detach", "--scene", "flat", "--no-record", *SPARSE, *place, *without)

    def optional(self) -> list[str]:
        from rbtrg_robot.processes import PROCESSES

        return [p.name for p in PROCESSES if p.name not in (*OTHERS, "robot", "mission", "recorder")]

    def status(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.run("status", "--json"))
        return found

    def until(self, estop: bool) -> None:
        end = time.monotonic() + 20.0
        while self.status()["robot"].get("estop") is not estop:
            assert time.monotonic() < end, self.status()["robot"]
            time.sleep(0.1)

    def mission_until(self, words: str) -> None:
        end = time.monotonic() + 20.0
        while words not in (told := self.run("mission", "status")):
            assert time.monotonic() < end, told
            time.sleep(0.1)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    made = Robot(tmp_path)
    try:
        yield made
    finally:
        for process in psutil.process_iter(["cmdline"]):
            if str(tmp_path) in " ".join(process.info["cmdline"] or []):
                process.terminate()


def kept(folder: Path) -> set[str]:
    """Which of both is on the disk; a start reads them and nothing else."""
    return {path.suffix for path in (folder / "rbtrg").iterdir()} & {".estop", ".mission"}


def test_stop_and_mission_are_still_there_after_the_supervisor_was_killed(
    robot: Robot, tmp_path: Path
) -> None:
    mission = tmp_path / "m.yaml"
    mission.write_text("name: round\nsteps: [{wait: 0.1}, {ask: {question: 'open?'}}]\n")
    robot.up()
    robot.until(estop=False)
    robot.run("mission", "run", str(mission))
    robot.mission_until("open?")
    robot.run("stop")
    robot.until(estop=True)
    supervisor = psutil.Process(robot.status()["pid"])
    family = supervisor.children(recursive=True)
    supervisor.send_signal(signal.SIGKILL)
    _gone, alive = psutil.wait_procs([supervisor, *family], timeout=20.0)
    assert not alive, "nothing outlives it"
    assert kept(tmp_path) == {".estop", ".mission"}
    said = robot.up()
    assert "still latched" in said
    assert "a mission of before is paused" in said
    robot.until(estop=True)
    robot.mission_until("paused, step 2 of 2 (ask-2): the stack was restarted")
    robot.run("resume")
    robot.until(estop=False)
    robot.run("mission", "resume")
    robot.mission_until("open?")
    robot.run("mission", "stop")
    robot.run("down")
    assert kept(tmp_path) == set(), "the next start finds neither"


def test_a_latch_is_written_and_taken_back_and_a_broken_one_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    latch = LatchFile("a")
    assert latch.read() == b""
    latched = encode(msg.RobotState(estop=True, estop_cause="operator"))
    latch.follow(latched, latched=True)
    assert LatchFile("a").read() == latched
    assert LatchFile("b").read() == b""
    for payload in (b"\0\1\0\0", latched[:9], encode(msg.RobotState(estop=False))):
        (tmp_path / "rbtrg" / "a.estop").write_bytes(payload)
        assert decode(latch.read(), msg.RobotState).estop
    latch.follow(b"", latched=False)
    latch.follow(b"", latched=False)
    assert latch.read() == b""


def test_a_latch_that_cannot_be_written_ends_nothing_and_is_written_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    latch = LatchFile("a")
    latched = encode(msg.RobotState(estop=True, estop_cause="operator"))
    full = tmp_path / "rbtrg" / "a.new"
    full.mkdir()
    for _ in range(3):
        latch.follow(latched, latched=True)
    assert caplog.text.count("cannot be written") == 1
    full.rmdir()
    latch.follow(latched, latched=True)
    assert LatchFile("a").read() == latched
