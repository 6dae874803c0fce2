"""Is the robot getting anywhere, and which way did it come?"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from hal.types import NS

Pose2 = tuple[float, float, float]
"""x [m], y [m], yaw [rad] in `map`."""

TURNING = ("aligning", "final_turn")
"""Phases of the tracker in which it turns on the spot."""
STUCK_SECONDS = 5.0
STUCK_DISTANCE = 0.15
"""[m]: less than this in STUCK_SECONDS is no progress, unless it turned."""
STUCK_ANGLE = 0.5
"""[rad]."""
SAME_PLACE = 1.0
"""[m]"""
TRAIL_SPACING = 0.05
TRAIL_LENGTH = 60
STOOD = 0.25
"""[m] beside a place of base_link the ground still counts as stood on: about half the body's width."""


UNDER = 0.45
"""[m] around base_link is what lies under the body or its wheels."""
EDGE = 0.03
"""[m] that the ground rises over three samples of a path (6 cm): no ramp that may be driven is as steep."""


def wrap(angle: float) -> float:
    """Into -pi..pi."""
    return math.remainder(angle, 2 * math.pi)


def over_edge(plan: Any, pose: Pose2) -> bool:
    """Whether a Plan leads over an edge that lies under the robot."""
    under = np.hypot(plan.x - pose[0], plan.y - pose[1]) < UNDER
    return bool((np.abs(plan.z[3:] - plan.z[:-3]) > EDGE)[under[3:] & under[:-3]].any())


class ProgressMonitor:
    """No progress for 5 s while it should drive = stuck."""

    def __init__(self) -> None:
        self._anchor: tuple[int, Pose2] | None = None
        self._stuck_at: list[Pose2] = []

    def reset(self) -> None:
        """A new path, or standing on purpose."""
        self._anchor = None

    def stuck(self, now: int, pose: Pose2) -> bool:
        """Call while driving is wanted; `now` in ns."""
        if self._anchor is None:
            self._anchor = (now, pose)
            return False
        since, (x, y, yaw) = self._anchor
        moved = math.hypot(pose[0] - x, pose[1] - y) > STUCK_DISTANCE
        if moved or abs(wrap(pose[2] - yaw)) > STUCK_ANGLE:
            self._anchor = (now, pose)
            return False
        return now - since > STUCK_SECONDS * NS

    def tries(self, pose: Pose2) -> int:
        """Note that it is stuck here; how often it was at this place, this time included."""
        self._stuck_at.append(pose)
        return sum(math.dist(pose[:2], other[:2]) < SAME_PLACE for other in self._stuck_at)


class Trail:
    """The last 3 m of the way the robot came."""

    def __init__(self) -> None:
        self._poses: deque[Pose2] = deque(maxlen=TRAIL_LENGTH)

    def add(self, pose: Pose2) -> None:
        """Remember a pose, every 5 cm."""
        if not self._poses or math.dist(self._poses[-1][:2], pose[:2]) >= TRAIL_SPACING:
            self._poses.append(pose)

    def reach(self, pose: Pose2, distance: float) -> float:
        """How far straight along the heading, at most `distance` [m], the body stays on ground it stood on.

        Negative: backward, which also wins a tie. 0.0 while the robot came from nowhere.
        """
        if len(self._poses) < 2:
            return 0.0
        stood = np.array(self._poses)[:, :2]
        x, y, yaw = pose
        runs = []
        for sign in (-1.0, 1.0):
            run = 0.0
            while run < distance:
                ahead = sign * min(run + TRAIL_SPACING, distance)
                place = (x + ahead * math.cos(yaw), y + ahead * math.sin(yaw))
                if np.hypot(*(stood - place).T).min() > STOOD:
                    break
                run = abs(ahead)
            runs.append(run)
        return -runs[0] if runs[0] >= runs[1] else runs[1]
