"""One process as the supervisor knows it, and the end of several."""

from __future__ import annotations

import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from rbtrg_robot.process.health import Health
from rbtrg_robot.process.leftovers import rotate
from rbtrg_robot.process.zygote import Forked
from rbtrg_robot.processes import Process

BACKOFF_TIMES = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Seconds before the n-th restart in a row."""
SETTLED_TIME = 30.0
"""A process that ran this long [s] starts over in BACKOFF_TIMES."""
PROCESS_LOG = 5_000_000
"""Bytes after which a process log is rotated: twice that stays on the disk."""


BUSY_LOAD = 5.0
"""[%]"""


@dataclass(slots=True)
class Child:
    """One supervised process."""

    row: Process
    forked: Forked | None = None
    started: float = 0.0
    busy: float = 0.0
    """When it last computed, more than `BUSY_LOAD` of a core."""
    restarts: int = 0
    in_a_row: int = 0
    due: float = 0.0
    fatal: str = ""
    """Why it gave up; it is not started again."""
    words: str = ""
    """Why it ended, until it is ready again."""
    usage: psutil.Process | None = None
    cpu: float = 0.0
    memory: float = 0.0
    log_path: Path = field(default_factory=Path)

    @property
    def alive(self) -> bool:
        """The process exists."""
        return self.forked is not None and self.forked.poll() is None

    def ended(self, now: float) -> float:
        """It has ended at `now`; returns the seconds after which it is due to be started anew."""
        self.in_a_row = 0 if now - self.started > SETTLED_TIME else self.in_a_row
        wait = BACKOFF_TIMES[min(self.in_a_row, len(BACKOFF_TIMES) - 1)]
        self.in_a_row += 1
        self.restarts += 1
        self.due = now + wait
        return wait

    def measure(self) -> None:
        """CPU since the last time, memory, and the length of what it printed."""
        if self.forked is not None:
            rotate(self.log_path, PROCESS_LOG)
        if self.alive and self.usage is not None:
            try:
                self.cpu = self.usage.cpu_percent()
                if self.cpu > BUSY_LOAD:
                    self.busy = time.monotonic()
                self.memory = self.usage.memory_info().rss / 1e6
            except psutil.Error:
                self.cpu = self.memory = 0.0

    def status(self, health: Health) -> dict[str, Any]:
        """Its row in `status --json`."""
        name = self.row.name
        age = health.beat_age(name)
        beat = health.beats.get(name)
        if self.fatal:
            state = f"failed: {self.fatal}"
        elif not self.alive:
            state = "restarting" if self.started else "starting"
        else:
            state = beat[1].state if beat else "starting"
        if self.words and state != "ready":
            state += f": {self.words}"
        return {
            "process": name,
            "pid": self.forked.pid if self.forked else None,
            "state": state,
            "restarts": self.restarts,
            "cpu": round(self.cpu, 1),
            "memory_mb": round(self.memory, 1),
            "heartbeat_age": None if age is None else round(age, 2),
            "dropped": beat[1].dropped if beat else 0,
            "refused": beat[1].refused if beat else 0,
            "detail": beat[1].detail if beat else "",
        }


def end(limits: dict[Forked, float]) -> None:
    """SIGTERM, then SIGKILL to those that exceed their limit [s]; returns when all are gone."""
    for process in limits:
        if process.poll() is None:
            process.terminate()
    began = time.monotonic()
    for process, limit in sorted(limits.items(), key=lambda entry: entry[1]):
        try:
            process.wait(max(0.0, began + limit - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
