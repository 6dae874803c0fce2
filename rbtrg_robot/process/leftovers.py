"""Leftovers of processes on the machine: their output, shared memory."""

from __future__ import annotations

import logging
import os
import shutil
from pathlib import Path

import psutil

log = logging.getLogger(__name__)

SHARED_MEMORY = Path("/dev/shm")
TAIL_BYTES = 4096
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


def last_words(path: Path) -> str:
    """The last line a process wrote."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - TAIL_BYTES))
            lines = file.read().decode(errors="replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1].removeprefix("error: ") if lines else ""
