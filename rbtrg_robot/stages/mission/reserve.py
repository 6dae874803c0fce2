"""The battery that the way home takes, by what driving cost so far."""

from __future__ import annotations

import math

from rbtrg_robot.stages.navigation.progress import Pose2

MORE = 1.2
"""The way home may take so many times what driving cost so far."""
PER_METRE, OVER = 0.0005, 100.0
"""State of charge [0..1] a metre is thought to take before much was driven, and how many metres of experience that
counts for. A robot tells whole percents, so the first metres say little."""
JUMP = 1.0
"""[m] A pose farther than this from the one before was set and not driven to."""


class Reserve:
    """Takes the state of charge and the poses of one drive."""

    def __init__(self, floor: float) -> None:
        """`floor`: state of charge [0..1] at which the robot stops wherever it stands."""
        self._floor = floor
        self._first: float | None = None
        self._now = 1.0
        self._pose: Pose2 | None = None
        self._metres = 0.0

    def take(self, battery: float, pose: Pose2) -> None:
        """State of charge [0..1] and pose in `map` of now."""
        self._first = battery if self._first is None else self._first
        self._now = battery
        step = 0.0 if self._pose is None else math.dist(pose[:2], self._pose[:2])
        self._metres += step if step < JUMP else 0.0
        self._pose = pose

    @property
    def per_metre(self) -> float:
        """State of charge [0..1] that a metre takes, standing between included."""
        spent = 0.0 if self._first is None else max(self._first - self._now, 0.0)
        return (spent + PER_METRE * OVER) / (self._metres + OVER)

    def short(self, way: float) -> str:
        """Why a way home of so much [m] must begin now; empty while it need not. Where the way is not known nothing is
        said."""
        if self._first is None or not math.isfinite(way):
            return ""
        needed = MORE * self.per_metre * way
        if self._now - self._floor > needed:
            return ""
        return f"the battery ({100 * self._now:.0f} %) is needed for the way home of {way:.0f} m"
