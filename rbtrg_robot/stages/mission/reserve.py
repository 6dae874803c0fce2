"""The battery that the way home takes, by what driving cost so far."""

from __future__ import annotations

import math

from hal.types import NS
from rbtrg_robot.stages.mission.way_home import SET_JUMP
from rbtrg_robot.stages.navigation.progress import Pose2

RESERVE_FACTOR = 1.2
"""The way home may take so many times what driving cost so far."""
PER_METRE = 0.0005
"""State of charge [0..1] that a metre is thought to take at least, and alone until driving took ENOUGH: a robot tells
whole percents, so the first metres say little."""
ENOUGH_CHARGE = 0.02
SPARE_CHARGE = 0.01
"""State of charge [0..1] kept beside: to plan and to turn round takes some, and a robot tells whole percents."""
TOLD_AHEAD = 120.0
"""[s] before the way home must begin it is told."""
HOME_SPEED = 0.3
"""[m/s] along ways home, by experience of explored ground."""
LEAST_MOVE = 0.005
"""[m] between two poses of a robot that drives."""


class Reserve:
    """Takes the state of charge and the poses of one drive."""

    def __init__(self, floor: float) -> None:
        """`floor`: state of charge [0..1] at which the robot stops wherever it stands."""
        self._floor = floor
        self._first: tuple[float, int] | None = None
        """State of charge, and when [ns]."""
        self._told = self._now = 1.0
        self._time = 0
        self._pose: Pose2 | None = None
        self._metres = self._spent = 0.0
        """Driven, and what that took."""
        self._moved = self._poses = 0
        """Since the state of charge fell last."""

    def take(self, battery: float, pose: Pose2, now: int) -> None:
        """State of charge [0..1] and pose in `map` at `now` [ns]."""
        if self._first is None or battery > self._now or now < self._time:  # charged; a clock that was reset
            self._first, self._told = (battery, now), battery
        self._now, self._time = battery, now
        step = 0.0 if self._pose is None else math.dist(pose[:2], self._pose[:2])
        drives = LEAST_MOVE <= step < SET_JUMP
        self._metres += step if drives else 0.0
        self._pose = pose
        self._poses += 1
        self._moved += drives
        if battery < self._told:
            self._spent += (self._told - battery) * self._moved / self._poses
            self._told, self._moved, self._poses = battery, 0, 0

    @property
    def per_metre(self) -> float:
        """State of charge [0..1] that a metre takes."""
        known = self._spent >= ENOUGH_CHARGE and self._metres > 0.0
        return max(PER_METRE, self._spent / self._metres) if known else PER_METRE

    def left(self, way: float) -> float:
        """[s] until a way home of so much [m] must begin, for a robot that goes on as it did; infinite where nothing is
        known."""
        if self._first is None or not math.isfinite(way):
            return math.inf
        spare = self._now - self._floor - SPARE_CHARGE - RESERVE_FACTOR * self.per_metre * way
        if spare <= 0.0:
            return 0.0
        seconds = (self._time - self._first[1]) / NS
        drain = (self._first[0] - self._now) / seconds if seconds > 0.0 else 0.0
        return spare / max(drain + RESERVE_FACTOR * self.per_metre * HOME_SPEED, 1e-9)

    def short(self, way: float) -> str:
        """Why a way home of so much [m] must begin now; empty while it need not."""
        if self.left(way) > 0.0:
            return ""
        return f"the battery ({100 * self._now:.0f} %) is needed for the way home of {way:.0f} m"

    def warning(self, way: float) -> str:
        """What is told ahead; empty while there is time."""
        left = self.left(way)
        if left > TOLD_AHEAD or self.short(way):
            return self.short(way)
        return f"in {left:.0f} s the battery ({100 * self._now:.0f} %) will be needed for the way home of {way:.0f} m"
