"""A robot that stands and has nowhere to go, and what it knows of its map."""

from __future__ import annotations

import math
from typing import Any

from hal.rotation import wrap
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
"""[s] until it is given up."""
SAME = (0.05, math.radians(1.0))
"""[m, rad] within which a robot that was still is where it was."""


class Still(Order):
    """Hears until the robot has stood for two seconds without a goal; sends nothing."""

    hears = (t.ODOM, t.GOAL_STATUS, t.MAP_STATUS, t.AREAS)

    def __init__(self) -> None:
        super().__init__(math.inf, LIMIT)
        self.since = 0
        """Stamp of the robot from which on it stood [ns]."""
        self.place: Planar = (math.nan, math.nan, math.nan)
        """Of base_link in `odom`."""
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
            if not stands(message) or not self.since:
                self.since = now
            if self._map and not self._goal and now - self.since >= STANDS_FOR:
                self.outcome = Outcome(True, "")

    def silence(self) -> Outcome:
        """It moves, has somewhere to go, or tells nothing."""
        if math.isnan(self.place[0]):
            return Outcome(False, "the odometry tells no pose; see `rbtrg-robot status`")
        why = f"it is on its way to goal {self._goal}" if self._goal else "it moves"
        return Outcome(False, f"the robot must stand: {why}; wait, or end the goal with `rbtrg-robot cancel`")

    def left(self, before: Still) -> bool:
        """Whether it is somewhere else than it was `before`."""
        (x, y, yaw), (x0, y0, yaw0) = self.place, before.place
        return math.dist((x, y), (x0, y0)) > SAME[0] or abs(wrap(yaw - yaw0)) > SAME[1]
