"""Names and words of others in every command that prints them: no control character reaches the terminal."""

from __future__ import annotations

import io
import json
import unicodedata
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import pytest
import yaml
from mcap.records import Channel, Schema
from rich.console import Console

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli import table
from rbtrg_robot.log.read import CONFIG, Entry
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.process import doctor
from rbtrg_robot.process.events import Events
from rbtrg_robot.process.health import Health
from rbtrg_robot.wire.messages import encode
from tests.rbtrg_robot.conftest import Here
from tools.bench.ports import free_port

NASTY = "\x1b[2J\x1b]0;owned\x07\x9b1m\u202eevil\r\nrbtrg-robot: fine[/x]"
"""Clears the screen, names the window, turns words round, makes a line of its own, and is no markup of rich."""
FILE = NASTY.replace("/", "")


def clean(said: str, *, shown: bool = True) -> None:
    """No line has a control character or one that turns words round; the words are there all the same."""
    for line in said.split("\n"):
        assert not [c for c in line if unicodedata.category(c) in ("Cc", "Cf", "Zl", "Zp")], repr(line)
        assert not line.startswith("rbtrg-robot: fine")
    assert ("evil" in said) is shown, said


class FakeBus:
    """Answers with what it was given, for ever."""

    def __init__(self, messages: Iterable[tuple[t.Topic[Any], msg.Message]], answer: Any = None) -> None:
        self._messages = [SimpleNamespace(topic=topic, message=message) for topic, message in messages]
        self._answer = answer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def take(self, _timeout: float) -> list[Any]:
        return self._messages

    def open(self, received: Any) -> Any:
        return received.message

    def ask(self, _name: str) -> bytes:
        return json.dumps(self._answer).encode()

    def nothing(self, *_: object) -> None:
        pass

    subscribe = advertise = publish = nothing


Stack = Callable[..., None]


@pytest.fixture
def stack(monkeypatch: pytest.MonkeyPatch) -> Stack:
    """A stack that says this."""

    def up(*messages: tuple[t.Topic[Any], msg.Message], answer: Any = None) -> None:
        monkeypatch.setattr("rbtrg_robot.cli.link.connect", lambda _robot: FakeBus(messages, answer))
        monkeypatch.setattr("rbtrg_robot.cli.link.scene", lambda _robot: ("", {}))

    return up


def nasty_mission() -> msg.MissionState:
    return msg.MissionState(
        order_id="o",
        name=NASTY,
        phase="waiting",
        reason=NASTY,
        question=NASTY,
        choices=[NASTY],
        step=1,
        action_id=[NASTY],
        action_type=[NASTY],
        action_status=[NASTY],
        result_description=[NASTY],
    )


def nasty_status() -> dict[str, Any]:
    health = Health(True)
    health.take(
        t.ROBOT_STATE,
        msg.RobotState(phase=NASTY, cause=NASTY, estop=True, estop_cause=NASTY, realtime_factor=1.0),
    )
    health.take(t.GOAL_STATUS, msg.GoalStatus(id="g", state=NASTY, reason=NASTY, detail=NASTY))
    health.take(t.MISSION_STATE, nasty_mission())
    row = {"process": NASTY, "pid": 1, "state": NASTY, "restarts": 0, "cpu": 0.0, "memory_mb": 0.0}
    row |= {"heartbeat_age": None, "detail": NASTY, "refused": 1}
    topic = {"topic": NASTY, "rate": 1.0, "nominal": 1.0, "age": None, "ok": False}
    robot = health.robot_row() | {"backend": {NASTY: NASTY}, "location": NASTY}
    return {"processes": [row], "topics": [topic], "robot": robot, "refused": 1}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A run with a topic, a type, metadata and a message that nobody here wrote; its name is no better."""
    folder = tmp_path / "logs" / FILE
    with LogWriter(folder / "log_0.mcap", {NASTY: NASTY}, {CONFIG: b"seed: 3\n"}) as writer:
        writer.write(t.GOAL_STATUS, encode(msg.GoalStatus(id=NASTY, state=NASTY)), 1, 1, 1)
        entry = Entry(NASTY, NASTY, b"", 1, 1, 1)
        writer.copy(entry, Schema(1, b"", "ros2msg", NASTY), Channel(1, NASTY, "cdr", {}, 1))
    (folder / "log_1.mcap").write_bytes((folder / "log_0.mcap").read_bytes()[:-40])
    (folder / CONFIG).write_text("seed: 3\n")
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ("log", "info"), ("log", "info", "--json"), ("log", "check", "--json"), ("log", "keep"), ("log", "recover"),
        ("topic", "list", "--log"), ("topic", "echo", "/goal/status", "--log"), ("topic", "hz", "/odom", "--log"),
    ],
)  # fmt: skip
def test_logs(here: Here, log: Path, words: tuple[str, ...]) -> None:
    ended = here(*words, str(log if words[1] != "recover" else log / "log_0.mcap"))
    clean(ended.stdout + ended.stderr)


def test_each_problem_of_a_log_has_a_line(here: Here, log: Path) -> None:
    (log / "log_2.mcap").write_bytes((log / "log_1.mcap").read_bytes())
    problems = json.loads(here("log", "check", str(log), "--json").stdout)["problems"]
    assert len(here("log", "check", str(log)).stdout.splitlines()) == len(problems) > 1


def test_replay_names_what_it_leaves_out(here: Here, log: Path) -> None:
    clean(here("replay", str(log), "--port", str(free_port())).stdout)


def test_list_of_runs_and_report(
    here: Here, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clean(here("log", "list", str(log.parent)).stdout)
    monkeypatch.setattr(doctor, "examine", lambda _port: [])
    monkeypatch.setattr("rbtrg_robot.process.report.examine", lambda _port: [])
    clean(here("report", str(log / "nowhere"), "--out", str(tmp_path / "r.tar.gz")).stderr)
    clean(here("report", str(log), "--out", str(tmp_path / f"{FILE}.tar.gz")).stdout)


def test_missions(here: Here, stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / f"{FILE}.yaml"
    steps = [
        {"goto": {"x": 1.0, "y": 2.0}, "name": NASTY},
        {"ask": {"question": NASTY, "choices": ["a", NASTY]}},
    ]
    file.write_text(yaml.safe_dump({"name": NASTY, "steps": steps}))
    said = here("mission", "run", str(file), "--check")
    clean(said.stdout + said.stderr)
    file.write_text(yaml.safe_dump({NASTY: NASTY, "steps": []}))
    clean(here("mission", "run", str(file), "--check").stderr)
    said = here("mission", "convert", str(file.with_suffix(".geojson")), str(tmp_path / "a.yaml"))
    clean(said.stderr)
    stack((t.MISSION_STATE, nasty_mission()))
    for words in (("status",), ("status", "--json")):
        clean(here("mission", *words).stdout)


def test_status(here: Here, stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    stack(answer=nasty_status())
    for words in ((), ("--json",)):
        clean(here("status", *words).stdout)
    monkeypatch.setattr("rbtrg_robot.process.fleet.statuses", lambda: {NASTY: nasty_status(), "b": None})
    clean(here("status", "--all").stdout)


def test_what_up_says(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    screen = table.Screen()
    Events(screen.say).take(t.GOAL_STATUS, msg.GoalStatus(id="g", state="aborted", detail=NASTY, reason="x"))
    clean(capsys.readouterr().out)
    terminal = io.StringIO()
    monkeypatch.setattr(table, "Console", lambda: Console(file=terminal, force_terminal=True, no_color=True))
    screen = table.Screen()
    screen.say(NASTY)  # `[/x]` closes no markup: this ended the supervisor
    assert "\x1b[2J" not in terminal.getvalue()
    assert "\\x1b[2J" in terminal.getvalue()


def test_orders(here: Here, stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rbtrg_robot.cli.drive.uuid.uuid4", lambda: SimpleNamespace(hex="g" * 32))
    ended = msg.GoalStatus(id="g" * 12, state="rejected", reason="outside_area", detail=NASTY)
    stack((t.GOAL_STATUS, ended))
    said = here("goal", "1", "2", "--wait")
    clean(said.stdout + said.stderr)
    stack((t.ROBOT_STATE, msg.RobotState(phase="fault", cause=NASTY)))
    said = here("posture", "recover", "--timeout", "0.1")
    clean(said.stdout + said.stderr)
    stack((t.GOAL_STATUS, ended))
    clean(here("topic", "echo", "/goal/status", "-n", "1").stdout)


def test_scenes_configurations_and_the_computer(
    here: Here, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    height = np.zeros((60, 60), np.float32)
    np.savez(tmp_path / f"{FILE}.npz", height=height, resolution=0.1, origin=(0.0, 0.0))
    for words in ((), ("--json",)):
        clean(here("scene", "show", str(tmp_path / f"{FILE}.npz"), *words).stdout)
    clean(here("scene", "show", str(tmp_path / f"no{FILE}.npz")).stderr)
    config = tmp_path / "c.yaml"
    config.write_text(yaml.safe_dump({NASTY: NASTY}))
    clean(here("config", "show", "--config", str(config)).stderr)
    clean(here("up", "--map", str(tmp_path / f"no{FILE}.npz")).stderr)
    finding = doctor.Finding(NASTY, doctor.Level.NOTE, NASTY)
    monkeypatch.setattr(doctor, "examine", lambda _port: [finding])
    clean(here("doctor").stdout)
