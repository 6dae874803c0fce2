"""What a live process took from the bus, in order, and a re-run that does the same.

A live process leaves out what newer messages overtook. What comes while it computes it takes later than the recorder
does. So the order of a log is not the order of a process; its journal is."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable

from hal.types import NS
from rbtrg_robot import msg, topics
from rbtrg_robot.log.read import Entry
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire import messages
from rbtrg_robot.wire.bus import Bus, Received

TICK = 255
"""Instead of a topic: the clock ticked."""
JOURNAL_PERIOD = 0.5
"""[s] between two journals of a process; what it took since the last one is lost with it."""
LAST_STAMP = 2**31 * NS
"""[ns] The first stamp that no message holds."""
SEQUENCE_COUNT = 2**32
"""MCAP keeps that much of a sequence number."""

Step = tuple[str, int, int, int]
"""Topic (empty: a tick), sequence and stamp [ns] of its publisher, and when the step was recorded [ns of the log]."""


class Journal:
    """Written by a live process."""

    def __init__(self, bus: Bus, process: str, inputs: Iterable[Topic]) -> None:
        self._bus = bus
        self._process = process
        self._names = [topic.name for topic in inputs]
        self._index = {name: k for k, name in enumerate(self._names)}
        self._steps: list[tuple[int, int, int]] = []
        self._due = 0.0
        bus.advertise(topics.JOURNAL)

    def took(self, received: Received) -> None:
        """The stage is given this message."""
        self._steps.append(
            (self._index[received.topic.name], received.sequence % SEQUENCE_COUNT, received.stamp)
        )

    def ticked(self, now: int) -> None:
        """The stage ticks at `now` [ns]."""
        self._steps.append((TICK, 0, now))

    def publish(self, now: int, *, last: bool = False) -> None:
        """Call once per turn of the loop; `last`: the process ends."""
        wall = time.monotonic()
        if not self._steps or (wall < self._due and not last):
            return
        self._due = wall + JOURNAL_PERIOD
        taken, sequence, stamp = zip(*self._steps, strict=True)
        self._steps.clear()
        self._bus.publish(
            topics.JOURNAL,
            msg.Journal(
                header=messages.header(now, ""),
                process=self._process,
                topic=self._names,
                taken=messages.array(taken, "uint8"),
                sequence=messages.array(sequence, "uint32"),
                stamp=messages.array(stamp, "int64"),
            ),
            now,
        )


def read_journals(entries: Iterable[Entry]) -> tuple[dict[str, deque[Step]], set[str]]:
    """Steps of each process of a log, and which were restarted in it: their steps end there. Broken journals do not
    count."""
    steps: dict[str, deque[Step]] = {}
    restarted: set[str] = set()
    for entry in entries:
        if entry.topic != topics.JOURNAL.name:
            continue
        try:
            journal = messages.decode(entry.data, topics.JOURNAL.kind)
        except messages.MessageError:
            continue
        if entry.sequence == 1 and journal.process in steps:
            restarted.add(journal.process)
        if journal.process in restarted:
            continue
        own = steps.setdefault(journal.process, deque())
        for index, sequence, stamp in zip(
            journal.taken.tolist(), journal.sequence.tolist(), journal.stamp.tolist(), strict=True
        ):
            if 0 <= stamp < LAST_STAMP and (index == TICK or index < len(journal.topic)):
                own.append(("" if index == TICK else journal.topic[index], sequence, stamp, entry.log_time))
    return steps, restarted
