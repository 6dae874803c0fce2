"""Where the robot looks at the ground ahead: once at each place where it stands and no way leads on.

Nose-down by 15 deg an XT16 sees level ground from 0.9 m on instead of 1.9 m, and over crests. Looking before every path
that ends
in unseen ground was tried and is not in: the robot sees as much while it drives, and a look takes 1.3 s.
"""

from __future__ import annotations

import math

from hal.rotation import wrap
from hal.types import NS
from rbtrg_robot.stages.navigation.progress import Pose2

PITCH = math.radians(15.0)
"""[rad]"""
SAME_PLACE, SAME_HEADING = 0.3, math.radians(30.0)
"""[m], [rad]"""
LONGEST = 2.5 * NS
"""[ns] after which the robot plans without the look: the trunk did not come level, or the tracker is silent."""


class Looks:
    """Remembers from where the robot looked. One object for each goal."""

    def __init__(self, most: float) -> None:
        """`most`: see `Capabilities.max_trunk_tilt` [rad]."""
        self.pitch = min(PITCH, most)
        self._from: list[Pose2] = []

    def wanted(self, pose: Pose2 | None) -> bool:
        """Whether to look from `pose`, which counts as done then."""
        if self.pitch == 0.0 or pose is None or any(_near(pose, other) for other in self._from):
            return False
        self._from.append(pose)
        return True


def _near(a: Pose2, b: Pose2) -> bool:
    return math.dist(a[:2], b[:2]) < SAME_PLACE and abs(wrap(a[2] - b[2])) < SAME_HEADING
