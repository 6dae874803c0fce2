"""Ports on loopback for stacks of benchmarks and tests."""

from __future__ import annotations

import socket

from rbtrg_robot.wire.front import hold_port

_held: list[socket.socket] = []
"""Ports stay ours until the process ends: what runs beside it would be given them before the stack listens."""


def free_port() -> int:
    """A port that nobody listens on and nobody else is given."""
    _held.append(hold_port())
    return int(_held[-1].getsockname()[1])


def free_endpoint() -> str:
    """The same as an endpoint of Zenoh."""
    return f"tcp/127.0.0.1:{free_port()}"
