"""Goals: send one, watch it, cancel it, or ask what would become of it."""

from __future__ import annotations

import math
import time
from typing import Any

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.orders.limits import ANSWER_LIMIT, RESEND_PERIOD
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.orders.who import me
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.stages.navigation.reasons import words
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import header

ENDS = {state.value for state in GoalState if state.terminal}
SILENT = "the navigator does not answer"
WATCHED_LIMIT = ANSWER_LIMIT + 10.0
"""[s] without a word of a goal that was answered before."""
ASK_AGAIN, ASK_LIMIT = 4.0, 12.0
"""[s] A question costs the planner two searches: it is not repeated in haste."""
OVERDUE_TIME = 10.0
"""[s] after a goal's own timeout: a navigator that does not end it is waited for no longer."""


class SendGoal(Order):
    """Send a goal until the navigator answers, then watch it to its end, or to where it moves."""

    hears = (t.GOAL_STATUS,)
    sends = (t.GOAL_REQUEST,)

    def __init__(self, request: msg.GoalRequest, *, wait: bool) -> None:
        """`wait`: to the end of the goal; otherwise until it moves."""
        super().__init__(RESEND_PERIOD, ANSWER_LIMIT)
        self.status: msg.GoalStatus | None = None
        self._request = request
        self._wait = wait
        self._first = self._now = self._heard = math.nan

    def message(self) -> tuple[Topic, msg.Message] | None:
        """The goal, until it was answered."""
        return (t.GOAL_REQUEST, self._request) if self.status is None else None

    def tick(self, now: float) -> list[tuple[Topic, msg.Message]]:
        """The limit is one of silence, not of the whole drive."""
        self._now = now
        self._first = now if math.isnan(self._first) else self._first
        if self.status is not None:
            self.began, self._limit = self._heard, WATCHED_LIMIT
        if 0 < self._request.timeout < now - self._first - OVERDUE_TIME and self.outcome is None:
            self.outcome = Outcome(False, "goal timed out", "aborted", "timeout")
        return super().tick(now)

    def take(self, topic: Topic, message: Any) -> None:
        """A GoalStatus of this goal."""
        if message.id != self._request.id:
            return
        self.status, self._heard = message, self._now
        if message.state in ENDS:
            why = words(message.reason, message.detail)
            text = f"goal {message.state}" + (f": {why}" if why else "")
            self.outcome = Outcome(message.state == "reached", text, message.state, message.reason)
        elif not self._wait and message.state not in ("accepted", "planning"):
            self.outcome = Outcome(True, f"goal {message.state}", message.state)

    def silence(self) -> Outcome:
        """The navigator is gone."""
        return Outcome(False, SILENT)


class LastGoal(Order):
    """Ask what became of the newest goal; nothing is sent."""

    hears = (t.GOAL_STATUS,)

    def __init__(self) -> None:
        super().__init__(RESEND_PERIOD, ANSWER_LIMIT)
        self.status: msg.GoalStatus | None = None

    def message(self) -> None:
        """None: its status reaches a late listener."""

    def take(self, topic: Topic, message: Any) -> None:
        """A GoalStatus."""
        if not message.id:
            self.outcome = Outcome(False, "there was no goal yet")
        elif message.state not in ENDS:
            self.outcome = Outcome(False, f"the goal is not over: it is {message.state}", message.state)
        elif message.state == "reached":
            self.outcome = Outcome(False, "the last goal was reached", message.state)
        else:
            self.status, self.outcome = message, Outcome(True, "", message.state)

    def silence(self) -> Outcome:
        """The navigator is gone."""
        return Outcome(False, SILENT)


class CancelGoal(Order):
    """Cancel a goal until the navigator says that it is over."""

    hears = (t.GOAL_STATUS,)
    sends = (t.GOAL_REQUEST,)

    def __init__(self, goal_id: str = "", owner: str = "") -> None:
        """The present goal where the id is empty. `owner`: who cancels."""
        super().__init__(RESEND_PERIOD, ANSWER_LIMIT)
        self._id = goal_id
        self._owner = owner or me()

    def message(self) -> tuple[Topic, msg.Message]:
        """The cancellation."""
        stamp = header(time.time_ns(), "map")
        return t.GOAL_REQUEST, msg.GoalRequest(header=stamp, action=1, id=self._id, owner=self._owner)

    def take(self, topic: Topic, message: Any) -> None:
        """A GoalStatus."""
        if self._id not in ("", message.id):
            return
        if message.state == "cancelled":
            whose = f" of {message.owner}" if message.owner not in ("", self._owner) else ""
            self.outcome = Outcome(True, f"goal{whose} cancelled", "cancelled")
        elif message.state == "idle" or message.state in ENDS:
            last = f"; the last one was {message.state}" if message.state in ENDS else ""
            self.outcome = Outcome(True, f"no goal to cancel{last}", message.state)

    def silence(self) -> Outcome:
        """The navigator is gone."""
        return Outcome(False, SILENT)


class AskRoute(Order):
    """Ask the planner how a route would go, until it answers. Nothing moves."""

    hears = (t.ROUTE_REPORT,)
    sends = (t.ROUTE_QUESTION,)

    def __init__(self, question: msg.RouteQuestion) -> None:
        super().__init__(ASK_AGAIN, ASK_LIMIT)
        self.report: msg.RouteReport | None = None
        self._question = question

    def message(self) -> tuple[Topic, msg.Message]:
        """The question."""
        return t.ROUTE_QUESTION, self._question

    def take(self, topic: Topic, message: Any) -> None:
        """A RouteReport."""
        if message.question and message.id == self._question.id:
            self.report = message
            self.outcome = Outcome(bool(message.ok), words(message.reason, message.detail))

    def silence(self) -> Outcome:
        """The planner is gone, or works on a large map."""
        return Outcome(False, "the planner does not answer")
