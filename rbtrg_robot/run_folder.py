"""Where the stacks of one user keep what nobody else may touch: locks, states, tokens, and the socket of the bus."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from hal.errors import OperatorError

LONGEST_PATH = 107
"""Bytes of the path of a socket."""


class UnsafeFolder(OperatorError):
    """Somebody else could have put locks and state there, or the bus finds no place."""


def run_dir() -> Path:
    """Per-user folder for locks and state: XDG_RUNTIME_DIR, else the temporary folder."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    path = Path(base) / "rbtrg" if base else Path(tempfile.gettempdir()) / f"rbtrg-{os.getuid()}"
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = path.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise UnsafeFolder(
            f"{path} belongs to somebody else or is writable by others: remove it, or set XDG_RUNTIME_DIR to "
            "a folder of yours"
        )
    path.chmod(0o700)  # one of before may be open to readers
    return path


def bus_socket(robot: str) -> Path:
    """Where a robot's bus listens for the processes and commands of this user. Raises UnsafeFolder."""
    path = run_dir() / f"{robot}.bus"
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise UnsafeFolder(
            f"{path} is too long for a socket, which has {LONGEST_PATH} bytes: set XDG_RUNTIME_DIR to a shorter one"
        )
    return path
