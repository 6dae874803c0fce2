"""`report` packs what there is, says what there is not, and never fails on a part."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.log.read import CONFIG, LogError, read_log
from rbtrg_robot.log.summary import is_intact
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.process import report
from rbtrg_robot.process.doctor import Finding, Level
from rbtrg_robot.wire.messages import encode

SECOND = 1_000_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The doctor starts processes, which is its own business."""
    monkeypatch.setattr(report, "examine", lambda port: iter([Finding("port", Level.OK, f"{port} is free")]))


def write(path: Path, first: int, last: int, *, latched: bool = False) -> LogWriter:
    """One /odom a second, stamped from `first` to `last` [s]."""
    writer = LogWriter(path, {"robot": "rex"}, {CONFIG: b"robot: rex\n"})
    if latched:
        writer.write(t.TF_STATIC, encode(t.TF_STATIC.kind()), first * SECOND, first * SECOND)
    for second in range(first, last + 1):
        writer.write(t.ODOM, encode(t.ODOM.kind()), second * SECOND, second * SECOND)
    writer.flush()
    return writer


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Path]:
    """A run whose second file is being written."""
    folder = tmp_path / "run"
    write(folder / "log_0.mcap", 0, 99, latched=True).close()
    writer = write(folder / "log_1.mcap", 100, 130)
    (folder / CONFIG).write_text("robot: rex\n")
    (folder / "planner.log").write_text("".join(f"line {n}\n" for n in range(1000)))
    yield folder
    writer.close()


def contents(archive: Path) -> dict[str, bytes]:
    with tarfile.open(archive) as opened:
        found = {}
        for member in opened.getmembers():
            file = opened.extractfile(member)
            assert file is not None
            found[member.name.removeprefix("report/")] = file.read()
        return found


def test_everything_is_in_it(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.tar.gz"
    assert report.pack(out, run, b'{"ready": true}', 7449) == []
    assert out.stat().st_mode & 0o077 == 0, "the user's alone"
    found = contents(out)
    assert set(found) == {
        "versions.txt",
        "doctor.txt",
        "status.json",
        CONFIG,
        "logs/planner.log",
        "last.mcap",
    }
    assert b"\nnumpy " in found["versions.txt"]
    assert found["doctor.txt"] == b"OK port: 7449 is free\n"
    assert json.loads(found["status.json"]) == {"ready": True}
    assert found[CONFIG] == b"robot: rex\n"
    lines = found["logs/planner.log"].splitlines()
    assert (len(lines), lines[-1]) == (report.TAIL_LINES, b"line 999")
    (tmp_path / "last.mcap").write_bytes(found["last.mcap"])
    assert is_intact(tmp_path / "last.mcap")


def test_the_last_minute_of_a_run_that_is_being_written_is_an_indexed_log(run: Path, tmp_path: Path) -> None:
    target = tmp_path / "last.mcap"
    assert not is_intact(run / "log_1.mcap")
    assert report.last_seconds(run, target, 60.0) == 62
    assert is_intact(target)
    entries = [entry for entry, _, _ in read_log(target)]
    assert entries[0].topic == "/tf_static"  # latched long before
    assert [entry.log_time // SECOND for entry in entries[1:]] == list(range(70, 131))


def test_a_minute_is_a_minute_however_often_the_recorder_was_killed(tmp_path: Path) -> None:
    folder, target = tmp_path / "run", tmp_path / "last.mcap"
    for number in range(12):
        write(folder / f"log_{number}.mcap", 10 * number, 10 * number + 9).abandon()
    report.last_seconds(folder, target, 60.0)
    assert [entry.log_time // SECOND for entry, _, _ in read_log(target)] == list(range(59, 120))


def test_what_is_missing_is_told_and_the_rest_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_port: int) -> Iterator[Finding]:
        yield Finding("port", Level.OK, "free")
        raise RuntimeError("the doctor is ill")

    monkeypatch.setattr(report, "examine", broken)
    out, empty = tmp_path / "out.tar.gz", tmp_path / "empty"
    empty.mkdir()
    for run in (None, tmp_path / "nowhere", empty):
        missing = report.pack(out, run, None, 7447)
        assert [line.split(":")[0] for line in missing] == [
            "doctor.txt",
            "status.json",
            CONFIG,
            "logs",
            "last.mcap",
        ]
        found = contents(out)
        assert set(found) == {"versions.txt", "MISSING.txt"}
        assert found["MISSING.txt"].decode().splitlines() == missing
    assert missing[0] == "doctor.txt: the doctor is ill"


def test_damaged_parts_are_parts_that_are_missing(run: Path, tmp_path: Path) -> None:
    (run / "log_0.mcap").write_bytes(b"no log at all")
    missing = report.pack(tmp_path / "out.tar.gz", run, b"{", 7447)
    assert [line.split(":")[0] for line in missing] == ["status.json", "last.mcap"]
    assert "logs/planner.log" in contents(tmp_path / "out.tar.gz")


def test_an_archive_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="name another file with --out"):
        report.pack(tmp_path / "nowhere" / "out.tar.gz", None, None, 7447)


def test_no_file_from_outside_the_run_gets_into_the_archive(tmp_path: Path) -> None:
    """A run's folder that somebody sent may hold links to keys of this computer."""
    (tmp_path / "key.pem").write_text("secret")
    run = tmp_path / "run"
    run.mkdir()
    for name in ("config.yaml", "robot.log"):
        (run / name).symlink_to(tmp_path / "key.pem")
    missing = report.pack(tmp_path / "report.tar.gz", run, None, 7447)
    assert sum("is no file of the run" in line for line in missing) == 2
    with tarfile.open(tmp_path / "report.tar.gz") as archive:
        assert not {"report/config.yaml", "report/logs/robot.log"} & set(archive.getnames())
