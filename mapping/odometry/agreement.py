"""Wheels and gyro against the scans, over a second: the wheels slip, or the scans show what is not there."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hal.rotation import rotation_vector, wrap
from hal.safety.monitors import SCANS_DISAGREE
from hal.types import NS, Array

WINDOW = NS
"""Time that is looked at [ns]."""
MOVED, TURNED = 0.4, math.radians(6.0)
"""Most that wheels on firm ground [m] and a gyro [rad] are off within it."""


def way_ahead(before: Array, after: Array) -> float:
    """[m] by which a robot came ahead, signed, from `before` (4, 4) to `after`: along the mean of its two headings."""
    return float((after[:3, 3] - before[:3, 3]) @ (before[:3, 0] + after[:3, 0]) / 2.0)


class Agreement:
    """Sums what the scans say beside dead reckoning."""

    def __init__(self) -> None:
        self._off: deque[tuple[int, Array, float]] = deque()
        """End of a scan [ns]; difference between scan and dead reckoning in way ahead of each wheel (4,) [m], and in
        turn about z [rad]."""

    def add(self, stamp: int, before: Array, after: Array, rolled: Array, turned: float) -> str:
        """The scan that ended at `stamp` [ns] led from `before` (4, 4) to `after`. Each wheel rolled `rolled` (4,)
        [m], NaN if unknown; the gyro turned by `turned` [rad]. Returns in words why scan and dead reckoning disagree;
        empty while they agree. Wheels that spin on an edge or at a face roll farther than the others, so the true way
        lies between."""
        turn = rotation_vector(before[:3, :3].T @ after[:3, :3])[2]
        ahead = way_ahead(before, after) - rolled
        self._off.append((stamp, np.where(np.isfinite(ahead), ahead, 0.0), wrap(float(turn) - turned)))
        while self._off[0][0] <= stamp - WINDOW:
            self._off.popleft()
        wheels = np.sum([off for _, off, _ in self._off], axis=0)
        way = max(float(wheels.min()), -float(wheels.max()), 0.0)
        turn = abs(math.fsum(off for *_, off in self._off))
        if not SCANS_DISAGREE.outside(max(way / MOVED, turn / TURNED)):
            return ""
        return SCANS_DISAGREE.tell(seconds=WINDOW / NS, moved=way, turned=math.degrees(turn))

    def forget(self) -> None:
        """Break the comparison: the robot was found elsewhere."""
        self._off.clear()
