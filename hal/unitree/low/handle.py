"""The host's end of the process of the motor loop."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import time
from typing import Any, Protocol

from hal.unitree.api import WireError
from hal.unitree.low.loop import LEAVING_TIME, Order, Report
from hal.unitree.low.pipe import Lines, write

log = logging.getLogger(__name__)

SILENT_AFTER = 0.5
"""[s] without a report: the loop hangs."""
CLOSING_TIME = LEAVING_TIME + 4.0
"""[s] for the robot to lie down and go soft."""


class Motors(Protocol):
    """A motor loop, wherever it runs. Nothing blocks but `close`."""

    def tell(self, order: Order) -> None:
        """What the host wants now."""

    def report(self) -> Report | None:
        """The newest report; None before the first."""

    def lost(self) -> str:
        """Why the loop counts as lost, in words; empty while it works."""

    def close(self) -> None:
        """The host goes: the robot lies down, its joints go soft, the loop ends. Bounded."""


class MotorProcess:
    """`Motors` in a process of its own, which has a watchdog process beside it."""

    def __init__(self, settings: dict[str, Any]) -> None:
        """settings: see `hal.unitree.low.process.main`."""
        command = [sys.executable, "-m", "hal.unitree.low.process", json.dumps(settings)]
        # A session of its own: a Ctrl-C in the terminal must not end the balance of the robot.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in = self._process.stdin.fileno()
        os.set_blocking(self._in, False)
        self._lines = Lines(self._process.stdout.fileno())
        self._report: Report | None = None
        self._heard = time.monotonic()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def tell(self, order: Order) -> None:
        """What the host wants now. A full or broken pipe shows as silence, see `lost`."""
        write(self._in, order.pack())

    def report(self) -> Report | None:
        """The newest report; None before the first."""
        for line in self._lines.read():
            try:
                self._report = Report.unpack(line)
            except WireError as error:
                log.warning("%s", error)
                continue
            self._heard = time.monotonic()
        return self._report

    def lost(self) -> str:
        """Why the loop counts as lost, in words; empty while it works, or starts."""
        self.report()
        if self._process.poll() is not None:
            return "the process of the motor loop ended: its reason is in the log above"
        if self._report is not None and time.monotonic() - self._heard > SILENT_AFTER:
            return "the process of the motor loop is silent"
        return ""

    def close(self) -> None:
        """End it: it lies the robot down by itself; one that is lost is killed, and its watchdog makes the robot soft.
        Idempotent."""
        if self.lost():
            self._process.kill()
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.stdin.close()
        try:
            self._process.wait(CLOSING_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()  # its watchdog makes the robot soft
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
