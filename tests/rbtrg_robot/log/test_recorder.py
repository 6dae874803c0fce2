"""The recorder on a disk that runs out of room, and what stays on it."""

from __future__ import annotations

import errno
import os
import shutil
import threading
from collections import namedtuple
from pathlib import Path
from typing import Any

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.log import keep
from rbtrg_robot.log import recorder as module
from rbtrg_robot.log import write as log_write
from rbtrg_robot.log.keep import GIGABYTE, mark, prune, runs
from rbtrg_robot.log.read import read_log
from rbtrg_robot.log.recorder import Recorder
from rbtrg_robot.log.summary import is_intact
from rbtrg_robot.msg import MissionState
from rbtrg_robot.process.leftovers import last_words, rotate
from rbtrg_robot.run_folder import UnsafeFolder, run_dir
from rbtrg_robot.stage_config import RecorderConfig
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.messages import encode, header

Usage = namedtuple("Usage", "total used free")


class Clock:
    """Both clocks of the recorder, moved by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.free = 100 * GIGABYTE
        monkeypatch.setattr(module.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(module.shutil, "disk_usage", lambda _path: Usage(0, 0, self.free))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def recorder_in(folder: Path, **params: float) -> Recorder:
    folder.mkdir(parents=True, exist_ok=True)
    return Recorder(folder, RecorderConfig(**params), {}, {}, SourceClock())  # type: ignore[arg-type]


def one(recorder: Recorder, topic: t.Topic[Any], stamp: int) -> None:
    message = topic.kind(header=header(stamp, "x"))
    recorder.write(topic, encode(message), stamp, 1)


def topics_in(folder: Path) -> list[str]:
    return [e.topic for path in sorted(folder.glob("*.mcap")) for e, _, _ in read_log(path)]


def test_clouds_go_first_when_space_is_short(tmp_path: Path, clock: Clock) -> None:
    recorder = recorder_in(tmp_path / "run", spare_gb=2.0)
    clock.free = GIGABYTE
    recorder.housekeep()
    assert "clouds are not recorded: 1.0 GB" in recorder.trouble
    one(recorder, t.POINTS, 1)
    one(recorder, t.IMU, 2)
    clock.free, clock.now = 3 * GIGABYTE, clock.now + 2.0
    recorder.housekeep()
    assert recorder.trouble == ""
    one(recorder, t.POINTS, 3)
    recorder.close()
    assert topics_in(tmp_path / "run") == [t.IMU.name, t.POINTS.name]
    assert recorder.left_out == 1


def test_a_killed_recorder_loses_a_quarter_of_a_second(tmp_path: Path, clock: Clock) -> None:
    """Beside what comes until it is back, which takes half a second. It was a second: 1.4 s were missing at worst."""
    recorder = recorder_in(tmp_path / "run")
    recorder.housekeep()
    one(recorder, t.IMU, 1)
    clock.now += 0.26
    recorder.housekeep()
    assert topics_in(tmp_path / "run") == [t.IMU.name]
    recorder.close()


def test_a_full_disk_stops_the_recording_and_is_told(tmp_path: Path, clock: Clock) -> None:
    recorder = recorder_in(tmp_path / "run", spare_gb=2.0)
    one(recorder, t.IMU, 1)
    clock.now += 2.0
    recorder.housekeep()  # flushes
    clock.free, clock.now = GIGABYTE // 10, clock.now + 2.0
    recorder.housekeep()
    assert "nothing is recorded: 0.1 GB" in recorder.trouble
    one(recorder, t.IMU, 2)
    clock.now += 10.0
    recorder.housekeep()
    assert "nothing is recorded" in recorder.trouble
    clock.free, clock.now = 3 * GIGABYTE, clock.now + 10.0
    recorder.housekeep()
    clock.now += 2.0
    recorder.housekeep()
    assert recorder.trouble == ""
    one(recorder, t.IMU, 3)
    recorder.close()
    assert recorder.left_out == 1
    assert is_intact(tmp_path / "run" / "log_1.mcap")
    assert topics_in(tmp_path / "run") == [t.IMU.name, t.IMU.name]


def test_a_write_that_fails_does_not_end_the_recorder(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = recorder_in(tmp_path / "run")
    full = True
    plain = log_write._LogFile.write

    def write(self: log_write._LogFile, data: bytes) -> int:
        if full:
            raise log_write._cannot_write(Path("log"), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
        return plain(self, data)

    monkeypatch.setattr(log_write._LogFile, "write", write)
    one(recorder, t.IMU, 1)
    clock.now += 2.0
    recorder.housekeep()
    assert "No space left" in recorder.trouble
    full = False
    clock.now += 10.0
    recorder.housekeep()
    one(recorder, t.IMU, 2)
    recorder.close()
    assert topics_in(tmp_path / "run")[-1] == t.IMU.name
    assert is_intact(tmp_path / "run" / "log_1.mcap")


def test_a_recorder_that_starts_on_a_full_disk_waits_for_room(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = log_write._LogFile.write

    def write(self: log_write._LogFile, data: bytes) -> int:
        raise log_write._cannot_write(Path("log"), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

    monkeypatch.setattr(log_write._LogFile, "write", write)
    recorder = recorder_in(tmp_path / "run")
    one(recorder, t.IMU, 1)
    recorder.housekeep()
    assert "No space left" in recorder.trouble
    monkeypatch.setattr(log_write._LogFile, "write", plain)
    clock.now += 10.0
    recorder.housekeep()
    one(recorder, t.IMU, 2)
    recorder.close()
    assert recorder.left_out == 1
    assert topics_in(tmp_path / "run") == [t.IMU.name], "and the attempt left no file that is none"


def test_waiting_for_the_disk_does_not_hold_the_recorder_up(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = threading.Event()
    monkeypatch.setattr(log_write.os, "fsync", lambda _file: slow.wait(20.0))
    recorder = recorder_in(tmp_path / "run", rotate_seconds=10.0)
    clock.now += 11.0
    recorder.housekeep()
    one(recorder, t.IMU, 2)
    assert not slow.is_set(), "it records while the disk takes the file before"
    slow.set()
    recorder.close()
    assert is_intact(tmp_path / "run" / "log_0.mcap")


def test_removing_old_runs_does_not_hold_the_recorder_up(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = make_run(tmp_path, "20260101", 3)
    slow = threading.Event()
    plain = module.prune

    def prune(*wanted: Any, **how: Any) -> list[Path]:
        slow.wait(20.0)
        return plain(*wanted, **how)

    monkeypatch.setattr(module, "prune", prune)
    recorder = recorder_in(tmp_path / "run", rotate_seconds=10.0, keep_gb=0.001)
    clock.now += 11.0
    recorder.housekeep()
    assert old.exists(), "it goes on while the disk removes"
    one(recorder, t.IMU, 2)
    slow.set()
    recorder.close()
    assert not old.exists()


def test_a_new_file_begins_and_the_old_one_gets_its_index(tmp_path: Path, clock: Clock) -> None:
    recorder = recorder_in(tmp_path / "run", rotate_seconds=10.0)
    one(recorder, t.IMU, 1)
    clock.now += 11.0
    recorder.housekeep()
    one(recorder, t.IMU, 2)
    recorder.close()
    assert [is_intact(tmp_path / "run" / f"log_{k}.mcap") for k in (0, 1)] == [True, True]


def make_run(base: Path, name: str, megabytes: int) -> Path:
    folder = base / name
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text("{}\n")
    (folder / "log_0.mcap").write_bytes(bytes(megabytes * 1_000_000))
    return folder


def test_the_oldest_unmarked_runs_go_when_the_quota_is_full(tmp_path: Path) -> None:
    first, second, third, last = (make_run(tmp_path, f"2026010{k}", 3) for k in range(4))
    (tmp_path / "notes").mkdir()
    mark(first)
    assert prune(tmp_path, 0.0095) == [second]
    assert [run.folder for run in runs(tmp_path)] == [first, third, last]
    assert prune(tmp_path, 0.0, spare=last) == [third]
    mark(first, keep=False)
    assert prune(tmp_path, 0.0, spare=last) == [first]
    assert (tmp_path / "notes").is_dir()


def test_a_removal_that_was_cut_short_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run(tmp_path, "20260101", 3)
    monkeypatch.setattr(
        keep.shutil, "rmtree", lambda *_, **__: None
    )  # the process is killed before it comes to that
    assert prune(tmp_path, 0.0) == []
    monkeypatch.undo()
    assert [path.name for path in run.iterdir()] == ["config.yaml"]
    assert prune(tmp_path, 0.0) == [run], "it is still known as a run"


def test_a_run_that_vanishes_or_belongs_to_somebody_else_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, theirs, gone = (make_run(tmp_path, f"2026010{k}", 3) for k in range(3))

    def look(path: Path) -> bool:
        if path.parent == theirs:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        if path.parent == gone:
            raise FileNotFoundError(errno.ENOENT, "No such file", str(path))
        return False

    monkeypatch.setattr(keep, "is_being_written", look)
    assert prune(tmp_path, 0.0) == [mine, gone]
    assert theirs.exists()


def test_a_run_that_is_being_written_stays(tmp_path: Path, clock: Clock) -> None:
    folder = tmp_path / "20260101"
    recorder = recorder_in(folder)
    (folder / "config.yaml").write_text("{}\n")
    assert prune(tmp_path, 0.0) == []
    recorder.close()
    assert prune(tmp_path, 0.0) == [folder]


def test_the_last_words_of_a_long_log_are_read_from_its_end(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    path.write_text("word\n" * 100_000 + "error: the cable is out\n")
    assert last_words(path) == "the cable is out"


def test_a_long_process_log_is_rotated_under_its_writer(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    with path.open("ab", buffering=0) as writer:
        writer.write(b"old\n" * 10)
        rotate(path, limit=1000)
        assert not path.with_name("robot.log.1").exists()
        rotate(path, limit=10)
        writer.write(b"new\n")
    assert path.read_bytes() == b"new\n"
    assert path.with_name("robot.log.1").read_bytes() == b"old\n" * 10


def test_a_run_folder_of_somebody_else_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert run_dir() == tmp_path / "rbtrg"
    (tmp_path / "rbtrg").chmod(0o777)
    with pytest.raises(UnsafeFolder, match="writable by others"):
        run_dir()
    (tmp_path / "rbtrg").chmod(0o755)
    assert run_dir().stat().st_mode & 0o077 == 0
    shutil.rmtree(tmp_path / "rbtrg")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "rbtrg").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UnsafeFolder):
        run_dir()


def test_a_mission_that_recorded_something_keeps_its_run(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").touch()
    for status, kept in (("WAITING", False), ("RUNNING", True)):
        state = MissionState(action_type=["goto", "record"], action_status=["RUNNING", status])
        module.keep_recorded(tmp_path, state)
        assert (tmp_path / "KEEP").exists() is kept
    module.keep_recorded(tmp_path, None)
