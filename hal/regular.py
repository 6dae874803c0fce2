"""Files that come from somebody else are opened here: maps, scenes, missions, configurations, logs, policies."""

from __future__ import annotations

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}


def open_regular(path: Path | str) -> BufferedReader:
    """Open a regular file for reading. Raises OSError, also for other files: a pipe makes its reader wait for ever, a
    device may have no end.

    It is checked before it is opened, because opening a device may do something, and again after, because it may have
    been replaced."""
    _refuse(os.stat(path).st_mode, path)
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _refuse(os.fstat(descriptor).st_mode, path)
        return open(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def is_own(path: Path) -> bool:
    """Whether this is a file and no link: a folder from elsewhere must not lead its reader to a file of this
    computer, such as a key."""
    return path.is_file() and not path.is_symlink()


def _refuse(mode: int, path: Path | str) -> None:
    if not stat.S_ISREG(mode):
        kind = KINDS.get(stat.S_IFMT(mode), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
