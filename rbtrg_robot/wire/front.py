"""The front of the router's TLS ports: it forwards bytes without reading them, but sees who is about to begin a TLS
handshake.

Zenoh (1.10, eclipse-zenoh/zenoh#2685) lets nobody into a listener for 0.1 s after each failed handshake: 10 visitors
a second who break off keep everybody else out. So Zenoh listens on many ports of this computer. This module spreads
visitors over them, each after its ClientHello is complete. Zenoh checks certificates end to end; nothing is decrypted
here."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Sequence
from functools import partial
from typing import Any

from rbtrg_robot.crowd import CrowdedSocket

DOOR_COUNT = 96
"""Ports of Zenoh."""
REST_TIME = 0.12
"""[s] after a failed handshake in which nobody else is sent to a port: about 800 of them a second close all."""
MOST_STRANGERS, MOST_GUESTS = 100, 160
"""Largest number of connections before and after the handshake. Before it the oldest gives way to a newer one. Each
takes three of the 1024 open files of a process."""
HELD_BYTES = 1 << 20
"""Bytes on their way to one who reads slowly before the other end is not read any more."""
HANDSHAKE, CLIENT_HELLO = 22, 1
LARGEST_RECORD = 16_384 + 5
"""Bytes of a record of TLS (RFC 8446, 5.1)."""
INSIDE_TURNS = 3
"""Turns that a visitor must speak with Zenoh before it counts as inside: ClientHello, certificate, and what only a
session says."""


def greets(data: bytes) -> bool | None:
    """Whether a visitor begins a TLS handshake; None while its ClientHello is not complete."""
    if data[:1] not in (b"", bytes([HANDSHAKE])) or data[5:6] not in (b"", bytes([CLIENT_HELLO])):
        return False
    if len(data) < 6:
        return None
    size = 5 + int.from_bytes(data[3:5], "big")
    return False if size > LARGEST_RECORD else len(data) >= size or None


def hold_port(port: int = 0) -> socket.socket:
    """Reserve this port of this computer, or a free one; a process that knows it may listen there (SO_REUSEADDR).

    Raises OSError if somebody listens already."""
    holder = socket.socket()
    holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        holder.bind(("127.0.0.1", port))
    except OSError:
        holder.close()
        raise
    return holder


class Front:
    """Visitors wait in its sockets from the moment that it is made, and come in once it is opened."""

    def __init__(self, listen: Sequence[str], inner: int) -> None:
        """listen: `tls/ADDRESS:PORT` each. inner: port of this computer that Zenoh listens on beside the doors.

        Raises OSError where one is taken, or is none of this computer.
        """
        self._held: list[socket.socket] = []
        """They keep Zenoh's ports until it listens there."""
        self._sockets: list[CrowdedSocket] = []
        self._loop = asyncio.new_event_loop()
        self._end = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="front", daemon=True)
        try:
            for endpoint in listen:
                host, _, port = endpoint.partition("/")[2].rpartition(":")
                limits = {"strangers": MOST_STRANGERS, "guests": MOST_GUESTS}
                door = CrowdedSocket(
                    host.strip("[]"), int(port), **limits, asks=lambda data: bool(greets(data))
                )
                self._sockets.append(door)
            self._held.append(hold_port(inner))
            while len(self._held) <= DOOR_COUNT:
                self._held.append(hold_port())
        except OSError:
            self.close()
            raise
        self._doors = [holder.getsockname()[1] for holder in self._held[1:]]

    @property
    def doors(self) -> tuple[str, ...]:
        """Endpoints that are Zenoh's to listen on."""
        return tuple(f"tls/127.0.0.1:{port}" for port in self._doors)

    def open(self) -> None:
        """Zenoh listens on `doors` now."""
        self._release()
        self._thread.start()

    def close(self) -> None:
        """Nobody comes in any more, and who is in is sent away."""
        self._release()
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join()
        for door in self._sockets:
            door.close()
        if not self._loop.is_closed():
            self._loop.close()

    def _release(self) -> None:
        while self._held:
            self._held.pop().close()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        doors = Doors(self._loop, self._doors)
        inside: set[Visitor] = set()
        for door in self._sockets:
            await self._loop.create_server(partial(Visitor, doors, door, inside), sock=door)
        await self._end.wait()
        for visitor in list(inside):
            visitor.leave()
        await asyncio.sleep(0)  # transports close in the loop


class Doors:
    """Which of Zenoh's ports is next."""

    def __init__(self, loop: asyncio.AbstractEventLoop, ports: list[int]) -> None:
        self.loop = loop
        self._rests = dict.fromkeys(ports, 0.0)
        """Until when [s]."""
        self._turn = asyncio.Lock()

    async def next(self) -> int:
        """Waits while all rest; who came first goes first."""
        async with self._turn:
            while (wait := min(self._rests.values()) - self.loop.time()) > 0.0:
                await asyncio.sleep(wait)
            port = min(self._rests, key=lambda port: self._rests[port])
            self.failed(port)  # most that come in a flood break off at once
            return port

    def failed(self, port: int) -> None:
        """A handshake there has failed, or may fail at once."""
        self._rests[port] = self.loop.time() + REST_TIME


class End(asyncio.Protocol):
    """One end of a connection: what comes goes to the other one."""

    def __init__(self) -> None:
        self.transport: Any = None
        self.other: End | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport
        self.transport.set_write_buffer_limits(HELD_BYTES)

    def data_received(self, data: bytes) -> None:
        if self.other is not None:
            self.other.transport.write(data)

    def pause_writing(self) -> None:
        if self.other is not None:
            self.other.transport.pause_reading()

    def resume_writing(self) -> None:
        if self.other is not None:
            self.other.transport.resume_reading()

    def connection_lost(self, error: Exception | None) -> None:
        if self.other is not None:
            self.other.transport.close()

    def leave(self) -> None:
        """Close both at once."""
        for end in (self, self.other):
            if end is not None and end.transport is not None:
                end.transport.abort()


class Zenoh(End):
    """The end at one of Zenoh's doors."""

    def __init__(self, visitor: Visitor) -> None:
        super().__init__()
        self.other: Visitor = visitor

    def data_received(self, data: bytes) -> None:
        self.other.answered()
        super().data_received(data)


class Visitor(End):
    """The end outside."""

    def __init__(self, doors: Doors, crowd: CrowdedSocket, inside: set[Visitor]) -> None:
        super().__init__()
        self._doors = doors
        self._crowd = crowd
        self._inside = inside
        self._door = 0
        self._said = b""
        self._spoke = 0
        """How often in turn with Zenoh; INSIDE_TURNS: no stranger any more."""
        self._listens = True
        self._joining: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._inside.add(self)

    def connection_lost(self, error: Exception | None) -> None:
        self._inside.discard(self)
        if self._door and self._spoke < INSIDE_TURNS:
            self._doors.failed(self._door)
        if self._joining is not None:
            self._joining.cancel()
        super().connection_lost(error)

    def answered(self) -> None:
        """Zenoh has said something."""
        self._listens = True

    def data_received(self, data: bytes) -> None:
        if self._listens and self._spoke < INSIDE_TURNS:
            self._listens = False
            self._spoke += 1
            if self._spoke == INSIDE_TURNS and not self._crowd.admit(
                self.transport.get_extra_info("peername")[:2]
            ):
                self.leave()
                return
        if self.other is not None:
            super().data_received(data)
            return
        self._said += data
        greeting = greets(self._said)
        if greeting is False or len(self._said) > 2 * LARGEST_RECORD:
            self.leave()
        elif greeting and self._joining is None:  # it is read on meanwhile, or its end would not be noticed
            self._joining = self._doors.loop.create_task(self._join())

    async def _join(self) -> None:
        door = await self._doors.next()
        try:
            _, there = await self._doors.loop.create_connection(partial(Zenoh, self), "127.0.0.1", door)
        except OSError:  # it ends, or has no descriptors left
            self.leave()
            return
        self._door, self.other = door, there
        there.transport.write(self._said)
        self._said = b""
