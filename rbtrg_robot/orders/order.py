"""What all orders are: messages to send again, answers to hear, an outcome. Pure, as a stage is."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rbtrg_robot.msg import Message
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Bus

LONGEST_WAIT = 0.05
"""Longest wait [s] for a message between two looks at the clock."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How an order ended."""

    ok: bool
    words: str
    state: str = ""
    """Of a goal: its terminal state. Empty where nobody answered."""
    reason: str = ""
    """Of a goal: enum value of `Reason`."""


class Order(ABC):
    """Subclasses say what is sent and what the answers mean. Times in s of a clock that never goes back."""

    hears: tuple[Topic, ...] = ()
    sends: tuple[Topic, ...] = ()

    def __init__(self, repeat: float, limit: float) -> None:
        """Send every `repeat` [s]; give up `limit` [s] after the first sending."""
        self.outcome: Outcome | None = None
        self.began = math.nan
        self._repeat = repeat
        self._limit = limit
        self._sent = -math.inf

    @abstractmethod
    def message(self) -> tuple[Topic, Message] | None:
        """What is to be sent now; None where nothing is."""

    @abstractmethod
    def take(self, topic: Topic, message: Any) -> None:
        """Hear one message of `hears`; may set `outcome`."""

    @abstractmethod
    def silence(self) -> Outcome:
        """The outcome where nobody answered in time."""

    def tick(self, now: float) -> list[tuple[Topic, Message]]:
        """What is due."""
        if self.outcome is not None:
            return []
        self.began = now if math.isnan(self.began) else self.began
        if now - self.began > self._limit:
            self.outcome = self.silence()
            return []
        if now - self._sent < self._repeat:
            return []
        due = self.message()
        if due is None:
            return []
        self._sent = now
        return [due]


def send(bus: Bus, order: Order) -> None:
    """Publish what is due."""
    for topic, message in order.tick(time.monotonic()):
        bus.publish(topic, message, time.time_ns())


def follow(bus: Bus, order: Order, heard: Callable[[Any], None] = lambda _: None) -> Outcome:
    """Carry an order out to its end; `heard` gets every answer of its topics."""
    bus.subscribe(order.hears)
    for topic in order.sends:
        bus.advertise(topic)
    while order.outcome is None:
        send(bus, order)
        for received in bus.take(LONGEST_WAIT):
            message = bus.open(received) if received.topic in order.hears else None
            if message is None or order.outcome is not None:
                continue
            order.take(received.topic, message)
            heard(message)
    return order.outcome
