"""One question to the planner at a time."""

from __future__ import annotations

import numpy as np

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot.stages.navigation.goal import Goal
from rbtrg_robot.stages.navigation.progress import Pose2
from rbtrg_robot.wire.messages import header

NEAR_END, NEAR_PERIOD = 0.6, 0.5
"""So near to the end of a path into unseen ground [m] the robot asks for its continuation this often [s]: it need not
stop there."""


class PlanQuery:
    """Numbers the questions, knows whether one is open, and which answer belongs to it. Times in ns."""

    def __init__(self, period: float) -> None:
        """`period` [s] between two questions on the way into unseen ground."""
        self._period = period
        self.open = False
        self._sequence = 0
        self._asked = 0
        self._first_asked = 0
        self._answered = 0

    def ask(
        self,
        now: int,
        goal: Goal,
        pose: Pose2,
        avoid: list[float],
        held: tuple[bool, bool],
        *,
        creep: bool = False,
        again: bool = False,
    ) -> msg.PlanRequest:
        """rbtrg_msgs/PlanRequest from `pose` to the goal; `avoid` holds x, y, radius [m] of places to keep off, `held`
        tells whether the guard
        held a turn there to the left, to the right; `creep`: a way onto ground that nobody saw is wanted where there is
        no other; `again`: it is the
        open question once more, from where the robot is by now."""
        if not again:
            self._sequence += 1
            self._first_asked = now
        self.open = True
        self._asked = now
        return msg.PlanRequest(
            header=header(now, "map"),
            goal_id=goal.id,
            sequence=self._sequence,
            start_x=pose[0],
            start_y=pose[1],
            start_yaw=pose[2],
            goal_x=goal.x,
            goal_y=goal.y,
            goal_yaw=goal.yaw or 0.0,
            has_goal_yaw=goal.yaw is not None,
            held_left=held[0],
            held_right=held[1],
            creep=creep,
            accept_risk=goal.accept_risk,
            avoid=np.array(avoid, np.float64),
        )

    def answers(self, now: int, goal: Goal, message: msg.Plan) -> bool:
        """Whether a Plan answers the open question, which is closed then."""
        if not self.open or message.goal_id != goal.id or message.sequence != self._sequence:
            return False
        self.open = False
        self._answered = now
        return True

    def drop(self) -> None:
        """No answer is wanted any more."""
        self.open = False

    def is_about_route(self, message: msg.RouteStatus) -> bool:
        """Whether a RouteStatus speaks of the newest route, and no newer one is asked for."""
        return not self.open and message.sequence == self._sequence

    def due(self, now: int, tracker: msg.TrackerState | None, *, on_edge: bool, creeps: bool = False) -> bool:
        """Whether to ask again on the way into unseen ground, with so much of the path to go. A robot `on_edge` could
        not turn into another
        route; but where its own ends, it would stop there. One that turns on the spot ends that first: it would turn
        back as often as not. One that
        `creeps` does not come far from one question to the next.
        """
        if tracker is not None and tracker.phase == "aligning":
            return False
        near = tracker is not None and tracker.distance_left < NEAR_END and not creeps
        return self.age(now) > (min(self._period, NEAR_PERIOD) if near else self._period) and (
            near or not on_edge
        )

    def waited(self, now: int) -> float:
        """Since the open question was first asked [s]."""
        return (now - self._first_asked) / NS

    def silence(self, now: int) -> float:
        """Since it was asked last [s]."""
        return (now - self._asked) / NS

    def age(self, now: int) -> float:
        """Of the newest answer [s]."""
        return (now - self._answered) / NS
