"""Leftovers of processes on the machine: their output, shared memory."""

from __future__ import annotations

import fcntl
import logging
import os
import shutil
import time
from pathlib import Path

import psutil

log = logging.getLogger(__name__)

SHARED_MEMORY = Path("/dev/shm")
YOUNG = 2.0
"""Shared memory is left alone for so long after it was made [s]: Zenoh makes it first and locks it then."""
TAIL = 4096
"""Bytes of a process log in which its last words are looked for."""


def rotate(path: Path, limit: int) -> None:
    """Move what a process wrote to FILE.1 when it is more than `limit` bytes.

    The process keeps its descriptor, which appends: the file is copied and cut, not renamed.
    """
    try:
        if path.stat().st_size > limit:
            shutil.copyfile(path, path.with_name(f"{path.name}.1"))
            os.truncate(path, 0)
    except OSError as error:
        log.warning("cannot rotate %s: %s", path, error.strerror)


def shared_segments(process: psutil.Process) -> set[Path]:
    """Zenoh's shared memory that a process has mapped: its own and that of those it talks to."""
    try:
        mapped = [Path(m.path) for m in process.memory_maps()]
    except psutil.Error:
        return set()
    return {path for path in mapped if path.parent == SHARED_MEMORY and path.suffix == ".zenoh"}


def reap_segments(folder: Path = SHARED_MEMORY) -> int:
    """Remove the shared memory of Zenoh processes that were killed; returns the number of files.

    Zenoh 1.10.2 holds an advisory lock on every segment that it made or mapped, and the kernel drops it with the process. What can be locked
    is nobody's. Zenoh itself removes such files, of whichever program, when the next process on this computer first needs shared memory.
    """
    reaped = 0
    for path in folder.glob("*.zenoh"):
        try:
            segment = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError:
            continue  # gone by now, or another user's
        try:
            if abs(time.time() - os.fstat(segment).st_mtime) >= YOUNG:
                fcntl.flock(segment, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
                reaped += 1
        except OSError:
            pass  # somebody holds it
        finally:
            os.close(segment)
    return reaped


def last_words(path: Path) -> str:
    """The last line a process wrote."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - TAIL))
            lines = file.read().decode(errors="replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1].removeprefix("error: ") if lines else ""
