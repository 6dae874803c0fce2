"""`status --all`: every robot of this computer, whatever state it is in."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.main import app
from rbtrg_robot.cli.table import mission_line
from rbtrg_robot.process.health import Health
from rbtrg_robot.process.runfiles import NotRunning, RunLock
from rbtrg_robot.scope import Scope
from rbtrg_robot.wire.bus import Bus
from tools.bench.ports import free_port


def robot_row(**mission: Any) -> dict[str, Any]:
    health = Health(True)
    long = "standing; the last order was to stand up, and it came from somebody at the robot"
    health.take(t.ROBOT_STATE, msg.RobotState(phase="ready", cause=long, realtime_factor=1.0))
    fields = {"order_id": "o", "name": "round", "phase": "running", "step": 2, "action_id": ["a", "b", "c"]}
    health.take(t.MISSION_STATE, msg.MissionState(**(fields | mission)))
    return health.robot_row()


@pytest.fixture
def two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Stack `a` answers; of `b` the lock is held, but nobody listens."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    ports = []
    for _ in range(2):
        ports.append(free_port())
    process = {"process": "robot", "pid": 1, "state": "ready", "restarts": 0}
    answer = json.dumps({"processes": [process], "robot": robot_row()}).encode()
    with ExitStack() as held:
        for name, port in zip("ab", ports, strict=True):
            lock = RunLock(name)
            held.callback(lock.release)
            lock.write_state(endpoint=f"tcp/127.0.0.1:{port}", domain=0, ready=True, backend="sim", scene="")
        bus = held.enter_context(
            Bus(f"tcp/127.0.0.1:{ports[0]}", "supervisor", Scope.of(0, "a"), router=True)
        )
        bus.serve("status", lambda reply: reply(answer))
        yield


def test_all_robots_are_shown_the_silent_one_too(two: None) -> None:
    result = CliRunner().invoke(app, ["status", "--all", "--json"], catch_exceptions=False)
    found = json.loads(result.stdout)
    assert set(found) == {"a", "b"}
    assert found["b"] is None
    assert found["a"]["robot"]["mission"]["step"] == 2
    shown = CliRunner().invoke(app, ["status", "--all"], catch_exceptions=False).output
    assert "1/1 ready" in shown
    assert "somebody at the robot), real-time factor 1.00" in shown  # no line is broken in a pipe
    assert "mission round: running, step 2 of 3" in shown
    assert "does not answer" in shown


def test_without_a_stack_there_is_nothing_to_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(NotRunning, match="no stack is running"):
        CliRunner().invoke(app, ["status", "--all"], catch_exceptions=False)


def test_the_mission_is_one_line() -> None:
    assert mission_line({}) == ""
    assert mission_line(robot_row(question="open?")) == "mission round: running, step 2 of 3: open?"
    assert mission_line(robot_row(phase="finished")) == "mission round: finished"
