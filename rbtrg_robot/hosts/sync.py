"""The synchronous host: stages in one process, messages delivered in a fixed order. Lockstep and re-runs stand on it.

Messages pass through their wire bytes here too, so a stage sees exactly what it would see live (a float32 field is a
float32), and a log of this host is a log of the real thing. What no stage and no listener hears is not encoded.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Any

from rbtrg_robot.stages.stage import Stage
from rbtrg_robot.topics import TOPICS, Topic
from rbtrg_robot.wire import messages

Sink = Callable[[Topic, bytes, int], None]
"""Called with topic, wire bytes and source clock [ns] for every message."""


class WiringError(RuntimeError):
    """A stage publishes what it did not declare, or two stages own one topic."""


class SyncHost:
    """Stages wired by their declared topics."""

    def __init__(self, stages: Mapping[str, tuple[Stage, float]], sink: Sink | None = None) -> None:
        """`stages`: name -> (stage, tick period [s]), ticked in this order. Raises WiringError."""
        self._stages = {name: stage for name, (stage, _) in stages.items()}
        self._period = {name: round(period * 1e9) for name, (_, period) in stages.items()}
        self._due = dict.fromkeys(stages, 0)
        self._sinks: dict[Topic, list[Sink]] = {}
        self._consumers: dict[Topic, list[str]] = {}
        owner: dict[Topic, str] = {}
        for name, stage in self._stages.items():
            for topic in stage.inputs:
                self._consumers.setdefault(topic, []).append(name)
            for topic in stage.outputs:
                # tf is the one topic with several writers in ROS.
                if topic in owner and topic.name != "/tf":
                    raise WiringError(f"{topic.name} is published by {owner[topic]} and {name}")
                owner[topic] = name
        self._pending: deque[tuple[Topic, bytes]] = deque()
        self._dead: set[str] = set()
        self.now = 0
        if sink:
            self.listen(sink)

    def stage(self, name: str) -> Any:
        """A stage by name, for tests that look inside."""
        return self._stages[name]

    def kill(self, name: str) -> None:
        """A stage dies: it hears and says nothing until `revive`."""
        self._dead.add(name)

    def revive(self, name: str, stage: Stage, restored: Mapping[Topic, bytes]) -> None:
        """A fresh stage takes the place of a dead one and is handed messages from before, as a restarted process is."""
        self._stages[name].close()
        self._stages[name] = stage
        self._dead.discard(name)
        for topic, payload in restored.items():
            self._collect(name, stage.on(topic, messages.decode(payload, topic.kind)))
        self._drain()

    def listen(self, sink: Sink, topics: Collection[Topic] = TOPICS) -> None:
        """Call `sink` for every message on `topics` from now on."""
        for topic in topics:
            self._sinks.setdefault(topic, []).append(sink)

    def inject(self, topic: Topic, message: Any) -> None:
        """Deliver a message from outside, and all that follows from it."""
        self.inject_bytes(topic, messages.encode(message))

    def inject_bytes(self, topic: Topic, payload: bytes) -> None:
        """The same from wire bytes."""
        self._pending.append((topic, payload))
        self._drain()

    def tick(self, now: int) -> None:
        """Move the clock to `now` [ns] and tick every stage whose period has come."""
        self.now = now
        for name, due in self._due.items():
            if now >= due and name not in self._dead:
                period = self._period[name]
                self._due[name] = (now // period + 1) * period
                outputs = self._stages[name].tick(now)
                if outputs:
                    self._collect(name, outputs)
                    self._drain()

    def _collect(self, name: str, outputs: list[tuple[Topic, Any]]) -> None:
        declared = self._stages[name].outputs
        for topic, message in outputs:
            if topic not in declared:
                raise WiringError(f"{name} published {topic.name} without declaring it")
            if type(message) is not topic.kind:
                raise WiringError(f"{name} published a {type(message).__name__} on {topic.name}")
            if topic in self._consumers or topic in self._sinks:
                self._pending.append((topic, messages.encode(message)))

    def _drain(self) -> None:
        while self._pending:
            topic, payload = self._pending.popleft()
            for sink in self._sinks.get(topic, ()):
                sink(topic, payload, self.now)
            consumers = self._consumers.get(topic)
            if not consumers:
                continue
            message = messages.decode(payload, topic.kind)
            for name in consumers:
                if name not in self._dead:
                    outputs = self._stages[name].on(topic, message)
                    if outputs:
                        self._collect(name, outputs)

    def close(self) -> None:
        """Close every stage."""
        for stage in self._stages.values():
            stage.close()
