"""Whole maps on their way: block by block, one per tick. A large map in one piece would stop a stage for seconds."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from rbtrg_robot.msg import Message
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic


class MapBlocks:
    """Maps that are being sent, by name."""

    def __init__(self) -> None:
        self._left: dict[str, Iterator[tuple[Topic, Message]]] = {}

    def begin(self, name: str, blocks: Iterator[tuple[Topic, Message]]) -> Outputs:
        """Send these, the first at once; an earlier sending of this name ends."""
        self._left[name] = blocks
        return list(islice(blocks, 1))

    def due(self, most: int = 1) -> Outputs:
        """The next blocks of each, so many."""
        return [block for blocks in self._left.values() for block in islice(blocks, most)]

    def stop(self) -> None:
        """Nobody needs the rest."""
        self._left.clear()
