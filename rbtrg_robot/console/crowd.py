"""How many may be connected. Connections that have not shown a cookie give way to newer ones, so a flood of them keeps nobody out.

uvicorn's `limit_concurrency` answers 503 to everybody once enough idle sockets are open, to those who want to stop the robot too, and
counts no WebSocket.
"""

from __future__ import annotations

import contextlib
import socket

STRANGERS = 400
"""Connections without a cookie; of more, the oldest is closed. A browser shows its cookie with its first bytes, which are read a few
turns of the loop after it was let in, and each turn lets in as many as wait."""
GUESTS = 128
"""Connections with one. A page holds one, and up to six more while it loads."""

Address = tuple[str, int]


class CrowdedSocket(socket.socket):
    """A listening socket that knows what it has let in. The server that accepts from it closes what was shut down here."""

    def __init__(self, family: int) -> None:
        super().__init__(family)
        self._strangers: dict[Address, socket.socket] = {}
        self._guests: dict[Address, socket.socket] = {}

    def accept(self) -> tuple[socket.socket, tuple[str, int]]:
        """The next connection."""
        found, address = super().accept()
        self._strangers = _open(self._strangers)
        while len(self._strangers) >= STRANGERS:
            oldest = self._strangers.pop(next(iter(self._strangers)))
            # Whoever holds it reads its end: to close it here would give its number away.
            with contextlib.suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)
        self._strangers[address[:2]] = found
        return found, address

    def admit(self, address: Address | None) -> bool:
        """Whoever is connected from there has shown a cookie. False where there are too many of those."""
        if address is None or address in self._guests:
            return True
        self._guests = _open(self._guests)
        if address not in self._strangers or len(self._guests) >= GUESTS:
            return False
        self._guests[address] = self._strangers.pop(address)
        return True

    @property
    def connected(self) -> int:
        """Open connections."""
        self._strangers, self._guests = _open(self._strangers), _open(self._guests)
        return len(self._strangers) + len(self._guests)


def _open(sockets: dict[Address, socket.socket]) -> dict[Address, socket.socket]:
    return {address: found for address, found in sockets.items() if found.fileno() >= 0}
