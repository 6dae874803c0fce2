"""What stands before the router's TLS doors."""

from __future__ import annotations

import asyncio
import contextlib
import random
import socket
import threading
from collections.abc import Iterator

import pytest

from rbtrg_robot.wire import front
from rbtrg_robot.wire.front import DOOR_COUNT, Doors, Front, greets
from tools.bench.access import site
from tools.bench.flood import breaking_off, client_hello
from tools.bench.ports import free_port

HELLO = client_hello()


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", None),
        (HELLO[:1], None),
        (HELLO[:5], None),
        (HELLO[:-1], None),
        (HELLO, True),
        (HELLO + b"more", True),
        (b"GET / HTTP/1.1\r\n", False),
        (b"\x17" + HELLO[1:], False),
        (HELLO[:5] + b"\x02" + HELLO[6:], False),
        (b"\x16\x03\x01\xff\xff\x01", False),
    ],
)
def test_who_begins_a_handshake_is_told_from_who_does_not(data: bytes, expected: bool | None) -> None:
    assert greets(data) is expected


@pytest.mark.parametrize("says", [HELLO, b"junk" * 20, b""], ids=["hello", "junk", "nothing"])
def test_fifty_broken_handshakes_a_second_keep_no_new_session_out(says: bytes) -> None:
    """Zenoh lets nobody into a port for 0.1 s after each."""
    with site() as place:
        host, port = place.endpoint.partition("/")[2].split(":")
        with breaking_off((host, int(port)), 50.0, says):
            for _ in range(3):
                place.enter("operator").close()


def test_four_hundred_visitors_a_second_find_a_port_that_does_not_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Half of what a port is closed for: who holds on until he gives way to newer ones closes it a second time."""

    class Clock:
        now = 0.0

        def time(self) -> float:
            return self.now

        async def sleep(self, seconds: float) -> None:
            self.now += seconds

    async def visit() -> None:
        for _ in range(400):
            doors.failed(await doors.next())

    clock = Clock()
    monkeypatch.setattr(front.asyncio, "sleep", clock.sleep)
    doors = Doors(clock, list(range(DOOR_COUNT)))  # type: ignore[arg-type]
    asyncio.run(visit())
    assert clock.now < 0.5


def test_zenoh_gets_the_ports_that_were_chosen_for_it() -> None:
    """The system gives a free port to whoever asks, between the choice and Zenoh's turn too."""
    inner, outside = free_port(), free_port()
    made = Front([f"tls/127.0.0.1:{outside}"], inner)
    ports = [int(door.rpartition(":")[2]) for door in made.doors]
    assert len(set(ports) - {inner, outside}) == DOOR_COUNT
    with contextlib.closing(made), contextlib.ExitStack() as opened:
        for port in (*ports, inner):
            with socket.socket() as another, pytest.raises(OSError, match="in use"):
                another.bind(("127.0.0.1", port))
            opened.enter_context(socket.create_server(("127.0.0.1", port)))


@contextlib.contextmanager
def echoing(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, int]]:
    """A front before a program that says everything again."""
    monkeypatch.setattr(front, "DOOR_COUNT", 1)
    port = free_port()
    made = Front([f"tls/127.0.0.1:{port}"], free_port())
    with socket.create_server(("127.0.0.1", int(made.doors[0].rpartition(":")[2]))) as server:
        made.open()

        def echo() -> None:
            with server.accept()[0] as one, contextlib.suppress(OSError):
                while data := one.recv(1 << 16):
                    one.sendall(data)

        thread = threading.Thread(target=echo)
        thread.start()
        try:
            yield "127.0.0.1", port
        finally:
            made.close()
            thread.join()


def test_what_is_said_arrives_whole_also_where_nobody_reads_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    said = random.Random(0).randbytes(100 * front.HELD_BYTES)  # more than all sockets on the way hold
    with echoing(monkeypatch) as address, socket.create_connection(address, timeout=60.0) as one:
        one.sendall(HELLO)
        assert one.recv(1 << 16) == HELLO
        sending = threading.Thread(target=one.sendall, args=(said,))
        sending.start()
        sending.join(1.0)
        assert sending.is_alive(), "nobody reads: it holds only so much"
        heard = bytearray()
        while len(heard) < len(said):
            heard += one.recv(1 << 20)
        sending.join()
    assert heard == said


def test_who_says_more_than_a_greeting_before_it_is_answered_is_sent_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with echoing(monkeypatch) as address, socket.create_connection(address, timeout=20.0) as one:
        with contextlib.suppress(OSError):
            while one.send(HELLO[:-1] + b"\x00" * (1 << 16)):
                pass
        with contextlib.suppress(OSError):
            assert one.recv(1) == b""
        with socket.create_connection(address, timeout=20.0) as other:
            other.sendall(HELLO)
            assert other.recv(1 << 16) == HELLO


def test_who_has_not_come_through_a_handshake_gives_way_to_newer_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(front, "MOST_STRANGERS", 2)
    with echoing(monkeypatch) as address, contextlib.ExitStack() as held:

        def visitor() -> socket.socket:
            return held.enter_context(socket.create_connection(address, timeout=20.0))

        inside = visitor()
        for word in (HELLO, b"certificate", b"session"):
            inside.sendall(word)
            assert inside.recv(1 << 16) == word
        silent = [visitor() for _ in range(3)]
        assert silent[0].recv(1) == b"", "the oldest"
        inside.sendall(b"more")
        assert inside.recv(16) == b"more"
