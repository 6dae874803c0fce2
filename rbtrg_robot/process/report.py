"""One archive with what somebody far away needs to understand a run."""

from __future__ import annotations

import importlib.metadata
import io
import json
import platform
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema

from hal.errors import one_line
from hal.regular import is_own
from rbtrg_robot import __version__
from rbtrg_robot import topics as t
from rbtrg_robot.log.read import CONFIG, METADATA, Entry, LogContents, LogError, log_files, read_log
from rbtrg_robot.log.write import LogWriter, private
from rbtrg_robot.process.doctor import examine

LOG_SECONDS = 60.0
"""Length [s] of the piece of the log that is packed."""
TAIL_LINES, TAIL_BYTES = 300, 128 * 1024
"""Most lines and bytes of each process log."""


def pack(out: Path, run: Path | None, status: bytes | None, port: int) -> list[str]:
    """Write the archive `out` (.tar.gz). Returns what is missing in it and why; only an `out` that cannot be written
    raises (LogError).

    `run`: folder of a run, or None; `status`: of the running stack as JSON, or None; `port`: that the doctor tries."""
    missing: list[str] = []
    try:
        with open(out, "wb", opener=private) as file, tarfile.open(fileobj=file, mode="w:gz") as archive:

            def add(name: str, make: Callable[[], bytes]) -> None:
                try:
                    data = make()
                except Exception as error:  # noqa: BLE001 - whatever a part lacks, the others are wanted
                    missing.append(f"{name}: {one_line(error)}")
                else:
                    _add(archive, name, data)

            add("versions.txt", _versions)
            add("doctor.txt", lambda: _doctor(port))
            add("status.json", lambda: _status(status))
            add(CONFIG, lambda: _own(_folder(run) / CONFIG).read_bytes())
            try:
                logs = sorted(_folder(run).glob("*.log*"))
                missing.extend([] if logs else ["logs: there are none in the run's folder"])
            except LogError as error:
                logs = []
                missing.append(f"logs: {error}")
            for path in logs:
                add(f"logs/{path.name}", lambda path=path: _tail(path))  # type: ignore[misc]
            add("last.mcap", lambda: _last_of(_folder(run)))
            if missing:
                _add(archive, "MISSING.txt", "\n".join(missing).encode() + b"\n")
    except OSError as error:
        raise LogError(f"cannot write {out}: {error.strerror}; name another file with --out") from error
    return missing


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(f"report/{name}")
    entry.size, entry.mtime = len(data), int(time.time())
    archive.addfile(entry, io.BytesIO(data))


def _folder(run: Path | None) -> Path:
    if run is None:
        raise LogError("no run was found; name its folder: `rbtrg-robot report RUN`")
    if not run.is_dir():
        raise LogError(f"there is no folder {run}")
    return run


def _versions() -> bytes:
    found = {d.metadata["Name"]: d.version for d in importlib.metadata.distributions()}
    lines = [f"rbtrg-robot {__version__}", f"python {sys.version.split()[0]}", platform.platform()]
    lines += [f"{name} {version}" for name, version in sorted(found.items(), key=lambda x: x[0].lower())]
    return "\n".join(lines).encode() + b"\n"


def _doctor(port: int) -> bytes:
    lines = [f"{finding.level.name} {finding.what}: {finding.words}" for finding in examine(port)]
    return "\n".join(lines).encode() + b"\n"


def _status(status: bytes | None) -> bytes:
    if status is None:
        raise LogError("no stack is up, or it does not answer")
    return json.dumps(json.loads(status), indent=1).encode()


def _own(path: Path) -> Path:
    """A file of the run itself. Raises LogError for another one, which a link would take into the archive."""
    if not is_own(path):
        raise LogError(f"{path} is no file of the run")
    return path


def _tail(path: Path) -> bytes:
    with _own(path).open("rb") as file:
        file.seek(max(0, path.stat().st_size - TAIL_BYTES))
        return b"".join(file.read().splitlines(keepends=True)[-TAIL_LINES:])


def _last_of(folder: Path) -> bytes:
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "last.mcap"
        last_seconds(folder, target, LOG_SECONDS)
        return target.read_bytes()


def last_seconds(folder: Path, target: Path, seconds: float) -> int:
    """Write the end of a run as one indexed file, also of a run that is being written; returns the number of messages.

    The newest earlier message of each latched topic stands before it. Raises LogError.
    """
    files: list[Path] = []
    begin = None
    for path in reversed(
        log_files(folder)
    ):  # a file is minutes long, or as short as the life of a recorder that was killed
        times = [entry.log_time for entry, _, _ in read_log(path, raw=True)]
        files.insert(0, path)
        if times and begin is None:
            begin = max(times) - round(seconds * 1e9)
        if times and begin is not None and min(times) < begin:
            break
    begin = begin or 0
    contents = LogContents()
    latched: dict[str, tuple[Entry, Schema | None, Channel]] = {}
    writer: LogWriter | None = None
    try:
        for path in files:
            for record in read_log(path, contents, raw=True):
                if writer is None:  # metadata and attachments stand before the first message
                    writer = LogWriter(target, contents.metadata.get(METADATA, {}), contents.attachments)
                entry = record[0]
                if entry.log_time < begin:
                    if _is_latched(entry.topic):
                        latched[entry.topic] = record
                    continue
                for held in latched.values():
                    writer.copy(*held)
                latched.clear()
                writer.copy(*record)
        if writer is None:
            raise LogError(f"no message in {folder}")
        return writer.messages
    finally:
        if writer is not None:
            writer.close()


def _is_latched(name: str) -> bool:
    topic: t.Topic[Any] | None = t.BY_NAME.get(name)
    return topic is not None and topic.qos is t.Qos.LATCHED
