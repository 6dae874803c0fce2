"""`down` beside a supervisor that does not do as it is told: everything ends all the same, and the operator hears of
it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from rbtrg_robot.cli import stack
from rbtrg_robot.cli.stop import _is_up

SUPERVISOR = """
import signal, subprocess, sys
from rbtrg_robot.process.runfiles import RunLock
from rbtrg_robot.process.zygote import PR_SET_PDEATHSIG, prctl
lock = RunLock("go2w")
if sys.argv[1] == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
else:
    signal.signal(signal.SIGTERM, lambda *_: (child.kill(), sys.exit()))
child = subprocess.Popen(["sleep", "100"], preexec_fn=lambda: prctl(PR_SET_PDEATHSIG, signal.SIGKILL))
lock.write_state(robot="go2w")
print(child.pid, flush=True)
while True:
    signal.pause()
"""
Up = Callable[[str], tuple[psutil.Process, psutil.Process]]


@pytest.fixture
def up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Up]:
    """Starts a process that holds the lock of a stack, and one that ends with it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    started: list[subprocess.Popen[str]] = []

    def start(kind: str) -> tuple[psutil.Process, psutil.Process]:
        made = subprocess.Popen([sys.executable, "-c", SUPERVISOR, kind], stdout=subprocess.PIPE, text=True)
        started.append(made)
        assert made.stdout is not None
        return psutil.Process(made.pid), psutil.Process(int(made.stdout.readline()))

    yield start
    for made in started:
        made.kill()
        made.wait()


def test_one_that_is_stopped_goes_on_and_ends_in_order(up: Up, capsys: pytest.CaptureFixture[str]) -> None:
    supervisor, child = up("obedient")
    supervisor.suspend()
    assert _is_up("go2w")
    stack.down("go2w")
    told = capsys.readouterr()
    assert (told.out, told.err) == ("down\n", "")
    assert not psutil.wait_procs([child], timeout=30.0)[1]
    assert not _is_up("go2w")


def test_one_that_hangs_is_killed_and_the_others_with_it(
    up: Up, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stack, "DOWN_LIMIT", 0.2)
    supervisor, child = up("deaf")
    child.suspend()
    stack.down("go2w")
    told = capsys.readouterr()
    assert told.out == "down\n"
    assert f"pid {supervisor.pid}) hung and was killed" in told.err
    assert not child.is_running() or child.status() == psutil.STATUS_ZOMBIE
    assert not _is_up("go2w")
