"""One robot, one stack."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hal.unitree.config import UnitreeConfig
from rbtrg_robot.config import load
from rbtrg_robot.process import runfiles
from rbtrg_robot.process.runfiles import NoRoom, RobotTaken, RunLock, console_file, read_state, take_interface
from rbtrg_robot.process.supervisor import Supervisor


def test_two_stacks_on_one_interface_are_refused_and_the_death_of_one_frees_it() -> None:
    interface = f"test{os.getpid()}"
    script = (
        "import sys; from rbtrg_robot.process.runfiles import take_interface;"
        f"held = take_interface({interface!r}, 0); print('held', flush=True); sys.stdin.read()"
    )
    other = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(RobotTaken, match=interface):
            take_interface(interface, 0)
        take_interface(interface, 5).close()  # another DDS domain: another robot
        other.kill()
    finally:
        other.kill()
        other.communicate()
    take_interface(interface, 0).close()


def test_a_second_stack_that_names_the_domain_which_the_first_takes_by_default_is_refused() -> None:
    interface = f"test{os.getpid()}named"
    config = load(None, ["backend=unitree", f"interface={interface}", "unitree.domain=0"])
    second: Any = Supervisor(config, None, lambda _text: None)  # type: ignore[arg-type]
    first = UnitreeConfig().dds_domain(interface)
    with take_interface(interface, first), pytest.raises(RobotTaken, match=interface):
        second.run(lambda: True, lambda _status: None)


def test_a_run_folder_on_a_full_disk_ends_no_stack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    lock = RunLock("a")
    lock.write_state(ready=False)
    (tmp_path / "rbtrg" / "a.tmp").mkdir()  # what was to be written there fails
    lock.write_state(ready=True)
    assert "cannot be written" in caplog.text
    assert read_state("a")["ready"] is False
    lock.release()

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(runfiles.os, "write", full)
    with pytest.raises(NoRoom, match="No space left on device; make room"):
        RunLock("b")


def test_the_consoles_secret_ends_with_its_stack_however_that_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    console_file("a").write_text("of a stack that was killed")
    lock = RunLock("a")
    assert not console_file("a").exists()
    console_file("a").write_text("of this one")
    lock.release()
    assert not console_file("a").exists()
