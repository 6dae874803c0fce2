"""A robot that stands and has nowhere to go, and what it knows of its map."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.stages.navigation.goal import ACTIVE
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.frames import Planar, stands
from rbtrg_robot.wire.messages import stamp_of

STANDS_FOR = 2 * NS
LIMIT = 10.0
"""[s] until it is given up, by default."""
KEPT = 1000
"""Messages of odometry: 20 s and more."""
APART = NS // 50
"""[ns] between two stamps of the same scan, at most."""


class Still(Order):
    """Hears until the robot has stood for two seconds without a goal; sends nothing."""

    hears = (t.ODOM, t.GOAL_STATUS, t.MAP_STATUS, t.AREAS)

    def __init__(self, limit: float = LIMIT) -> None:
        """`limit` [s]: how long it is waited for."""
        super().__init__(math.inf, limit)
        self._since = 0
        """Stamp of the robot from which on it stood [ns]."""
        self.place: Planar = (math.nan, math.nan, math.nan)
        """Of base_link in `odom`."""
        self._told: deque[msg.Odometry] = deque(maxlen=KEPT)
        self.prior = ""
        """Hash of the file of the map that the stack began with."""
        self.areas: list[msg.GroundArea] = []
        """Drawn on the map."""
        self._goal = ""
        self._map = False

    def message(self) -> None:
        """Nothing is asked."""

    def take(self, topic: Topic, message: Any) -> None:
        """What the robot tells."""
        if t.AREAS.carried(message, topic):
            self.areas = message.areas
        elif t.GOAL_STATUS.carried(message, topic):
            self._goal = message.id if message.state in ACTIVE else ""
        elif t.MAP_STATUS.carried(message, topic):
            self.prior, self._map = message.prior, True
        elif t.ODOM.carried(message, topic):
            here, now = message.pose.pose, stamp_of(message)
            self.place = here.position.x, here.position.y, yaw_of(here.orientation)
            self._told.append(message)
            if not stands(message) or not self._since:
                self._since = now
            if self._map and not self._goal and now - self._since >= STANDS_FOR:
                self.outcome = Outcome(True, "")

    def silence(self) -> Outcome:
        """It moves, has somewhere to go, or tells nothing."""
        if math.isnan(self.place[0]):
            return Outcome(False, "the odometry tells no pose; see `rbtrg-robot status`")
        why = f"it is on its way to goal {self._goal}" if self._goal else "it moves"
        return Outcome(False, f"the robot must stand: {why}; wait, or end the goal with `rbtrg-robot cancel`")

    @property
    def heard(self) -> float:
        """For how long the odometry was heard, by its stamps [s]; 0 while nobody told of the map."""
        return (stamp_of(self._told[-1]) - stamp_of(self._told[0])) / NS if self._map and self._told else 0.0

    def odometry(self, stamp: int) -> msg.Odometry | None:
        """What it told of the scan at `stamp` [ns]; None where that was not heard."""
        nearest = min(self._told, key=lambda told: abs(stamp_of(told) - stamp), default=None)
        return None if nearest is None or abs(stamp_of(nearest) - stamp) > APART else nearest
