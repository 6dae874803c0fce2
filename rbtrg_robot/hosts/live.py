"""The live host: one stage, one process, one thread, on Zenoh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rbtrg_robot import topics
from rbtrg_robot.hosts.gaps import Gaps
from rbtrg_robot.hosts.journal import Journal
from rbtrg_robot.processes import Process
from rbtrg_robot.stages.stage import KeepsMap, Outputs, Shows, Stage
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire import messages
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.heart import Heart

SHOW_PERIOD = 500_000_000
"""[ns] between two messages that are made for listeners alone."""


class Node:
    """Drives a stage: inbox -> `on`, clock -> `tick`, outputs -> bus."""

    def __init__(
        self, process: Process, stage: Stage, bus: Bus, *, simulated: bool, folder: str = ""
    ) -> None:
        """folder: of the run, where a map puts tiles far from the robot; empty: it keeps all in memory."""
        self._stage = stage
        if folder and isinstance(stage, KeepsMap):
            stage.put_on(Path(folder))
        self._bus = bus
        self._simulated = simulated
        self._period = round(process.period * 1e9)
        self._tick = -1
        self._heart = Heart(bus, process.name)
        self._journal = Journal(bus, process.name, stage.inputs)
        self._gaps = Gaps(stage)
        for topic in stage.outputs:
            bus.advertise(topic)
        self._shows = stage if isinstance(stage, Shows) else None
        self._shown = -1
        bus.subscribe(stage.inputs)
        if simulated:
            bus.subscribe([topics.CLOCK])
        self.now = 0

    def restore(self, restored: dict[Topic, bytes]) -> None:
        """Hand over the newest messages from before a restart."""
        for topic, payload in restored.items():
            self._publish(self._stage.on(topic, messages.decode(payload, topic.kind)))

    def run(self, stopping: Callable[[], bool]) -> None:
        """Until `stopping()`."""
        while not stopping():
            self._heart.beat()
            wait = 0.1 if self._simulated else self._period / 1e9
            for received in self._bus.take(min(wait, 0.1)):
                message = self._bus.open(received)
                if message is None:
                    continue
                if received.topic is topics.CLOCK:
                    self.advance(messages.stamp_of(message))
                else:
                    self._journal.took(received)
                    self._gaps.look(received.topic, received.sequence)
                    self._publish(self._stage.on(received.topic, message))
            if not self._simulated:
                self.advance(self._bus.clock())
            self._journal.publish(self.now)
        self._journal.publish(self.now, last=True)

    def advance(self, now: int) -> None:
        """Move the clock; one tick when a period boundary was passed, however many were missed."""
        self.now = now
        tick = now // self._period
        if tick != self._tick:
            self._tick = tick
            self._journal.ticked(now)
            self._publish(self._stage.tick(now))
            self._show(now)

    def _show(self, now: int) -> None:
        """What is made for others alone is made while somebody listens, and never recorded: a re-run needs none of
        it."""
        due = now // SHOW_PERIOD
        if self._shows is None or due == self._shown:
            return
        if self._bus.advertise(self._shows.shown).wanted:
            self._shown = due
            self._publish(self._shows.show())

    def _publish(self, outputs: Outputs) -> None:
        for topic, message in outputs:
            self._bus.publish(topic, message, messages.stamp_of(message) or self.now)
