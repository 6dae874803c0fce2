"""Is the robot getting anywhere, and which way did it come?"""

from __future__ import annotations

import math
from collections import deque

from hal.types import NS

Pose2 = tuple[float, float, float]
"""x [m], y [m], yaw [rad] in `map`."""

STUCK_SECONDS = 5.0
STUCK_DISTANCE = 0.15
"""[m]: less than this in STUCK_SECONDS is no progress, unless it turned."""
STUCK_ANGLE = 0.5
"""[rad]."""
TRAIL_SPACING = 0.05
TRAIL_LENGTH = 60


def wrap(angle: float) -> float:
    """Into -pi..pi."""
    return math.remainder(angle, 2 * math.pi)


class ProgressMonitor:
    """No progress for 5 s while it should drive = stuck."""

    def __init__(self) -> None:
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
        moved = math.hypot(pose[0] - x, pose[1] - y) > STUCK_DISTANCE
        if moved or abs(wrap(pose[2] - yaw)) > STUCK_ANGLE:
            self._anchor = (now, pose)
            return False
        return now - since > STUCK_SECONDS * NS


class Trail:
    """The last 3 m of the way the robot came."""

    def __init__(self) -> None:
        self._poses: deque[Pose2] = deque(maxlen=TRAIL_LENGTH)

    def add(self, pose: Pose2) -> None:
        """Remember a pose, every 5 cm."""
        if not self._poses or math.dist(self._poses[-1][:2], pose[:2]) >= TRAIL_SPACING:
            self._poses.append(pose)

    @property
    def known(self) -> bool:
        """Whether it came from anywhere."""
        return len(self._poses) > 1

    def back(self, pose: Pose2, distance: float) -> list[Pose2]:
        """The way back from `pose` over about `distance` [m], heading kept as it was; what is used is forgotten."""
        way = [pose]
        length = 0.0
        while self._poses and length < distance:
            step = self._poses.pop()
            length += math.dist(way[-1][:2], step[:2])
            way.append(step)
        return way
