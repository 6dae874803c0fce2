"""Lost messages: the publisher numbers its messages, and a stage that needs all of them is told of a gap."""

from __future__ import annotations

from rbtrg_robot.stages.stage import NeedsAll, Stage
from rbtrg_robot.topics import Topic


class Gaps:
    """Of one stage."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage if isinstance(stage, NeedsAll) else None
        self._expected: dict[Topic, int] = {}

    def look(self, topic: Topic, sequence: int) -> None:
        """The stage is about to get this message. A publisher that was started anew begins with 1."""
        if self._stage is None or topic not in self._stage.needs_all:
            return
        expected = self._expected.get(topic, 1)
        self._expected[topic] = sequence + 1
        if sequence not in (expected, 1):
            self._stage.missed(topic)
