"""The DDS sockets are large enough for a LiDAR's sweep."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="the unitree extra is not installed")
from hal.unitree.link import RECEIVE_BUFFER, DdsLink

DOMAIN = 77


def udp_buffers() -> Iterator[int]:
    """Receive buffers [bytes] of this process's UDP sockets."""
    for entry in Path("/proc/self/fd").iterdir():
        if entry.is_symlink() and str(entry.readlink()).startswith("socket:"):
            with socket.socket(fileno=os.dup(int(entry.name))) as found:
                if (found.family, found.type) == (socket.AF_INET, socket.SOCK_DGRAM):
                    yield found.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def test_dds_asks_for_a_receive_buffer_that_holds_five_sweeps() -> None:
    before = sorted(udp_buffers())
    link = DdsLink("lo", DOMAIN, [])
    try:
        granted = min(RECEIVE_BUFFER, int(Path("/proc/sys/net/core/rmem_max").read_text()))
        ours = sorted(udp_buffers())
        assert len(ours) > len(before)
        assert ours.count(2 * granted) > before.count(
            2 * granted
        )  # the kernel doubles it for its own records
    finally:
        link.close()
