"""The command line: bad input gives one line that says what to do, the right exit status, and no traceback."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
import typer
import yaml
from rich.console import Console
from typer.testing import CliRunner

from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.cli import logs, stack
from rbtrg_robot.cli.main import app, main
from rbtrg_robot.cli.table import Screen, render
from rbtrg_robot.config import load
from rbtrg_robot.log.read import CONFIG, first_of
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.process import doctor
from rbtrg_robot.process.runfiles import AlreadyRunning, NotRunning, RunLock, read_state
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.terminal import say
from rbtrg_robot.wire.messages import encode, header, time_msg
from tests.rbtrg_robot.conftest import Here
from tests.rbtrg_robot.strangers import until
from tools.bench.ports import free_port


def run(*arguments: str, tmp_path: Path, limit: float = 60.0) -> subprocess.CompletedProcess[str]:
    """The command in a runtime folder of its own."""
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path), "COLUMNS": "200"}
    environment = {k: v for k, v in environment.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        [sys.executable, "-m", "rbtrg_robot.cli", *arguments],
        capture_output=True,
        text=True,
        env=environment,
        timeout=limit,
        check=False,
    )


BAD = [
    (("up", "--scene", "moon"), "moon"),
    (("up", "--set", "nonsense.key=1"), "nonsense"),
    (("up", "--set", "port=12"), "port"),
    (("up", "--config", "/nowhere/c.yaml"), "/nowhere/c.yaml"),
    (("up", "--controller", "policy", "--policy", "/nowhere"), "/nowhere"),
    (("up", "--without", "coffee"), "coffee"),
    (("up", "--viewer"), "--render"),
    (("up", "--backend", "unitree", "--viewer"), "--backend sim"),
    (("up", "--set", "unitree.move_rate=500"), "unitree.move_rate"),
    (("posture", "sit"), "rbtrg-robot up"),
    (("up", "--map", "/nowhere/map.npz"), "/nowhere/map.npz"),
    (("up", "--log-dir", "/proc/nowhere"), "--log-dir"),
    (("status",), "rbtrg-robot up"),
    (("goal", "1", "2"), "rbtrg-robot up"),
    (("down",), "rbtrg-robot up"),
    (("replay", "/nowhere.mcap"), "/nowhere.mcap"),
    (("log", "info", "/nowhere.mcap"), "/nowhere.mcap"),
    (("topic", "hz", "/coffee"), "coffee"),
    (("scene", "show", "moon"), "moon"),
    (("report", "--log-dir", "/nowhere"), "no run lies in /nowhere"),
    (("report", "/nowhere"), "there is no folder /nowhere"),
    (("keys", "list", "--dir", "/nowhere"), "keys init"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD)
def test_bad_input_is_one_line_and_status_1(here: Here, arguments: tuple[str, ...], words: str) -> None:
    told(here(*arguments), words)


def test_bad_input_ends_a_process_of_its_own_likewise(tmp_path: Path) -> None:
    arguments, words = BAD[0]
    told(run(*arguments, tmp_path=tmp_path), words)


def told(done: subprocess.CompletedProcess[str], words: str) -> None:
    assert done.returncode == 1, done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("rbtrg-robot: ")
    assert words in lines[0]


def test_ctrl_c_during_the_imports_is_no_traceback() -> None:
    script = (
        "import sys;"
        "from rbtrg_robot.cli.entry import main\n"
        "class Pressed:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'rbtrg_robot.cli.main': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Pressed())\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_a_taken_port_is_told(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        done = run(
            "up", "--port", port, "--scene", "flat", "--log-dir", str(tmp_path / "l"), tmp_path=tmp_path
        )
    assert done.returncode == 1
    assert "--port" in done.stderr.strip().splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_rerun_takes_the_configuration_of_the_log_with_changes(here: Here, tmp_path: Path) -> None:
    path = tmp_path / "log_0.mcap"
    with LogWriter(path, {}, {CONFIG: b"scene: flat\ntracker: {max_speed: 0.4, old_key: 1}\n"}) as writer:
        for stamp in range(0, NS, NS // 10):
            writer.write(t.CLOCK, encode(t.CLOCK.kind(clock=time_msg(stamp))), stamp, stamp, 1)
        writer.write(t.PATH_COMMAND, encode(t.PATH_COMMAND.kind()), NS, NS, 1)
    out = tmp_path / "new.mcap"
    order = ("replay", str(path), "--rerun", "tracker", "--out", str(out), "--set")
    wrong = here(*order, "tracker.max_sped=1")
    assert wrong.returncode == 1
    assert "tracker.max_sped" in wrong.stderr.splitlines()[-1]
    assert not out.exists()
    done = here(*order, "tracker.goal_tolerance=0.07")
    assert done.returncode == 0, done.stderr
    assert "tracker.old_key" in done.stdout
    used = yaml.safe_load(first_of(out).attachments[CONFIG])
    assert used["scene"] == "flat"
    assert (used["tracker"]["max_speed"], used["tracker"]["goal_tolerance"]) == (0.4, 0.07)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_progress_bar_is_on_a_terminal_alone_and_leaves_words_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", Terminal())
    shown = {}
    for kind in (io.StringIO, Terminal):
        monkeypatch.setattr(sys, "stdout", kind())
        stdout = sys.stdout
        with logs._bar() as bar:
            task = bar.add_task("rerun", total=9)
            for number in range(9):
                bar.update(task, completed=number)
                bar.refresh()
                say(f"[red]word[/red] {number}")
        shown[kind] = stdout.getvalue()  # type: ignore[attr-defined]
    words = [f"[red]word[/red] {number}" for number in range(9)]
    assert shown[io.StringIO].splitlines() == words
    lines = re.split(r"[\r\n]+", re.sub(r"\x1b\[[?\d;]*[A-Za-z]", "", shown[Terminal]))
    assert [line for line in lines if "word" in line] == words
    assert any(line.startswith("rerun") for line in lines)


def test_a_fault_of_the_program_is_one_line_and_its_traceback_a_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken() -> None:
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("rbtrg_robot.cli.main.app", broken)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "ZeroDivisionError" in line
    kept = Path(line.split()[-1])
    assert "in broken" in kept.read_text()
    kept.unlink()


def test_a_truncated_log_plays_and_says_so(here: Here, tmp_path: Path) -> None:
    path = tmp_path / "log_0.mcap"
    with LogWriter(path, {}) as writer:
        for i in range(2000):
            stamp = i * 1_000_000
            data = encode(t.IMU.kind(header=header(stamp, "base_link")))
            writer.write(t.IMU, data, stamp, stamp, i + 1)
            if i % 100 == 0:
                writer.flush()
        command = encode(t.CMD_VEL.kind())
        writer.write(t.CMD_VEL, command, 1_999_000_000, 0, 1)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    check = here("log", "check", str(path))
    assert check.returncode == 1
    assert "recover" in check.stdout
    info = json.loads(here("log", "info", str(path), "--json").stdout)
    count = info["topics"]["/imu/data"]["count"]
    assert 500 < count < 2000
    fixed = here("log", "recover", str(path))
    assert fixed.returncode == 0
    assert here("log", "check", str(tmp_path / "log_0.recovered.mcap")).stdout == "no problems found\n"
    port = str(free_port())
    played = run("replay", str(path), "--rate", "4", "--port", port, tmp_path=tmp_path)
    assert played.returncode == 0, played.stderr
    assert f"replayed {count} messages" in played.stdout


def test_replay_never_publishes_what_moves_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "log_0.mcap"
    with LogWriter(path, {}) as writer:
        for topic in (t.CMD_VEL, t.GOAL_REQUEST, t.GOAL_POSE, t.ROBOT_COMMAND, t.PATH_COMMAND, t.ODOM):
            writer.write(topic, encode(topic.kind()), 1, 1, 1)
    played = run("replay", str(path), "--port", str(free_port()), tmp_path=tmp_path)
    assert "replayed 1 messages" in played.stdout
    for name in ("/cmd_vel", "/goal/request", "/goal_pose", "/robot/command", "/track/path"):
        assert f"not replayed: 1 x {name}" in played.stdout


def test_config_show_and_schema(here: Here) -> None:
    shown = here("config", "show", "--set", "tracker.max_speed=0.3")
    assert "max_speed: 0.3" in shown.stdout
    schema = json.loads(here("config", "schema").stdout)
    assert schema["additionalProperties"] is False


def test_what_is_listed_is_listed_for_programs_too(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finding = doctor.Finding("port", doctor.Level.FAULT, "taken")
    monkeypatch.setattr(doctor, "examine", lambda _port: iter([finding]))
    done = here("doctor", "--json")
    assert json.loads(done.stdout) == [{"what": "port", "level": "fault", "words": "taken"}]
    assert done.returncode == 1
    shown = json.loads(here("config", "show", "--set", "tracker.max_speed=0.3", "--json").stdout)
    assert shown["tracker"]["max_speed"] == 0.3
    assert "flat" in [scene["name"] for scene in json.loads(here("scene", "list", "--json").stdout)]
    (tmp_path / "runs" / "one").mkdir(parents=True)
    (tmp_path / "runs" / "one" / "config.yaml").touch()
    found = json.loads(here("log", "list", str(tmp_path / "runs"), "--json").stdout)
    assert [(run["folder"], run["kept"]) for run in found] == [(str(tmp_path / "runs" / "one"), False)]


def test_a_shell_completes_commands() -> None:
    asked = {
        "_RBTRG_ROBOT_COMPLETE": "complete_bash",
        "COMP_WORDS": "rbtrg-robot mission r",
        "COMP_CWORD": "2",
    }
    done = CliRunner().invoke(app, [], env=asked, prog_name="rbtrg-robot")
    assert done.output.split() == ["run", "resume", "record"]


def test_scene_show_gives_goals_and_a_picture(here: Here, tmp_path: Path) -> None:
    picture = tmp_path / "yard.png"
    done = here("scene", "show", "yard", "--json", "--png", str(picture))
    record = json.loads(done.stdout)
    assert {"platform", "behind_wall", "home"} <= set(record["goals"])
    assert picture.read_bytes()[:4] == b"\x89PNG"


def test_one_stack_per_robot_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(NotRunning):
        read_state("r")
    lock = RunLock("r")
    lock.write_state(endpoint="tcp/127.0.0.1:1", domain=0, ready=True)
    with pytest.raises(AlreadyRunning, match=str(os.getpid())):
        RunLock("r")
    assert read_state("r")["ready"] is True
    RunLock("other").release()
    lock.release()
    with pytest.raises(NotRunning):
        read_state("r")


def test_detached_it_waits_for_the_robot_it_started_wherever_that_is_named(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("robot: alpha\n")
    arguments = ["up", "--detach", "--scene", "flat", "--no-record", "--port", str(free_port())]
    arguments += ["--config", str(tmp_path / "c.yaml")]
    arguments += [f"--without={p.name}" for p in PROCESSES] + ["--log-dir", str(tmp_path / "logs")]
    try:
        up = run(*arguments, tmp_path=tmp_path)
        assert up.returncode == 0, up.stderr
        assert "rbtrg-robot down --robot alpha" in up.stdout
    finally:
        down = run("down", "--robot", "alpha", tmp_path=tmp_path)
    assert down.returncode == 0, down.stderr


@pytest.mark.parametrize(
    "ended_by", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.campaign)]
)
def test_a_stack_that_is_not_ready_yet_ends_with_the_command_that_began_it(
    tmp_path: Path, ended_by: signal.Signals
) -> None:
    arguments = ["up", "--detach", "--scene", "flat", "--no-record", "--port", str(free_port())]
    begun = subprocess.Popen(
        [sys.executable, "-m", "rbtrg_robot.cli", *arguments, "--log-dir", str(tmp_path / "logs")],
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    caller = psutil.Process(begun.pid)
    children: list[psutil.Process] = []
    try:
        until(lambda: bool(children.extend(caller.children()) or children))  # it began a stack
        begun.send_signal(ended_by)
        assert begun.wait(20.0) != 0
        _, left = psutil.wait_procs(children, timeout=20.0)
        assert not left
    finally:
        for process in (caller, *children):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()


def test_a_disk_that_takes_no_configuration_keeps_no_robot_from_starting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "config.yaml").symlink_to("/dev/full")
    stack._write_config(tmp_path, load())
    assert "No space left on device; make room" in capsys.readouterr().err


def test_a_terminal_shows_how_far_the_kernels_are_and_no_topic_that_has_not_begun() -> None:
    rows = [
        {"topic": f"/{ok}", "rate": 0.0, "nominal": 10.0, "age": None, "ok": ok} for ok in (True, False, None)
    ]
    status = {
        "processes": [],
        "topics": rows,
        "robot": {},
        "refused": 0,
        "compiling": "compiling kernels: 41 of 235",
        "lacks": "planner has not started",
    }

    def shown(**more: bool) -> str:
        console = Console(file=io.StringIO(), width=120)
        console.print(render(status, **more))
        return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]

    assert shown().splitlines()[0] == "compiling kernels: 41 of 235; not ready: planner has not started"
    assert "/False" in shown()
    assert "/None" not in shown()
    assert re.search(r"/None .* -$", shown(topics=True), re.MULTILINE), (
        "asked for, it is there and not called bad"
    )


def test_what_a_start_waits_for_is_told_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    screen = Screen()
    for now in range(1, 50):
        compiling = f"compiling kernels: {now} of 40" if 3 < now < 40 else ""
        screen.show({"compiling": compiling, "lacks": "the robot is damped" if now > 20 else ""})
    assert capsys.readouterr().out.splitlines() == [
        "compiling kernels: 15 of 40",
        "compiling kernels: 30 of 40; not ready: the robot is damped",
        "not ready: the robot is damped",
    ]


def test_detached_it_ends_with_the_cause_where_a_running_stack_does_not_get_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now, waited = 0.0, 0

    def state_of(_pid: int) -> dict[str, Any]:
        return {"ready": False, "stalled": "" if now < 600.0 else "no sweeps"}

    def wait(limit: float) -> None:
        nonlocal now, waited
        now, waited = now + limit, waited + 1
        raise subprocess.TimeoutExpired("up", limit)

    (tmp_path / "up.log").write_text("compiling\n")
    monkeypatch.setattr("time.monotonic", lambda: now)
    monkeypatch.setattr("rbtrg_robot.process.runfiles.state_of", state_of)
    child: Any = SimpleNamespace(pid=1, poll=lambda: None, wait=wait)
    with pytest.raises(typer.Exit) as ended:
        stack._wait_ready(child, tmp_path / "up.log")
    assert ended.value.exit_code == 1
    assert now == pytest.approx(600.0 + stack.STALL_LIMIT, abs=1.0)
    told = capsys.readouterr()
    assert told.out == "compiling\n"
    assert told.err == f"rbtrg-robot: not ready after {stack.STALL_LIMIT:.0f} s, ended: no sweeps\n"


def test_words_that_nobody_takes_end_no_stack(monkeypatch: pytest.MonkeyPatch) -> None:
    with io.TextIOWrapper(io.FileIO("/dev/full", "w"), write_through=True) as full:
        monkeypatch.setattr(sys, "stdout", full)
        with Screen() as screen:
            screen.say("a process ended")
        screen.say("down")
