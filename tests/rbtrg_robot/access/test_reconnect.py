"""An operator's connection over mutual TLS is cut and comes back: the same session goes on, without anybody doing
anything."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from rbtrg_robot import topics as t
from rbtrg_robot.access.identity import client_tls
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.session import Security
from tools.bench.access import Site, site

LIMIT = 60.0
"""Longest wait [s]; Zenoh tries again after 1, 2, 4, 4, ... s."""


class Cable:
    """A TCP connection to a port, through which nothing goes while it is cut."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._whole = threading.Event()
        self._whole.set()
        self._ends: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self.calls = 0
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                here, _ = self._listener.accept()
                self.calls += 1
                if not self._whole.is_set():
                    here.close()
                    continue
                there = socket.create_connection(("127.0.0.1", self._port))
                self._ends += [here, there]
                for source, sink in ((here, there), (there, here)):
                    threading.Thread(target=_carry, args=(source, sink), daemon=True).start()

    def cut(self) -> None:
        """Both computers see the connection end; new ones are refused."""
        self._whole.clear()
        for end in self._ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        self._ends.clear()

    def mend(self) -> None:
        """New connections go through again."""
        self._whole.set()

    def close(self) -> None:
        """For good."""
        self.cut()
        self._listener.close()


def _carry(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            sink.sendall(data)
    for end in (source, sink):
        end.close()


@pytest.fixture
def place() -> Iterator[Site]:
    with site() as made:
        yield made


def talks(place: Site, bus: Bus, mark: str) -> bool:
    """Whether what the operator sends arrives and what the robot says is heard, within LIMIT."""
    until = time.monotonic() + LIMIT
    here = there = False
    while time.monotonic() < until and not (here and there):
        bus.publish(t.GOAL_REQUEST, t.GOAL_REQUEST.kind(id=mark), 1)
        place.inside.publish(t.GOAL_STATUS, t.GOAL_STATUS.kind(id=mark), 1)
        here = here or any(r.topic is t.GOAL_STATUS and r.decode().id == mark for r in bus.take(0.1))
        there = there or any(r.decode().id == mark for r in place.inside.take(0.1))
    return here and there


def test_a_lost_connection_resumes_by_itself(place: Site) -> None:
    cable = Cable(int(place.endpoint.rpartition(":")[2]))
    place.inside.subscribe([t.GOAL_REQUEST])
    operator = Security(client_tls(place.folders["operator"]))
    try:
        with Bus(f"tls/127.0.0.1:{cable.port}", "cli", security=operator) as bus:
            bus.subscribe([t.GOAL_STATUS])
            assert talks(place, bus, "before")
            cable.cut()
            refused = cable.calls + 1
            until = time.monotonic() + LIMIT
            while cable.calls < refused and time.monotonic() < until:
                time.sleep(0.02)
            assert cable.calls >= refused, "it tries again"
            place.inside.take(0.0)
            bus.take(0.0)
            cable.mend()
            assert talks(place, bus, "after")
            assert bus.ask("status") == b'"well"'
    finally:
        cable.close()
