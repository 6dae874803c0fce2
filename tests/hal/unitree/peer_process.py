"""The peer as a process of its own, with what it reports of the robot's true motion."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from threading import Condition, Thread

from tests.places import ROOT

REST = 0.05
"""[m/s]; below it the robot is at rest."""
TURNING = 0.1
"""[rad/s]; the same."""


class PeerProcess:
    """The peer with its reports collected."""

    def __init__(self, domain: int, *arguments: str) -> None:
        command = [
            sys.executable,
            "-m",
            "tests.hal.unitree.peer",
            "--domain",
            str(domain),
            "--report",
            *arguments,
        ]
        self.process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.reports: list[dict] = []
        self._news = Condition()
        assert self.process.stdout is not None
        assert self.process.stdout.readline().startswith("robot on lo")
        self._thread = Thread(target=self._collect, daemon=True)
        self._thread.start()

    def _collect(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._news:
                self.reports.append(json.loads(line))
                self._news.notify_all()

    def until(self, condition: Callable[[], bool], seconds: float = 60.0) -> None:
        """Wait for reports until `condition()`; fail in the end."""
        with self._news:
            assert self._news.wait_for(condition, seconds), "the robot did not do it"

    def say(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    @property
    def last(self) -> dict:
        return self.reports[-1]

    def first_rest_after(self, moment: float, lasting: float = 0.3) -> float:
        """Seconds from `moment` (monotonic) until the robot was at rest for `lasting` [s]; NaN if it never was."""
        since = None
        for row in self.reports[:]:
            if row["t"] < moment or abs(row["v"]) > REST or abs(row["wz"]) > TURNING:
                since = None
            elif since is None:
                since = row["t"]
            elif row["t"] - since >= lasting:
                return float(since) - moment
        return math.nan

    @property
    def at_rest(self) -> bool:
        """Whether the robot stands now."""
        return abs(self.last["v"]) < REST and abs(self.last["wz"]) < TURNING

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self._thread.join(2.0)
