"""How many connections a server takes. Unidentified connections give way to newer ones, so a flood of them keeps
nobody out.

uvicorn's `limit_concurrency` answers 503 to everybody once enough idle sockets are open, also to those who want to
stop the robot, and counts no WebSocket. The server of `websockets` has no limit: each connection is a thread, and it
ends when no descriptors are left."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable

QUEUE_LENGTH = 1024
"""Connections that the computer holds until they are accepted. It drops those beyond; a dropped client tries again
after 1 s."""
RUSH_COUNT = 128
"""So many accepted in a row, with the next one waiting each time, are a flood."""
LARGEST_REQUEST = 16_384
"""Bytes looked at of a request that waits."""

Address = tuple[str, int]


class CrowdedSocket(socket.socket):
    """A listening socket that knows its connections. The server that accepts from it closes what was shut down here."""

    def __init__(
        self,
        host: str,
        port: int,
        *,
        strangers: int,
        guests: int,
        asks: Callable[[bytes], bool] | None = None,
    ) -> None:
        """`strangers`: unidentified connections, of which one gives way when so many newer ones have come. `guests`:
        identified connections, all open.

        `asks(bytes)`: true if a complete first request has arrived. During a flood other connections are dropped
        (non-blocking sockets only). Raises OSError if the address is taken or invalid."""
        super().__init__(socket.AF_INET6 if ":" in host else socket.AF_INET)
        self.strangers, self.guests = strangers, guests
        self._asks = asks
        self._row = 0
        """Accepted since nobody waited."""
        self._strangers: dict[Address, socket.socket] = {}
        self._guests: dict[Address, socket.socket] = {}
        self._lock = threading.Lock()
        self.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self.bind((host, port))
            self.listen()
        except OSError:
            self.close()
            raise

    def listen(self, _turn: int = 0, /) -> None:
        """As long a queue, however many a server accepts in one turn of its loop."""
        super().listen(QUEUE_LENGTH)

    def accept(self) -> tuple[socket.socket, tuple[str, int]]:
        """The next connection. Raises BlockingIOError where nobody waits, or too many who ask for nothing."""
        for _ in range(QUEUE_LENGTH):
            found, address = self._next()
            if self._asks is None or self._row <= RUSH_COUNT or self._asks(_first_bytes(found)):
                break
            found.close()  # a hundredth of what a server spends on it
        else:
            raise BlockingIOError
        with self._lock:
            if len(self._strangers) >= self.strangers:
                self._strangers = _open(self._strangers)
            while len(self._strangers) >= self.strangers:
                _send_away(self._strangers.pop(next(iter(self._strangers))))
            self._strangers[address[:2]] = found
        return found, address

    def _next(self) -> tuple[socket.socket, tuple[str, int]]:
        try:
            entry = super().accept()
        except BlockingIOError:
            self._row = 0
            raise
        self._row += 1
        return entry

    def admit(self, address: Address | None) -> bool:
        """Whoever is connected from there has shown who it is. False where there are too many of those."""
        with self._lock:
            if address is None or address in self._guests:
                return True
            self._guests = _open(self._guests)
            if address not in self._strangers or len(self._guests) >= self.guests:
                return False
            self._guests[address] = self._strangers.pop(address)
            return True

    def close(self) -> None:
        """Nobody comes in any more; who waits before the door is sent away."""
        super().close()
        with self._lock:
            for stranger in self._strangers.values():
                _send_away(stranger)
            self._strangers.clear()

    @property
    def connected(self) -> int:
        """Open connections."""
        with self._lock:
            self._strangers, self._guests = _open(self._strangers), _open(self._guests)
            return len(self._strangers) + len(self._guests)


def _send_away(found: socket.socket) -> None:
    """Whoever holds it reads its end: to close it here would give its number away."""
    with contextlib.suppress(OSError):
        found.shutdown(socket.SHUT_RDWR)


def _first_bytes(found: socket.socket) -> bytes:
    with contextlib.suppress(OSError):
        return found.recv(LARGEST_REQUEST, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    return b""


def _open(sockets: dict[Address, socket.socket]) -> dict[Address, socket.socket]:
    return {address: found for address, found in sockets.items() if found.fileno() >= 0}
