"""What a stack tells of its pose and its map, kept for a while."""

from __future__ import annotations

from collections import deque
from typing import Any

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import stamp_of

KEPT_POSES = 1000
"""Messages of odometry: 20 s and more."""
STAMP_GAP = NS // 50
"""[ns] between two stamps of the same scan, at most."""


class Heard:
    """Messages in; the pose at a scan, and the map, out."""

    hears = (t.ODOM, t.MAP_STATUS, t.AREAS)

    def __init__(self) -> None:
        self._told: deque[tuple[msg.Odometry, float]] = deque(maxlen=KEPT_POSES)
        self._status: msg.MapStatus | None = None
        self.areas: list[msg.GroundArea] = []
        """Drawn on the map."""

    def take(self, topic: Topic, message: Any) -> None:
        """One message."""
        if t.AREAS.carried(message, topic):
            self.areas = message.areas
        elif t.MAP_STATUS.carried(message, topic):
            self._status = message
        elif t.ODOM.carried(message, topic) and self._status is not None:
            self._told.append((message, self._status.height_correction))

    @property
    def prior(self) -> str:
        """Hash of the file of the map that the stack began with."""
        return self._status.prior if self._status is not None else ""

    @property
    def seconds(self) -> float:
        """For how long the odometry was heard, by its stamps [s]; 0 while nobody told of the map."""
        return (stamp_of(self._told[-1][0]) - stamp_of(self._told[0][0])) / NS if self._told else 0.0

    @property
    def newest(self) -> int:
        """Stamp of the newest odometry [ns]."""
        return stamp_of(self._told[-1][0]) if self._told else 0

    def odometry(self, stamp: int) -> tuple[msg.Odometry, float] | None:
        """What it told of the scan at `stamp` [ns], and how much higher [m] the map lay then; None where that was not
        heard."""
        nearest = min(self._told, key=lambda told: abs(stamp_of(told[0]) - stamp), default=None)
        return None if nearest is None or abs(stamp_of(nearest[0]) - stamp) > STAMP_GAP else nearest
