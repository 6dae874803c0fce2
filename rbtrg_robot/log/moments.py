"""Moments worth a later look: stops, falls, touches, refusals. Thinly recorded topics are recorded in full around
them."""

from __future__ import annotations

from collections import deque
from typing import Any

from rbtrg_robot import topics as t
from rbtrg_robot.topics import Topic

TIME_AROUND = 5.0
"""[s] before and after."""
FAILED = ("rejected", "aborted")
"""States of a goal that was not reached for a reason of its own."""
HEARS: tuple[Topic, ...] = (t.ROBOT_STATE, t.GOAL_STATUS, t.TOUCHED)


class Moments:
    """Notices them in the messages of HEARS."""

    def __init__(self) -> None:
        self._wrong: dict[Topic, tuple[Any, ...]] = {}
        self._refused: int | None = None
        """Commands that were refused since the start, as the newest state told; None where it told of a latch."""

    def begins(self, topic: Topic, message: Any) -> bool:
        """Whether something has just gone wrong: a stop, a fault, a touch, a command that was refused, a goal that
        ended without being reached."""
        if t.TOUCHED.carried(message, topic):
            return True
        if t.ROBOT_STATE.carried(message, topic):
            now: tuple[Any, ...] = (message.estop, message.phase == "fault", message.hold.startswith("guard"))
            worse = any(b and not a for a, b in zip(self._wrong.get(topic, (False,) * 3), now, strict=True))
            # While something is to be released, commands are refused all the time.
            count = None if message.latch else int(message.refused_count.sum())
            worse |= count is not None and self._refused is not None and count > self._refused
            self._refused = count
        elif t.GOAL_STATUS.carried(message, topic):
            failed = message.state in FAILED
            now = (message.id, failed)
            worse = failed and self._wrong.get(topic) != now
        else:
            return False
        self._wrong[topic] = now
        return bool(worse)


class Thinned:
    """One message a period, all of them around moments. Those before wait here until they are too old."""

    def __init__(self, period: float) -> None:
        """`period`, and all times below, in s of one clock."""
        self._period = period
        self._due = self._until = float("-inf")
        self._before: deque[tuple[float, Any]] = deque()

    def take(self, message: Any, now: float) -> list[Any]:
        """A message; those to be written now."""
        if now < self._until or now >= self._due:
            self._due = now + 0.9 * self._period  # messages come a little early and a little late
            return [message]
        self._before.append((now, message))
        while now - self._before[0][0] > TIME_AROUND:
            self._before.popleft()
        return []

    def moment(self, now: float) -> list[Any]:
        """Something went wrong: the messages of before that were not written."""
        self._until = now + TIME_AROUND
        waiting = [message for at, message in self._before if now - at <= TIME_AROUND]
        self._before.clear()
        return waiting
