"""The battery that the way home takes, by what driving cost so far."""

from __future__ import annotations

import math

from hal.types import NS
from rbtrg_robot.stage_config import HomeConfig
from rbtrg_robot.stages.mission.way_home import SET_JUMP
from rbtrg_robot.stages.navigation.progress import Pose2

CHARGE_STEP = 0.01
"""State of charge [0..1] in which robots tell it. One is kept beside; two must be spent to say what a metre takes."""
STUCK_CHARGE = 0.1
"""State of charge [0..1] that driving must have taken while none was told: then the battery's word is not believed."""
LEAST_MOVE = 0.005
"""[m] between two poses of a robot that drives."""


class Reserve:
    """Takes the state of charge and the poses of one drive."""

    def __init__(self, floor: float, home: HomeConfig = HomeConfig()) -> None:
        """`floor`: state of charge [0..1] at which the robot stops wherever it stands."""
        self._floor, self._home = floor, home
        self._first: tuple[float, int] | None = None
        """State of charge, and when [ns]."""
        self._told = self._now = 1.0
        self._time = 0
        self._pose: Pose2 | None = None
        self._metres = self._spent = 0.0
        """Driven, and what that took."""
        self._moved = self._poses = 0
        """Since the state of charge fell last."""
        self._same_metres = 0.0
        """Driven while the same state of charge was told."""

    def take(self, battery: float, pose: Pose2, now: int) -> None:
        """State of charge [0..1] and pose in `map` at `now` [ns]."""
        if self._first is None or battery > self._now or now < self._time:  # charged; a clock that was reset
            self._first, self._told = (battery, now), battery
        if battery != self._now:
            self._same_metres = 0.0
        self._now, self._time = battery, now
        step = 0.0 if self._pose is None else math.dist(pose[:2], self._pose[:2])
        drives = LEAST_MOVE <= step < SET_JUMP
        self._metres += step if drives else 0.0
        self._same_metres += step if drives else 0.0
        self._pose = pose
        self._poses += 1
        self._moved += drives
        if battery < self._told:
            self._spent += (self._told - battery) * self._moved / self._poses
            self._told, self._moved, self._poses = battery, 0, 0

    @property
    def per_metre(self) -> float:
        """State of charge [0..1] that a metre takes."""
        least = self._home.per_metre
        known = self._spent >= 2.0 * CHARGE_STEP and self._metres > 0.0
        return max(least, self._spent / self._metres) if known else least

    def seconds(self, way: float) -> float:
        """[s] that a way of so much [m] takes."""
        return way / self._home.speed

    def left(self, way: float) -> float:
        """[s] until a way home of so much [m] must begin, for a robot that goes on as it did; infinite where nothing is
        known."""
        if self._first is None or not math.isfinite(way):
            return math.inf
        needed = self._home.reserve * self.per_metre
        spare = self._now - self._floor - CHARGE_STEP - needed * way
        if spare <= 0.0:
            return 0.0
        seconds = (self._time - self._first[1]) / NS
        drain = (self._first[0] - self._now) / seconds if seconds > 0.0 else 0.0
        return spare / max(drain + needed * self._home.speed, 1e-9)

    def short(self, way: float) -> str:
        """Why a way home of so much [m] must begin now; empty while it need not."""
        if self.left(way) > 0.0:
            return ""
        return f"the battery ({100 * self._now:.0f} %) is needed for the way home of {way:.0f} m"

    def warning(self, way: float) -> str:
        """What is told ahead; empty while there is time."""
        left = self.left(way)
        if short := self.short(way):
            return short
        if self._same_metres * self.per_metre > STUCK_CHARGE:
            return (
                f"the battery has told {100 * self._now:.0f} % for {self._same_metres:.0f} m of driving: it may be "
                "stuck, and the robot would not come home for it"
            )
        if left > self._home.told_ahead:
            return ""
        return f"in {left:.0f} s the battery ({100 * self._now:.0f} %) will be needed for the way home of {way:.0f} m"
