"""What the navigator heard last from the others, and what of it is missing."""

from __future__ import annotations

import math
from typing import Any

from hal.safety.monitors import PLACE_UNSURE
from hal.safety.touch import FACE_HEIGHT
from hal.types import FELT_EDGE, NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.navigation.progress import TURNING
from rbtrg_robot.stages.navigation.reasons import Reason, absence, unlocated
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import stamp_of

ROOM_AHEAD = 0.2
"""[m/s] that the guard must allow forward: it stops the robot within 0.1 m then."""
TURN_HELD = 0.1
"""[rad/s] A turn that the guard lets go on no faster than this is held."""

WAY_HELD = 0.05
"""[m/s] A robot that the guard slows down to less than this is held."""


DATED = (t.ODOM, t.MAP_STATUS)
"""Topics without which no goal is driven, by what they tell of."""


class Inputs:
    """Newest states of robot, tracker, odometry, map and guard, and when each topic was heard. Times in ns."""

    def __init__(self) -> None:
        self.robot: msg.RobotState | None = None
        self.tracker: msg.TrackerState | None = None
        self.map: msg.MapStatus | None = None
        self.limits: msg.MotionLimits | None = None
        self._health: msg.OdometryHealth | None = None
        self._heard: dict[Topic, int] = {}

    @property
    def phase(self) -> str:
        """Of the tracker; empty before it was heard."""
        return self.tracker.phase if self.tracker is not None else ""

    @property
    def distance_left(self) -> float:
        """To the end of the tracker's path [m]; 0 before it was heard."""
        return self.tracker.distance_left if self.tracker is not None else 0.0

    @property
    def way(self) -> float:
        """1.0 while the robot is driven forward, -1.0 backward, 0.0 while it turns on the spot."""
        if self.phase in TURNING:
            return 0.0
        return -1.0 if self.robot is not None and self.robot.vx < 0.0 else 1.0

    @property
    def edge(self) -> bool:
        """Whether the wheels feel an edge ahead."""
        return self.robot is not None and self.robot.cause.startswith(f"{FELT_EDGE} ahead")

    @property
    def room_ahead(self) -> bool:
        """Whether the guard lets the robot forward, a decimetre at least."""
        return self.limits is not None and self.limits.forward >= ROOM_AHEAD

    @property
    def astride(self) -> bool:
        """Whether a face lies under the body, by the guard's map."""
        return (
            self.limits is not None and min(self.limits.uneven_ahead, self.limits.uneven_behind) > FACE_HEIGHT
        )

    @property
    def turn_held(self) -> float:
        """1.0 where the guard holds the robot in the turn on the spot to the left that the tracker makes, -1.0 in one
        to the right, else 0.0."""
        if self.limits is None or self.tracker is None or self.phase != "aligning":
            return 0.0
        error = self.tracker.heading_error
        held = error != 0.0 and (self.limits.left if error > 0.0 else self.limits.right) < TURN_HELD
        return math.copysign(1.0, error) if held else 0.0

    @property
    def beside(self) -> float:
        """[m] beside the path that the robot follows; 0 while it follows none."""
        return (
            abs(self.tracker.cross_track) if self.tracker is not None and self.phase == "following" else 0.0
        )

    @property
    def held(self) -> set[float]:
        """The ways straight on that the guard holds: -1.0 backward, 1.0 forward."""
        ways = () if self.limits is None else ((-1.0, self.limits.backward), (1.0, self.limits.forward))
        return {way for way, limit in ways if limit < WAY_HELD}

    @property
    def way_held(self) -> bool:
        """Whether the guard holds the robot on its path, or lets it creep the way it is driven.

        A robot that stands does not tell which way it is to be driven; where the tracker drives it, the guard holds one
        of them.
        """
        if self.robot is None or self.tracker is None or self.phase != "following":
            return False
        if self.robot.vx == 0.0:
            return not self.tracker.hold and bool(self.held)
        return self.way in self.held

    def unsure(self, tolerance: float) -> str:
        """Why a robot that seems to be within `tolerance` [m] of its goal may be elsewhere, in words; empty where it is
        known well enough."""
        place = 2.0 * self._health.place_sigma if self._health is not None else 0.0
        return (
            PLACE_UNSURE.tell(place=place, asked=tolerance)
            if PLACE_UNSURE.outside(place, high=tolerance)
            else ""
        )

    def take(self, topic: Topic, message: Any, now: int) -> None:
        """Note one message of any topic."""
        # What odometry and map tell of counts, not when they came; a stamp ahead of the clock makes nothing younger.
        self._heard[topic] = min(now, stamp_of(message)) if topic in DATED else now
        if t.ODOM_HEALTH.carried(message, topic):
            self._health = message
        elif t.MAP_STATUS.carried(message, topic):
            self.map = message
        elif t.TRACKER_STATE.carried(message, topic):
            self.tracker = message
        elif t.ROBOT_STATE.carried(message, topic):
            self.robot = message
        elif t.MOTION_LIMITS.carried(message, topic):
            self.limits = message

    def restart(self) -> None:
        """The clock was reset: stamps of before mean nothing."""
        self._heard.clear()

    def planner_silent(self, now: int, seconds: float) -> bool:
        """Whether the planner, once it was heard, has said nothing for so long [s]: an answer is a sign of life,
        too."""
        heard = max(self._heard.get(t.ROUTE_STATUS, now), self._heard.get(t.PLAN, 0))
        return now - heard > seconds * NS

    def missing(self, now: int, timeout: float, *, frame: bool) -> tuple[Reason, str] | None:
        """Why a goal must wait. `timeout` [s] for odometry and map; `frame`: it is known where `odom` lies in `map`."""
        if (away := absence(self.robot, self._health)) is not None:
            return away
        if (lost := unlocated(self.map)) is not None:
            return lost
        if not frame:
            return Reason.PROCESS_LOST, f"no {t.TF_STATIC.name} yet"
        ages = ((topic, (now - self._heard.get(topic, 0)) / NS) for topic in DATED)
        old = (f"no {x.name} for {age:.1f} s" for x, age in ages if age > timeout)
        return next(((Reason.PROCESS_LOST, why) for why in old), None)
