"""Processes forked by the zygote are children of the caller, and report how they ended."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import psutil
import pytest

from rbtrg_robot.config import StackConfig
from rbtrg_robot.process.child import FATAL, PASSING
from rbtrg_robot.process.zygote import ONE_THREAD, PR_SET_PDEATHSIG, Forked, Zygote, _settle, serve
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.wire.bus import Bus
from tools.bench.ports import free_port


@pytest.fixture(scope="module")
def zygote() -> Iterator[Zygote]:
    with Zygote() as made:
        yield made


def tracker(process: str = "tracker", **config: Any) -> dict[str, Any]:
    """A specification."""
    return {
        "process": process,
        "config": {**StackConfig().model_dump(mode="json"), **config},
        "restored": {},
        "hurry": False,
        "clock": 0,
        "stack": "",
    }


def stopped(zygote: Zygote, log: Path) -> Forked:
    """A process that stays as it is."""
    forked = zygote.fork(tracker(), log)
    os.kill(forked.pid, signal.SIGSTOP)
    return forked


def test_exit_status_and_last_words_arrive(zygote: Zygote, tmp_path: Path) -> None:
    log = tmp_path / "tracker.log"
    forked = zygote.fork(tracker(bogus=1), log)
    assert forked.wait(60.0) == FATAL
    assert forked.poll() == FATAL
    assert log.read_text().startswith("error: ")
    assert log.stat().st_mode & 0o077 == 0, "the user's alone"


def test_whether_a_restart_may_help_is_told_by_the_exit_status(zygote: Zygote, tmp_path: Path) -> None:
    port = free_port()
    alone = zygote.fork(tracker(port=port), tmp_path / "alone.log")
    assert alone.wait(60.0) == PASSING
    assert "nothing answers" in (tmp_path / "alone.log").read_text().splitlines()[-1]
    with Bus(f"tcp/127.0.0.1:{port}", "test", router=True):
        wrong = tracker("robot", port=port, backend="unitree", interface="none0", network={"open_bus": True})
        robot = zygote.fork(wrong, tmp_path / "robot.log")
        assert robot.wait(60.0) == FATAL
    assert "'none0' does not exist" in (tmp_path / "robot.log").read_text().splitlines()[-1]


def test_a_killed_process_reports_the_signal(zygote: Zygote, tmp_path: Path) -> None:
    forked = stopped(zygote, tmp_path / "tracker.log")
    assert psutil.Process(forked.pid).ppid() == os.getpid()
    assert os.getpgid(forked.pid) == forked.pid
    with pytest.raises(subprocess.TimeoutExpired):
        forked.wait(0.0)
    forked.kill()
    assert forked.wait(10.0) == -signal.SIGKILL
    forked.terminate()  # of an ended process: nothing


def test_a_killed_zygote_is_replaced_and_its_processes_live_on(zygote: Zygote, tmp_path: Path) -> None:
    first = stopped(zygote, tmp_path / "first.log")
    killed = zygote.pid
    os.kill(killed, signal.SIGKILL)
    assert first.poll() is None
    second = zygote.fork(tracker(bogus=1), tmp_path / "second.log")
    assert second.wait(60.0) == FATAL
    assert zygote.pid != killed
    assert first.poll() is None
    first.kill()
    assert first.wait(10.0) == -signal.SIGKILL


def test_a_supervisor_that_ends_before_it_reads_the_answer_is_the_end_and_no_fault() -> None:
    ours, its = socket.socketpair()
    with ThreadPoolExecutor(1) as pool:
        end = pool.submit(serve, its, os.getpid())
        ours.sendall(b"\n")
        assert select.select([ours], [], [], 20.0)[0], "the answer is there"
        ours.close()
        assert end.result(20.0) is None
    its.close()


def test_a_zygote_that_hangs_or_ended_is_replaced_before_it_is_needed(zygote: Zygote, tmp_path: Path) -> None:
    assert zygote.fork(tracker(bogus=1), tmp_path / "first.log").wait(60.0) == FATAL
    assert not zygote.mend()  # asks
    assert zygote.fork(tracker(bogus=1), tmp_path / "second.log").wait(60.0) == FATAL
    assert not zygote.mend()  # asks again
    select.select([zygote._socket], [], [], 60.0)
    assert not zygote.mend()  # hears the answer
    assert zygote._socket.gettimeout() == 5.0
    stuck = zygote.pid
    os.kill(stuck, signal.SIGSTOP)
    assert not zygote.mend()
    zygote._socket.settimeout(1e-6)
    assert zygote.mend()
    assert not psutil.pid_exists(stuck)
    killed = zygote.pid
    assert killed != stuck
    assert not zygote.mend()
    os.kill(killed, signal.SIGKILL)
    os.waitid(os.P_PID, killed, os.WEXITED | os.WNOWAIT)
    assert zygote.mend()
    assert zygote.pid != killed
    assert not zygote.mend()
    assert zygote.fork(tracker(bogus=1), tmp_path / "third.log").wait(60.0) == FATAL


def test_a_process_shares_what_is_loaded_and_imports_nothing_of_numba_with_its_kernels() -> None:
    script = (
        "import gc, sys; from rbtrg_robot.process import zygote; zygote.preload();"
        "alone = len(__import__('os').listdir('/proc/self/task')); frozen = gc.get_freeze_count() > 50_000;"
        "from rbtrg_robot.config import load; from rbtrg_robot.stages.guard import build;"
        "stage = build(load()); before = set(sys.modules); stage.warm_up();"
        "print(alone, frozen, *(m for m in set(sys.modules) - before if m.startswith(('numba', 'scipy', 'llvmlite'))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        env={**os.environ, **ONE_THREAD},
    )
    assert done.stdout.split() == ["1", "True"], (
        "one thread, which a fork copies, objects that no collection writes to, and no import"
    )


def test_one_that_shares_has_the_imports_of_its_parent_and_is_replaced_as_well(tmp_path: Path) -> None:
    script = """
import json, os, signal, sys
from pathlib import Path
from rbtrg_robot.process.zygote import Zygote
with Zygote(share=True) as zygote:
    rows = Path(f"/proc/{zygote.pid}/smaps_rollup").read_text().splitlines()[1:]
    size = {row.split()[0]: int(row.split()[1]) for row in rows}
    print(size["Private_Dirty:"] < 0.3 * size["Rss:"])
    for name in ("first.log", "second.log"):
        print(zygote.fork(json.loads(sys.argv[1]), Path(sys.argv[2]) / name).wait(60))
        os.kill(zygote.pid, signal.SIGKILL)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, json.dumps(tracker(bogus=1)), str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stdout.split() == ["True", str(FATAL), str(FATAL)]


def test_a_stopped_zygote_is_replaced_within_bounds(
    zygote: Zygote, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rbtrg_robot.process.zygote.ANSWER_LIMIT", 0.5)
    first = stopped(zygote, tmp_path / "first.log")
    stuck = zygote.pid
    os.kill(stuck, signal.SIGSTOP)
    second = zygote.fork(tracker(bogus=1), tmp_path / "second.log")
    assert second.wait(60.0) == FATAL
    assert zygote.pid != stuck
    assert not psutil.pid_exists(stuck)
    assert first.poll() is None
    first.kill()
    assert first.wait(10.0) == -signal.SIGKILL


def test_a_process_starts_though_its_folder_is_gone_or_cannot_be_written(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    with Zygote() as zygote:
        gone = zygote.fork(tracker(bogus=1), tmp_path / "gone" / "tracker.log")
        assert gone.wait(60.0) == FATAL
        nowhere = zygote.fork(tracker(bogus=1), tmp_path / "file" / "tracker.log")
        assert nowhere.wait(60.0) == FATAL
    assert (tmp_path / "gone" / "tracker.log").read_text().startswith("error: ")
    said = capfd.readouterr().err
    assert f"tracker: cannot write {tmp_path / 'file' / 'tracker.log'}" in said
    assert "error: there is no configuration key 'bogus'" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("name", [p.name for p in PROCESSES])
def test_when_the_supervisor_dies_robot_and_recorder_may_end_in_order(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: dict[int, Any] = {}
    with monkeypatch.context() as here:  # pytest itself needs these
        here.setattr("rbtrg_robot.process.zygote.prctl", told.__setitem__)
        here.setattr(os, "setpgid", lambda *_: None)
        here.setattr(os, "dup2", lambda *_: None)
        _settle({"specification": {"process": name}, "log_path": str(tmp_path / "log")}, os.getppid())
    ends = signal.SIGTERM if name in ("robot", "recorder") else signal.SIGKILL
    assert told[PR_SET_PDEATHSIG] == ends


def test_what_a_killed_process_leaves_is_reaped_and_nothing_survives_a_killed_caller(tmp_path: Path) -> None:
    script = """
import json, os, signal, subprocess, sys
from pathlib import Path
from rbtrg_robot.process.zygote import Zygote
children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
zygote = Zygote()
known = zygote.fork(json.loads(sys.argv[1]), Path(sys.argv[2]))
os.kill(known.pid, signal.SIGSTOP)
subprocess.run(["sh", "-c", "sleep 0.1 &"], check=True)
(left,) = set(children.read_text().split()) - {str(zygote.pid), str(known.pid)}
os.waitid(os.P_PID, int(left), os.WEXITED | os.WNOWAIT)
zygote.reap({known.pid})
print(set(children.read_text().split()) == {str(zygote.pid), str(known.pid)})
os.kill(known.pid, signal.SIGKILL)
os.waitid(os.P_PID, known.pid, os.WEXITED | os.WNOWAIT)
zygote.reap({known.pid})
print(known.wait(10))
pid = zygote.fork(json.loads(sys.argv[1]), Path(sys.argv[2])).pid
os.kill(pid, signal.SIGSTOP)
print(pid, zygote.pid, flush=True)
sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", script, json.dumps(tracker()), str(tmp_path / "log")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as caller:
        assert caller.stdout is not None
        reaped, ended, alive = (caller.stdout.readline().split() for _ in range(3))
        assert (reaped, ended) == (["True"], [str(-signal.SIGKILL)])
        processes = [psutil.Process(int(pid)) for pid in alive]
        assert len(processes) == 2
        caller.kill()
    _gone, left = psutil.wait_procs(processes, timeout=30.0)
    assert not left
