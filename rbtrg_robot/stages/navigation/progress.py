"""Progress of the robot, and the way it came."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from hal.safety.monitors import GOAL_SPENT
from hal.types import NS
from rbtrg_robot.msg import Plan, RouteStatus

Pose2 = tuple[float, float, float]
"""x [m], y [m], yaw [rad] in `map`."""

TURNING = ("aligning", "final_turn")
"""Phases of the tracker in which it turns on the spot."""
NO_PROGRESS = 5.0, 0.15, 0.5
"""In so many seconds less than so many [m] and [rad]: a robot that is told to drive is stuck."""
AT_REST = 1.0, 0.02, 0.03
"""In so many seconds less than so many [m] and [rad]: the robot is at rest."""
SLOW_SPEED = 0.3
"""[m/s] at which ways are driven at least."""
BUDGET_SECONDS, NEW_PLACE = 25.0, 1.0
"""[s] of a `Budget`; [m] from all places before it a place is new:
a robot that shuttles before what it cannot cross, from one frontier to the other, stays within a body length or two of
where it was."""
BESIDE_PATH = 0.15
"""[m] beside a path a robot is off it. Plans that keep the path that is driven reach as far."""
STRAY_BESIDE = 0.10
"""[m] beside the line of a recovery a robot is off the ground that it covered on its way: it stands and asks for a
path. One that backed out of the edge of a bridge slid 0.22 m aside within a second and fell."""
TRAIL_SPACING = 0.05
TRAIL_LENGTH = 100
TRAIL_ANGLE = 0.1
"""A turn on the spot is part of the trail, too [rad]."""
EDGE_RISE = 0.03
"""[m] that the ground rises over three samples of a path (6 cm): no ramp that may be driven is as steep."""
BODY_MARGIN = 0.05
"""[m] beside the body the ground still counts as covered by it."""


OVER_EDGE = 3.0
"""[s] to come over a face on a route that does not hold any more: a body length at 0.25 m/s."""


class RouteWatch:
    """Whether the route that is driven still holds. While the robot stands on a face that the route crosses, it goes on
    for a moment.

    On the face the robot cannot stop and turn without a risk to tip, and the face under it looks different in every
    map. What is really in the way is the guard's business, which knows no routes.
    """

    def __init__(self, radius: float) -> None:
        """`radius`: from base_link to a corner of the body [m]."""
        self._under = radius + BODY_MARGIN
        self._why = ""
        self._since = 0

    def told(self, now: int, message: RouteStatus) -> None:
        """A RouteStatus of this route; `now` in ns."""
        why = "" if message.valid else message.detail or "the map changed"
        if why and not self._why:
            self._since = now
        self._why = why

    def broken(self, now: int, plan: Plan | None, pose: Pose2 | None) -> str:
        """Why the robot must stop on its route; empty while it may go on."""
        patient = now - self._since <= OVER_EDGE * NS
        return "" if patient and self.over_edge(plan, pose) else self._why

    def over_edge(self, plan: Plan | None, pose: Pose2 | None) -> bool:
        """Whether a Plan leads over an edge that lies under the robot."""
        if plan is None or pose is None:
            return False
        under = np.hypot(plan.x - pose[0], plan.y - pose[1]) < self._under
        return bool((np.abs(plan.z[3:] - plan.z[:-3]) > EDGE_RISE)[under[3:] & under[:-3]].any())


class Slide:
    """A robot that is beside its path and comes no nearer to it is where the planner did not look. One slid onto a
    hurdle, 0.28 m beside its path, and fell; turns on the spot move others by 0.2 m, and they come back to it."""

    def __init__(self) -> None:
        self._began: tuple[int, float] | None = None

    def off(self, now: int, beside: float) -> bool:
        """Whether it is off; `now` in ns, `beside` [m] the path."""
        if beside <= BESIDE_PATH:
            self._began = None
        elif self._began is None:
            self._began = now, beside
        return self._began is not None and now - self._began[0] >= NS and beside >= self._began[1]


class ProgressMonitor:
    """No progress for 5 s while it should drive = stuck; with other numbers: the robot is at rest."""

    def __init__(self, most: tuple[float, float, float] = NO_PROGRESS) -> None:
        """`most`: in so many seconds less than so many [m] and [rad]."""
        self._most = most
        self._anchor: tuple[int, Pose2] | None = None

    def reset(self) -> None:
        """A new path, or standing on purpose."""
        self._anchor = None

    def stuck(self, now: int, pose: Pose2) -> bool:
        """Call while driving is wanted; `now` in ns."""
        if self._anchor is None:
            self._anchor = (now, pose)
            return False
        since, (x, y, yaw) = self._anchor
        seconds, distance, angle = self._most
        moved = math.hypot(pose[0] - x, pose[1] - y) > distance
        if moved or abs(wrap(pose[2] - yaw)) > angle:
            self._anchor = (now, pose)
            return False
        return now - since > seconds * NS


class Budget:
    """How many seconds a goal may take without coming to a place where the robot has not been for it.

    A robot that shuttles, circles what it cannot enter or waits before it spends them; one that comes nearer, or looks
    at what it has not looked at, is somewhere new all the time. A plan adds the way back over old ground that it asks
    for, once.
    """

    def __init__(self) -> None:
        self._been: list[Pose2] = []
        self._last: int | None = None
        self._seconds = self._way = 0.0

    def plan(self, length: float) -> None:
        """The robot is to drive so far [m]."""
        self._way = max(self._way, length)

    def rest(self) -> None:
        """What passes from the last call to the next is not the goal's."""
        self._last = None

    def spent(self, now: int, pose: Pose2) -> str:
        """In words what was spent, where that is all there is; else empty. Call it while the goal is worked on; `now`
        in ns."""
        if self._last is not None:
            self._seconds += (now - self._last) / NS
        self._last = now
        if all(math.dist(pose[:2], place[:2]) > NEW_PLACE for place in self._been):
            self._been.append(pose)
            self._seconds = self._way = 0.0
        late = GOAL_SPENT.outside(self._seconds, high=BUDGET_SECONDS + self._way / SLOW_SPEED)
        return GOAL_SPENT.tell(seconds=self._seconds) if late else ""


class Trail:
    """The last few metres of the way the robot came."""

    def __init__(self, length: float, width: float) -> None:
        """Of the body [m]."""
        self._half, self._side = length / 2, width / 2
        self._poses: deque[Pose2] = deque(maxlen=TRAIL_LENGTH)

    def forget(self) -> None:
        """The robot came from nowhere."""
        self._poses.clear()

    def add(self, pose: Pose2) -> None:
        """Remember a pose, every 5 cm and 0.1 rad."""
        last = self._poses[-1] if self._poses else None
        if (
            last is None
            or math.dist(last[:2], pose[:2]) >= TRAIL_SPACING
            or abs(wrap(last[2] - pose[2])) >= TRAIL_ANGLE
        ):
            self._poses.append(pose)

    def reach(self, pose: Pose2, distance: float, barred: Collection[float] = ()) -> float:
        """How far straight along the heading, at most `distance` [m], the body stays on ground it covered.

        Negative: backward, which also wins a tie. `barred`: -1.0 and 1.0 where it cannot go backward or forward. 0.0
        while the robot came from nowhere.
        """
        if len(self._poses) < 2:
            return 0.0
        x, y, yaw = pose
        runs = []
        for sign in (-1.0, 1.0):
            run = 0.0
            while run < distance and sign not in barred:
                ahead = min(run + TRAIL_SPACING, distance)
                # The end that leads, its corners and its middle, in the frame of the body now.
                tip = sign * (ahead + self._half)
                side = self._side * np.array([-1.0, 0.0, 1.0])
                points = np.column_stack(
                    [
                        x + tip * math.cos(yaw) - side * math.sin(yaw),
                        y + tip * math.sin(yaw) + side * math.cos(yaw),
                    ]
                )
                if not self._covered(points):
                    break
                run = ahead
            runs.append(run)
        return -runs[0] if runs[0] > 0.0 and runs[0] >= runs[1] else runs[1]

    def _covered(self, points: NDArray[np.float64]) -> bool:
        """Whether the body stood over all of these, (n, 2) [m]."""
        trail = np.array(self._poses)
        dx, dy = (points[:, None, k] - trail[:, k] for k in (0, 1))
        c, s = np.cos(trail[:, 2]), np.sin(trail[:, 2])
        along, across = np.abs(c * dx + s * dy), np.abs(c * dy - s * dx)
        inside = (along < self._half + BODY_MARGIN) & (across < self._side + BODY_MARGIN)
        return bool(inside.any(axis=1).all())
