"""The heartbeat of a process."""

from __future__ import annotations

import os
import time

from rbtrg_robot import msg, topics
from rbtrg_robot.wire import messages
from rbtrg_robot.wire.bus import Bus

HEARTBEAT_PERIOD = 0.5
"""[s]"""


class Heart:
    """Tells the supervisor twice a second that this process lives and what it did."""

    def __init__(self, bus: Bus, process: str) -> None:
        self._bus = bus
        self._process = process
        self._due = 0.0
        self._last_turn = time.monotonic()
        self._longest = 0.0
        bus.advertise(topics.HEARTBEAT)

    def beat(self, state: str = "ready", detail: str = "") -> None:
        """Call once per turn of the loop."""
        turn = time.monotonic()
        self._longest = max(self._longest, turn - self._last_turn)
        self._last_turn = turn
        if turn < self._due:
            return
        self._due = turn + HEARTBEAT_PERIOD
        published = {t.name: p for t, p in self._bus.publishers.items() if t is not topics.HEARTBEAT}
        now = self._bus.clock()
        self._bus.publish(
            topics.HEARTBEAT,
            msg.Heartbeat(
                header=messages.header(now, ""),
                process=self._process,
                pid=os.getpid(),
                state=state,
                detail="; ".join(filter(None, (detail, self._bus.intrusion()))),
                topic=list(published),
                published=messages.array([p.count for p in published.values()], "uint64"),
                newest=messages.array([p.newest for p in published.values()], "int64"),
                dropped=self._bus.dropped,
                refused=self._bus.refused,
                longest_turn=self._longest,
            ),
            now,
        )
        self._longest = 0.0
