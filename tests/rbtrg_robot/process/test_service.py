"""What systemd is told, and the unit file it is given."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.main import app
from rbtrg_robot.cli.stack import _supervise
from rbtrg_robot.config import load
from rbtrg_robot.process import service
from rbtrg_robot.process.child import FATAL
from rbtrg_robot.process.notify import Notifier
from rbtrg_robot.process.supervisor import StartFailed, Supervisor
from rbtrg_robot.processes import PROCESSES
from tests.rbtrg_robot.process.test_broken_messages import Inbox, supervisor
from tests.rbtrg_robot.process.test_supervisor import Scripted, mend, supervised
from tools.bench.ports import free_port

__all__ = ["supervisor"]


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The socket on which systemd listens."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "4000000")
        monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
        yield listening


def heard(manager: socket.socket) -> list[str]:
    words = []
    while True:
        try:
            words.append(manager.recv(4096).decode())
        except BlockingIOError:
            return words


def test_the_loop_tells_that_it_lives_and_what_it_knows(
    manager: socket.socket, request: pytest.FixtureRequest
) -> None:
    stack = request.getfixturevalue("supervisor")
    stack._say = stack._write_state = lambda *_: None
    stack._turn(None)
    assert heard(manager) == ["WATCHDOG=1", "STATUS=starting"]
    stack._missing = lambda: ""
    for child in stack._children.values():
        child.forked = Alive()
    stack._bus.put(t.ROBOT_STATE, b"")
    stack._health.take(t.ROBOT_STATE, msg.RobotState(phase="ready"))
    stack._turn(None)
    assert heard(manager) == ["READY=1", "STATUS=ready; robot ready"]
    stack._turn(None)
    assert heard(manager) == []
    stack._notifier._due = 0.0
    stack._turn(None)
    assert heard(manager) == ["WATCHDOG=1"]
    assert isinstance(stack._bus, Inbox)


class Alive:
    pid = 0

    def poll(self) -> None:
        return None


def test_signs_of_life_come_four_times_in_the_limit_and_only_from_the_process_that_is_watched() -> None:
    assert Notifier({"WATCHDOG_USEC": "8000000"}).period == 2.0
    assert Notifier({"WATCHDOG_USEC": "8000000", "WATCHDOG_PID": "1"}).period == 0.0
    assert Notifier({}).period == 0.0


def test_a_manager_that_is_gone_or_busy_does_not_end_the_stack(
    manager: socket.socket, tmp_path: Path
) -> None:
    notifier = Notifier()
    for number in range(10_000):  # nobody reads: the socket is full long before
        notifier.status(str(number))
    assert 0 < len(heard(manager)) < 10_000
    (tmp_path / "notify").unlink()
    notifier.stopping()


def test_an_abstract_socket_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind("")  # the kernel chooses an abstract name
        name = listening.getsockname()
        monkeypatch.setenv("NOTIFY_SOCKET", f"@{name[1:].decode()}")
        Notifier().ready()
        assert listening.recv(64) == b"READY=1"


def test_a_process_that_was_given_up_is_told_at_the_end(tmp_path: Path) -> None:
    stack, _zygote, _said = supervised(tmp_path, [(FATAL, "there is no scene 'yrad'")])
    stack._ready = True
    assert stack.given_up == []
    for _ in range(3):
        mend(stack)
    assert stack.given_up == ["robot"]
    assert stack._summary() == "ready; gave up: robot"


def test_a_start_that_fails_is_never_called_ready_and_its_end_is_told(
    manager: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    zygote = Scripted([(FATAL, "there is no scene 'yrad'")])
    others = tuple(p.name for p in PROCESSES if p.name != "robot")
    config = load(without=others, record=False, log_dir=str(tmp_path), port=free_port())
    stack = Supervisor(config, zygote, lambda _text: None)  # type: ignore[arg-type]
    with pytest.raises(StartFailed):
        stack.run(lambda: False, lambda _status: None)
    told = heard(manager)
    assert "READY=1" not in told
    assert told[-1] == "STOPPING=1"


def test_a_supervisor_that_is_stopped_gives_no_sign_of_life(manager: socket.socket) -> None:
    """Its signs come from the loop that is watched, from no thread or timer."""
    loop = (
        "import sys\nfrom rbtrg_robot.process.notify import Notifier\nn = Notifier()\nwhile True: n.alive()"
    )
    environment = {**os.environ, "WATCHDOG_USEC": "40000"}
    del environment["WATCHDOG_PID"]
    manager.settimeout(10.0)
    with subprocess.Popen([sys.executable, "-c", loop], env=environment) as process:
        try:
            assert manager.recv(64) == b"WATCHDOG=1"
            process.send_signal(signal.SIGSTOP)
            os.waitpid(process.pid, os.WUNTRACED)
            manager.setblocking(False)
            heard(manager)
            manager.settimeout(0.2)
            with pytest.raises(TimeoutError):
                manager.recv(64)
            process.send_signal(signal.SIGCONT)
            manager.settimeout(10.0)
            assert manager.recv(64) == b"WATCHDOG=1"
        finally:
            process.kill()


@pytest.mark.parametrize(("given_up", "status"), [([], 0), (["planner"], FATAL)])
def test_the_exit_status_tells_that_a_process_was_given_up(
    monkeypatch: pytest.MonkeyPatch, given_up: list[str], status: int
) -> None:
    class Ended:
        def __init__(self, *_arguments: object) -> None:
            self.given_up = given_up

        def run(self, *_arguments: object) -> None:
            pass

    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr("rbtrg_robot.process.supervisor.Supervisor", Ended)
    assert _supervise(load(), None) == status  # type: ignore[arg-type]


def test_the_latch_outlives_the_service_and_its_end_leaves_time_to_stop_the_robot() -> None:
    lines = service.unit("go2w", [], user=False).splitlines()
    assert "RuntimeDirectoryPreserve=yes" in lines, (
        "systemd removes the folder of the latch when the service ends"
    )
    # The signal of the watchdog goes to all processes of the service: the robot process must be able to take it.
    assert "KillMode=control-group" in lines
    assert "WatchdogSignal=SIGTERM" in lines
    assert "WatchdogSec=30" in lines
    assert "OOMPolicy=continue" in lines


@pytest.mark.parametrize("user", [False, True])
def test_the_unit_file_is_one_that_systemd_takes(tmp_path: Path, user: bool) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    text = service.unit("go2w", ["--set", "log=100% of $HOME"], user=user)
    file = tmp_path / "rbtrg-robot-go2w.service"
    file.write_text(text)
    (tmp_path / "runtime").mkdir()
    manager = ["--user"] if user else ["--system"]
    done = subprocess.run(
        [analyze, *manager, "--man=no", "verify", str(file)],
        capture_output=True, text=True, timeout=60, check=False,
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path / "runtime")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert file.name not in done.stderr  # no key is unknown, no value refused


def test_install_writes_the_unit_with_this_executable_and_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    config = tmp_path / "my robot.yaml"
    config.write_text("backend: unitree\ninterface: eth0\nrobot: rex\n")
    done = CliRunner().invoke(app, ["service", "install", "--user", "--config", str(config)])
    assert done.exit_code == 0, done.output
    text = (tmp_path / "systemd/user/rbtrg-robot-rex.service").read_text()
    up = f'ExecStart={sys.executable} -m rbtrg_robot.cli up --config "{config}" --log-dir %L/rbtrg-robot-rex'
    assert up in text.splitlines()
    assert "systemctl --user enable --now rbtrg-robot-rex" in done.output
    shown = CliRunner().invoke(app, ["service", "show", "--user", "--robot", "rex"])
    assert shown.output.endswith(text)
    monkeypatch.setenv("RBTRG_ROBOT", "max")  # install and show mean the same robot
    CliRunner().invoke(app, ["service", "install", "--user", "--config", str(config)])
    shown = CliRunner().invoke(app, ["service", "show", "--user"])
    assert f'up --config "{config}" --robot max --log-dir %L/rbtrg-robot-max' in shown.output


def test_install_dry_run_writes_nothing_and_a_wrong_configuration_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    done = CliRunner().invoke(app, ["service", "install", "--user", "--dry-run"])
    assert done.output == service.unit("go2w", [], user=True)
    refused = CliRunner().invoke(app, ["service", "install", "--user", "--set", "bakend=unitree"])
    assert refused.exit_code != 0
    assert list(tmp_path.iterdir()) == []
    missing = CliRunner().invoke(app, ["service", "show", "--user"])
    assert isinstance(missing.exception, service.ServiceError)


def test_words_of_a_command_line_reach_the_program_as_they_are() -> None:
    assert service.quoted("plain/word") == "plain/word"
    assert service.quoted("two words") == '"two words"'
    assert service.quoted('100% of "$HOME"') == '"100%% of \\"$$HOME\\""'
    assert service.unit("go2w", [], user=False).count(load().robot) > 0
