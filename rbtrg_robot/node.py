"""The live host: one stage, one process, one thread, on Zenoh."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable

from rbtrg_robot import messages, topics
from rbtrg_robot.bus import Bus
from rbtrg_robot.processes import Process
from rbtrg_robot.stage import Outputs, Stage
from rbtrg_robot.topics import Topic

HEARTBEAT_PERIOD = 0.5
log = logging.getLogger(__name__)


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
        wall = time.time_ns()
        self._bus.publish(
            topics.HEARTBEAT,
            messages.make(
                topics.HEARTBEAT.type,
                header=messages.header(wall, ""),
                process=self._process,
                pid=os.getpid(),
                state=state,
                detail=detail,
                topic=list(published),
                published=messages.array([p.count for p in published.values()], "uint64"),
                newest=messages.array([p.newest for p in published.values()], "int64"),
                dropped=self._bus.dropped,
                longest_turn=self._longest,
            ),
            wall,
        )
        self._longest = 0.0


class Node:
    """Drives a stage: inbox -> `on`, clock -> `tick`, outputs -> bus."""

    def __init__(self, process: Process, stage: Stage, bus: Bus, *, simulated: bool) -> None:
        self._stage = stage
        self._bus = bus
        self._simulated = simulated
        self._period = round(process.period * 1e9)
        self._tick = -1
        self._undecodable = 0
        self._heart = Heart(bus, process.name)
        for topic in stage.outputs:
            bus.advertise(topic)
        bus.subscribe(stage.inputs)
        if simulated:
            bus.subscribe([topics.CLOCK])
        self.now = 0

    def restore(self, restored: dict[Topic, bytes]) -> None:
        """Hand over the newest messages from before a restart."""
        for topic, payload in restored.items():
            self._publish(self._stage.on(topic, messages.decode(payload, topic.type)))

    def run(self, stopping: Callable[[], bool]) -> None:
        """Until `stopping()`."""
        while not stopping():
            self._heart.beat()
            wait = 0.1 if self._simulated else self._period / 1e9
            for received in self._bus.take(min(wait, 0.1)):
                try:
                    message = received.decode()
                except messages.MessageError as error:
                    self._undecodable += 1
                    if self._undecodable in (1, 10, 100, 1000):
                        log.warning("message %d refused: %s", self._undecodable, error)
                    continue
                if received.topic is topics.CLOCK:
                    self.advance(messages.stamp_of(message))
                else:
                    self._publish(self._stage.on(received.topic, message))
            if not self._simulated:
                self.advance(time.time_ns())

    def advance(self, now: int) -> None:
        """Move the clock; one tick when a period boundary was passed, however many were missed."""
        self.now = now
        tick = now // self._period
        if tick != self._tick:
            self._tick = tick
            self._publish(self._stage.tick(now))

    def _publish(self, outputs: Outputs) -> None:
        for topic, message in outputs:
            self._bus.publish(topic, message, messages.stamp_of(message) or self.now)
