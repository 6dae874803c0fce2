"""Lines of JSON between processes, through pipes that never block."""

from __future__ import annotations

import contextlib
import os

LONGEST_WRITE = 4096
"""[bytes] that a pipe takes as a whole or not at all (PIPE_BUF on Linux)."""


class Lines:
    """The reading end of a pipe, as lines."""

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._rest = b""
        self.ended = False
        """The writer has closed its end."""

    def read(self) -> list[bytes]:
        """Whole lines since the last call."""
        while not self.ended:
            try:
                data = os.read(self._descriptor, 1 << 16)
            except BlockingIOError:
                break
            self.ended = not data
            self._rest += data
        *lines, self._rest = self._rest.split(b"\n")
        return lines


def write(descriptor: int, line: bytes) -> bool:
    """Write a line to a pipe that does not block. False where it is full, or nobody reads: the next line tells the same
    anew."""
    with contextlib.suppress(BlockingIOError, BrokenPipeError):
        return os.write(descriptor, line[:LONGEST_WRITE]) == len(line)
    return False
