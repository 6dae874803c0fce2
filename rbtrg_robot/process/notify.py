"""What systemd is told of the stack (sd_notify(3)): a datagram on the socket that NOTIFY_SOCKET names, no library."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Mapping

from rbtrg_robot.terminal import plain

log = logging.getLogger(__name__)


class Notifier:
    """Tells the service manager. Does nothing where none listens."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        """`environment`: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID as systemd sets them."""
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self.wanted = bool(address)
        """A service manager listens; what is printed goes to its journal."""
        self._socket: socket.socket | None = None
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)  # a busy manager must not stall the supervisor
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        usec = environment.get("WATCHDOG_USEC", "")
        self.period = int(usec) / 1e6 / 4 if ours and usec.isdigit() else 0.0
        """[s] between signs of life: a quarter of the limit. 0: nobody waits for them."""
        self._due = 0.0
        self._told = ""

    def ready(self) -> None:
        """Start-up is complete; the watchdog counts from here."""
        self._send("READY=1")

    def alive(self) -> None:
        """Call in every turn of the loop that is watched."""
        now = time.monotonic()
        if self.period and now >= self._due:
            self._due = now + self.period
            self._send("WATCHDOG=1")

    def status(self, words: str) -> None:
        """One line for `systemctl status`; sent when it changes."""
        if words != self._told:
            self._told = words
            self._send(f"STATUS={plain(words)}")  # a line of its own would be another message

    def stopping(self) -> None:
        """The end has begun."""
        self._send("STOPPING=1")

    def _send(self, text: str) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError as error:
            log.warning("the service manager was not told %s: %s", text, error.strerror)
