"""Wheels and gyro against another that tells of the motion, over a second."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hal.rotation import rotation_vector, wrap
from hal.safety.monitors import SCANS_MIRRORED, SCANS_SCALE, Monitor
from hal.types import NS, Array, LidarName

WINDOW = NS
"""Time that is looked at [ns]."""
WAY_ERROR, TURN_ERROR = 0.4, math.radians(6.0)
"""Most that wheels on firm ground [m] and a gyro [rad] are off within it."""


JUDGED_WAY = 1.0
"""[m] that wheels roll, over which the distances of the scans are judged."""
AGREED_SHARE = 0.9
"""Share of it over which they must agree again."""
LEVEL_COSINE = math.cos(math.radians(5.0))
"""Least cosine of the tilt all along it: on stairs all wheels roll up each riser, which is no way ahead."""
HELD_SHARE = 0.25
"""Share of the way of the wheels below which something holds the robot, and all of them spin: that tells no unit."""
JUDGED_TURN, LEAST_TURN = math.radians(8.0), math.radians(0.3)
"""[rad] by the gyro over which the side of the scans is judged, and from one sweep to the next to count in it."""
TURN_TOLD = math.radians(1.0)
"""A scan whose heading has a larger standard deviation [rad] tells no side."""
FOUND_ELSEWHERE = -1.5
"""Share of it over which scans turn the other way no mirror does: the robot was looked for, and found elsewhere."""


def way_ahead(before: Array, after: Array) -> float:
    """[m] by which a robot came ahead, signed, from `before` (4, 4) to `after`: along the mean of its two headings."""
    return float((after[:3, 3] - before[:3, 3]) @ (before[:3, 0] + after[:3, 0]) / 2.0)


def apart(before: Array, after: Array, rolled: Array) -> Array:
    """(4,) [m] by which a step came farther than each wheel, which rolled `rolled` (4,) [m]; 0 where that is NaN."""
    off = way_ahead(before, after) - rolled
    return np.where(np.isfinite(off), off, 0.0)


def between(off: list[Array]) -> float:
    """[m] by which steps came farther, or less far, than any wheel. Wheels that spin on an edge or at a face roll
    farther than the others, so the true way lies between. `off`: (4,) [m] of each step."""
    wheels = np.sum(off, axis=0)
    return max(float(wheels.min()), -float(wheels.max()), 0.0)


class Agreement:
    """Sums what the scans, or an integrated accelerometer, say beside wheels and gyro."""

    def __init__(self, row: Monitor) -> None:
        """`row`: its limit and its words."""
        self._row = row
        self._off: deque[tuple[int, Array, float]] = deque()
        """End of a step [ns]; its difference in way ahead from each wheel (4,) [m], and in turn about z from the gyro
        [rad]."""

    def add(self, stamp: int, before: Array, after: Array, rolled: Array, turned: float) -> str:
        """A step that ended at `stamp` [ns] led from `before` (4, 4) to `after`. Each wheel rolled `rolled` (4,)
        [m], NaN if unknown; the gyro turned by `turned` [rad]. Returns in words how they disagree; empty while they
        agree."""
        turn = rotation_vector(before[:3, :3].T @ after[:3, :3])[2]
        off = apart(before, after, rolled)
        self._off.append((stamp, off, wrap(float(turn) - turned)))
        while self._off[0][0] <= stamp - WINDOW:
            self._off.popleft()
        way = between([off for _, off, _ in self._off])
        turn = abs(math.fsum(off for *_, off in self._off))
        if not self._row.outside(max(way / WAY_ERROR, turn / TURN_ERROR)):
            return ""
        return self._row.tell(seconds=WINDOW / NS, moved=way, turned=math.degrees(turn))

    def forget(self) -> None:
        """Break the comparison: the robot was found elsewhere."""
        self._off.clear()


class Scale:
    """The way of the scans beside that of the wheels, over a metre: a LiDAR that tells its distances in another unit
    fits its own map."""

    def __init__(self) -> None:
        self._steps: deque[tuple[float, Array]] = deque()
        """Of each step [m]: mean way of the wheels, and by how much the scans came farther than each (4,)."""
        self.words = ""
        """That the scans tell another way, until they agreed for a metre; else empty."""
        self._sum = np.zeros(4)
        """[m] by which they came farther than each wheel, as long as there are words."""

    def add(self, before: Array, after: Array, rolled: Array) -> None:
        """A step led from `before` (4, 4) to `after`; each wheel rolled `rolled` (4,) [m], NaN if unknown."""
        if not np.isfinite(rolled).all():
            self.forget()
            return
        way = float(rolled.mean())
        if after[2, 2] < LEVEL_COSINE or way_ahead(before, after) * np.sign(way) < HELD_SHARE * abs(way):
            self._steps.clear()  # a metre of level ground in one piece: between two risers the trunk may be level, too
            return
        step = apart(before, after, rolled) * np.sign(way)  # there and back does not cancel
        self._steps.append((abs(way), step))
        way = math.fsum(way for way, _ in self._steps)
        while way - self._steps[0][0] > JUDGED_WAY:
            way -= self._steps.popleft()[0]
        steps = [off for _, off in self._steps]
        off = between(steps)
        self._sum = self._sum + step if self.words else np.sum(steps, axis=0)
        if SCANS_SCALE.outside(off):
            self.words = SCANS_SCALE.tell(way=way, off=off)
        elif way > AGREED_SHARE * JUDGED_WAY and off < 0.5 * SCANS_SCALE.high:
            self.words = ""

    @property
    def unsure(self) -> float:
        """[m] of the place that scans and wheels tell differently; 0 while there are no words."""
        return between([self._sum]) if self.words else 0.0

    def forget(self) -> None:
        """Break the comparison: the robot was found elsewhere."""
        self._steps.clear()


class Handedness:
    """The turn of the scans beside that of the gyro: sweeps that tell left for right fit their own map, and turn the
    other way. No LiDAR changes sides on the way, so one that was right once is not asked again."""

    def __init__(self) -> None:
        self._name: LidarName = "main"
        """Of the LiDAR that told the last pose."""
        self._right: set[LidarName] = set()
        self._last: Array | None = None
        """(4, 4) where the scan before fitted."""
        self._turns: deque[tuple[float, float]] = deque()
        """Of each step [rad]: size of the turn by the gyro, and turn of the scans to that side."""
        self.words = ""
        """That they turn the other way, for good; else empty."""

    def add(self, name: LidarName, pose: Array, turned: float) -> None:
        """The scan fits at `pose` (4, 4). The gyro turned by `turned` [rad] since the scan before."""
        if name != self._name:
            self.forget()
            self._turns.clear()
            self._name = name
        last, self._last = self._last, pose
        if name in self._right or last is None or abs(turned) < LEAST_TURN:
            return
        turn = float(rotation_vector(last[:3, :3].T @ pose[:3, :3])[2])
        self._turns.append((abs(turned), math.copysign(1.0, turned) * turn))
        gyro, scans = (math.fsum(turns) for turns in zip(*self._turns, strict=True))
        if gyro < JUDGED_TURN:
            return
        if SCANS_MIRRORED.outside(scans / gyro) and scans > FOUND_ELSEWHERE * gyro:
            turns = math.degrees(gyro), math.degrees(-scans)
            self.words = SCANS_MIRRORED.tell(name=name, gyro=turns[0], scans=turns[1])
        if scans > AGREED_SHARE * gyro:
            self._right.add(name)
        self._turns.popleft()

    def forget(self) -> None:
        """The turn to the next scan counts for nothing: no scan came, or it fits nowhere surely."""
        self._last = None
