"""What a lockstep stack does after a fault, judged by the simulator's truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Self

import numpy as np

from hal.types import NS, Sample
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import BASE
from rbtrg_robot.wire.messages import decode, header, stamp_of
from tools.bench.faults.fault import Outcome
from tools.bench.raised import Raised

REST_SPEED = 0.05
"""[m/s] slower is at rest; yaw rates double, in rad/s."""
FALLEN_COSINE = math.cos(math.radians(60.0))
"""Least cosine of the tilt of a robot that did not fall."""


def tap(stack: Lockstep, change: Callable[[list[Sample]], list[Sample]]) -> None:
    """From now on `change` stands between the robot's sensors and the stack."""
    backend = stack.robot.backend
    read = backend.read
    backend.read = lambda now: change(read(now))  # type: ignore[method-assign]


def by_hand(stack: Lockstep, vx: float, wz: float, seconds: float) -> None:
    """Hold a velocity [m/s, rad/s] by teleoperation for some time [s]."""
    for _ in range(round(25 * seconds)):
        command = msg.TwistStamped(header=header(stack.now, BASE))
        command.twist.linear.x, command.twist.angular.z = vx, wz
        stack.host.inject(t.TELEOP, command)
        stack.run(0.04)


class Watch:
    """Listens to a stack from now on, the instant of the fault. `outcome` after some time tells what came of it.

    The true error is how far the estimated pose came off the truth since then. As a context manager it closes the
    stack.
    """

    def __init__(self, stack: Lockstep) -> None:
        self._stack = stack
        self._began = stack.now
        self._truth: Any = stack.newest[t.TRUTH]
        self._start = _place(self._truth)
        self._moved = 0.0
        self._last = self._start
        self._moving_at: int | None = None
        self._fell = False
        self._error = 0.0
        self._raised = Raised(stack)
        stack.host.listen(self._hear, {t.TRUTH, t.ODOM, t.ODOM_HEALTH})
        self._good = stack.newest[t.ODOM_HEALTH].health == "good"
        self._offset = self._apart(stack.newest[t.ODOM])

    def _apart(self, odom: Any) -> np.ndarray:
        """(2,) estimated less true place [m]; both in axes of the world, for `odom` begins at the start with its
        heading."""
        x, y, yaw = self._stack.config.start_pose()
        p = odom.pose.pose.position
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array([x + c * p.x - s * p.y, y + s * p.x + c * p.y]) - _place(self._truth)

    def _hear(self, topic: Topic, payload: bytes, now: int) -> None:
        message = decode(payload, topic.kind)
        if topic is t.TRUTH:
            self._follow(message, now)
        elif topic is t.ODOM_HEALTH:
            self._good = message.health == "good"
        elif self._good:
            self._error = max(self._error, float(np.linalg.norm(self._apart(message) - self._offset)))

    def _follow(self, truth: Any, now: int) -> None:
        self._truth = truth
        here = _place(truth)
        self._moved += float(np.linalg.norm(here - self._last))
        self._last = here
        v, w, q = truth.twist.twist.linear, truth.twist.twist.angular, truth.pose.pose.orientation
        if math.hypot(v.x, v.y) > REST_SPEED or abs(w.z) > 2 * REST_SPEED:
            self._moving_at = now
        self._fell |= 1.0 - 2.0 * (q.x * q.x + q.y * q.y) < FALLEN_COSINE

    @property
    def words(self) -> str:
        """All that the operator could read since the fault, each once."""
        return self._raised.words

    def outcome(self) -> Outcome:
        """What came of the fault until now. A robot that moved within the last half second does not rest."""
        if self._moving_at is None:
            rest = 0.0
        elif self._stack.now - self._moving_at < NS // 2:
            rest = math.inf
        else:
            rest = (self._moving_at - self._began) / NS
        return Outcome(self._moved, rest, self.words, max(self._error, self._at_goal()), self._fell)

    def _at_goal(self) -> float:
        """True distance to a goal that is called reached [m]; 0 without one."""
        goal = self._stack.newest.get(t.GOAL_STATUS)
        if goal is None or goal.state != GoalState.REACHED or stamp_of(goal) < self._began:
            return 0.0
        return float(np.linalg.norm(_place(self._truth) - (goal.x, goal.y)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def _place(truth: Any) -> np.ndarray:
    p = truth.pose.pose.position
    return np.array([p.x, p.y])
