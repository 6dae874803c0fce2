"""The host of a re-run on a live log: each stage takes what its process took, in that order, and ticks when it
ticked."""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Mapping
from typing import Any

from hal.types import NS
from rbtrg_robot.hosts.gaps import Gaps
from rbtrg_robot.hosts.journal import Step
from rbtrg_robot.stages.stage import Stage
from rbtrg_robot.topics import BY_NAME, Topic
from rbtrg_robot.wire import messages

MESSAGE_PATIENCE = 5 * NS
"""[ns] of the log after a step was recorded: a message that has not come by then was never recorded, and the stage goes
on without it."""
KEPT_BEHIND = 64
"""Messages of a topic before the one just taken that are still kept: two publishers' may be taken in another order than
recorded."""

Made = Callable[[Topic, bytes, int, int, int], None]
"""Called with topic, wire bytes, time of the log, source clock [ns] and number of what a stage publishes."""


class Inbox:
    """What one stage may take: messages by the number and stamp their publisher gave them."""

    def __init__(self) -> None:
        self._waiting: dict[str, OrderedDict[tuple[int, int | None], tuple[int, bytes]]] = {}
        self._count = 0

    def put(self, topic: str, sequence: int, stamp: int | None, payload: bytes) -> None:
        """`stamp` None: made by a stage of this re-run, known by its number alone."""
        self._count += 1
        self._waiting.setdefault(topic, OrderedDict())[sequence, stamp] = (self._count, payload)

    def take(self, topic: str, sequence: int, stamp: int) -> bytes | None:
        """The message, None while it is not there."""
        waiting = self._waiting.get(topic)
        if waiting is None:
            return None
        found = waiting.pop((sequence, stamp), None) or waiting.pop((sequence, None), None)
        if found is None:
            return None
        number, payload = found
        while len(waiting) > KEPT_BEHIND and next(iter(waiting.values()))[0] < number:
            waiting.popitem(last=False)
        return payload


class Follower:
    """Stages that follow their journals. They depend on each other's messages alone, so the order of the log does not
    matter."""

    def __init__(
        self, stages: Mapping[str, tuple[Stage, float]], steps: Mapping[str, deque[Step]], made: Made
    ) -> None:
        self._stages = {name: stage for name, (stage, _) in stages.items()}
        self._steps = {name: steps[name] for name in stages}
        self._inboxes = {name: Inbox() for name in stages}
        self._gaps = {name: Gaps(stage) for name, stage in self._stages.items()}
        self._made = made
        self._numbers: Counter[Topic] = Counter()
        self.missing: Counter[str] = Counter()
        """Messages that a stage's process took and the log does not hold, by stage."""
        self.now = 0

    def offer(self, topic: Topic, payload: bytes, sequence: int, stamp: int, now: int) -> None:
        """A message of the log, recorded at `now` [ns]; then everything that can happen."""
        self.now = max(self.now, now)
        for name, stage in self._stages.items():
            if topic in stage.inputs:
                self._inboxes[name].put(topic.name, sequence, stamp, payload)
        self._run()
        for name, steps in self._steps.items():
            if steps and self.now - steps[0][3] > MESSAGE_PATIENCE:
                self._skip(name)

    def finish(self) -> None:
        """The log has ended: what a stage still waits for never comes."""
        while True:
            self._run()
            waiting = [name for name, steps in self._steps.items() if steps]
            if not waiting:
                break
            self._skip(waiting[0])
        for stage in self._stages.values():
            stage.close()

    def _skip(self, name: str) -> None:
        self._steps[name].popleft()
        self.missing[name] += 1

    def _run(self) -> None:
        moved = True
        while moved:
            moved = False
            for name, steps in self._steps.items():
                while steps and self._step(name, *steps[0][:3]):
                    steps.popleft()
                    moved = True

    def _step(self, name: str, topic: str, sequence: int, stamp: int) -> bool:
        """One step of one stage; False while its message is not there."""
        stage = self._stages[name]
        if not topic:
            self._publish(stage.tick(stamp), stamp)
            return True
        payload = self._inboxes[name].take(topic, sequence, stamp)
        if payload is None:
            return False
        kind = BY_NAME[topic]
        try:
            message = messages.decode(payload, kind.kind)
        except messages.MessageError:  # the process refused it, too
            return True
        self._gaps[name].look(kind, sequence)
        self._publish(stage.on(kind, message), stamp)
        return True

    def _publish(self, outputs: list[tuple[Topic, Any]], stamp: int) -> None:
        """Recorded when the newest message of the log was: a simulated clock shows another date than the log."""
        for topic, message in outputs:
            if topic.owner not in self._stages:  # others publish there too: all that was said is in the log
                continue
            payload = messages.encode(message)
            self._numbers[topic] += 1
            self._made(topic, payload, self.now, stamp, self._numbers[topic])
            for name, stage in self._stages.items():
                if topic in stage.inputs:
                    self._inboxes[name].put(topic.name, self._numbers[topic], None, payload)
