"""A stage: messages in, messages out. No I/O, no wall clock, no threads, no unseeded randomness.

The same object runs in three hosts: live on Zenoh (`node`), in lockstep with a simulator (`lockstep`), and offline
on a log (`rerun`). Messages are what `messages.decode` gives; a stage must not modify them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from rbtrg_robot.msg import Message
from rbtrg_robot.topics import Topic

Outputs = list[tuple[Topic, Message]]


class Stage(Protocol):
    """One process's logic."""

    @property
    def inputs(self) -> tuple[Topic, ...]:
        """Topics it takes."""

    @property
    def outputs(self) -> tuple[Topic, ...]:
        """Topics it publishes, and no others."""

    def warm_up(self) -> None:
        """Compile and allocate, so that the first message is handled as fast as the thousandth."""

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message. `topic.carried` tells mypy its type."""

    def tick(self, now: int) -> Outputs:
        """Called every period of the source clock; `now` in ns."""

    def close(self) -> None:
        """Release what was opened."""


@runtime_checkable
class WarmsLater(Protocol):
    """A stage that can do what no first goal needs."""

    def warm_up_rest(self) -> None:
        """`warm_up` for that."""


def warm(stage: Stage) -> None:
    """For all that it can do."""
    stage.warm_up()
    if isinstance(stage, WarmsLater):
        stage.warm_up_rest()


@runtime_checkable
class KeepsMap(Protocol):
    """A stage whose map grows with the ground that was seen."""

    def put_on(self, folder: Path) -> None:
        """Let the map put tiles far from the robot on this disk. The host calls it once, before the first message;
        otherwise everything stays in memory. The stage publishes the same either way."""


@runtime_checkable
class Shows(Protocol):
    """A stage that shows others something which costs time to make: it does so while somebody listens alone."""

    @property
    def shown(self) -> Topic:
        """Where it shows it, twice a second; one of `outputs`."""

    def show(self) -> Outputs:
        """What it looks like now. Changes nothing in the stage."""


@runtime_checkable
class NeedsAll(Protocol):
    """A stage that keeps a copy of something and is told of its changes alone."""

    @property
    def needs_all(self) -> tuple[Topic, ...]:
        """Inputs, each of one publisher, of which it needs every message."""

    def missed(self, topic: Topic) -> None:
        """A message of one of these was lost before the next one that `on` is given."""
