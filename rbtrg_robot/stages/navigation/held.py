"""Turns on the spot that the guard held: the planner asks its map, the guard sees more."""

from __future__ import annotations

import math

from hal.rotation import wrap
from rbtrg_robot.stages.navigation.progress import Pose2

SAME_PLACE, SAME_HEADING = 0.15, math.radians(20.0)
"""[m], [rad]"""


class HeldTurns:
    """Remembers where the guard held a turn. One object for each goal."""

    def __init__(self) -> None:
        self._held: list[tuple[Pose2, bool]] = []

    def add(self, pose: Pose2, *, left: bool) -> None:
        """The guard holds a turn from `pose` to the left, or to the right."""
        self._held.append((pose, left))

    def at(self, pose: Pose2) -> tuple[bool, bool]:
        """Whether turns from about `pose` to the left, to the right, were held."""
        sides = {left for other, left in self._held if _near(pose, other)}
        return True in sides, False in sides


def _near(a: Pose2, b: Pose2) -> bool:
    return math.dist(a[:2], b[:2]) < SAME_PLACE and abs(wrap(a[2] - b[2])) < SAME_HEADING
