"""Ports on loopback for stacks of benchmarks and tests."""

from __future__ import annotations

import socket


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def free_endpoint() -> str:
    """The same as an endpoint of Zenoh."""
    return f"tcp/127.0.0.1:{free_port()}"
