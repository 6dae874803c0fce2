"""What tests of doors wait for."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

LIMIT = 20.0
"""[s] on a busy machine."""


def until(true: Callable[[], bool]) -> None:
    """Wait for something that the other side does."""
    end = time.monotonic() + LIMIT
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def ended(stranger: socket.socket) -> bool:
    """Whether the door has closed a connection, which does not block."""
    try:
        return stranger.recv(1000) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True
