"""Scans laid onto a prior map: height and slope of the poses against it.

An accelerometer bias of 0.03 m/s^2 looks like a tilt of 0.2 deg. So poses that fit the odometry's own map lie
centimetres above or below a prior map some metres away. Each scan is compared with the heights of the prior map. A
plane (height at the robot, slopes along x and y) is taken out of the poses, bit by bit."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.rotation import rotation_rpy
from mapping.elevation.fusion import DEPTH, TOP, WEIGHT
from mapping.elevation.tiles import TileStore

FLAT_RISE = 0.03
"""Largest difference of height within 3 x 3 cells [m] of ground that tells a height: a ramp does, an edge does not."""
HEIGHT_GATE = 0.10
"""What differs more from the prior map [m] has changed since."""
HEIGHT_SCALE = 0.05
"""Differences of this size [m] count a quarter."""
SLOPES_HELD = 1.0
"""Mean square reach of the ground that is compared [m^2] at which half of a slope is taken."""
ENOUGH_CELLS = 50
"""Cells of ground that are compared at least: between the walls of a lane a scan of the XT16 meets about 100."""
LEVEL_OFF = 0.05
"""A map that lies higher or lower than this on the whole [m] is taken at its level: it counts from another start."""


class Alignment:
    """The plane between poses and prior map. Without a prior map it stays zero, except for what else is added to
    `height`."""

    def __init__(self) -> None:
        self.height = 0.0
        """To be added to a pose's z [m]."""
        self.slopes = np.zeros(2)
        """Of what is to be added, along x and y of `map` [m/m]."""
        self._at = np.zeros(2)
        self.active = False
        """Whether there is a prior map to lay the poses onto."""
        self._taken = 0

    def to(self, store: TileStore) -> None:
        """Lay poses from now on onto what `store` holds now."""
        store.keep_level()
        self.active, self._taken = True, 0

    def place(
        self, turned: NDArray[np.float64], place: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation (3,3) and position (3,) of a pose, corrected. The height is carried along the slopes to where the
        robot is."""
        if self.active and self.slopes.any():
            self.height += float(self.slopes @ (place[:2] - self._at))
            turned = rotation_rpy(self.slopes[1], -self.slopes[0], 0.0) @ turned
        self._at = place[:2].copy()
        at = place.copy()
        at[2] += self.height
        return turned, at

    def take(
        self,
        store: TileStore,
        which: NDArray[np.int64],
        sums: NDArray[np.float32],
        resolution: float,
        gain: float,
    ) -> bool:
        """Move the plane by the share `gain` of the offset between one scan and the prior map; the first scans count
        in full.

        which (k,) and sums (k, 8): the scan, see `fusion.reduce_cells`. Returns True if the scan must be placed
        again: the first one."""
        off = _over_ground(which, sums, store.level, store.shift)
        level = self._take_level(off) if self._taken == 0 else np.float32(0.0)
        off -= level
        n, total, a, b = _normal_equations(off, which, store.tiles, store.shift, self._at, resolution)
        if n < ENOUGH_CELLS:
            return bool(level)
        self._taken += 1
        step = np.linalg.solve(a / total + np.diag([0.0, SLOPES_HELD, SLOPES_HELD]), b / total)
        step *= max(gain, 1.0 / self._taken)
        self.height -= float(step[0])
        self.slopes -= step[1:]
        return self._taken == 1

    def _take_level(self, off: NDArray[np.float32]) -> np.float32:
        """Take the level of a prior map that counts from another start. Returns how much higher the scan lay [m].
        off: see `_over_ground`."""
        told = off[np.isfinite(off)]
        if len(told) < ENOUGH_CELLS:
            return np.float32(0.0)
        middle = np.median(told)
        one_level = np.median(np.abs(told - middle)) < LEVEL_OFF
        if not one_level or abs(middle) <= LEVEL_OFF:
            return np.float32(0.0)
        self.height -= float(middle)
        return np.float32(middle)


@njit(cache=True)
def _over_ground(which, sums, known, shift):  # pragma: no cover - compiled
    """(k,) how much higher than the prior map's heights `known` the cells of a scan lie [m]; NaN where the ground is
    not flat.

    A scan meets a wall below its top, so a wall tells no height. In a lane most of a scan is walls."""
    size = np.int64(1) << shift
    off = np.full(len(which), np.nan, np.float32)
    for s in range(len(which)):
        index = which[s]
        r, c = (index >> shift) & (size - 1), index & (size - 1)
        if r == 0 or c == 0 or r == size - 1 or c == size - 1:
            continue
        low, high, seen = np.inf, -np.inf, 0
        for k in range(-1, 2):
            for m in range(-1, 2):
                h = known[index + k * size + m]
                seen += h == h
                low = h if h < low else low
                high = h if h > high else high
        if seen == 9 and high - low <= FLAT_RISE:
            off[s] = sums[s, TOP] + sums[s, DEPTH] / sums[s, WEIGHT] - known[index]
    return off


@njit(cache=True)
def _normal_equations(off, which, tiles, shift, at, resolution):  # pragma: no cover - compiled
    """Least squares of a scan's heights `off` (k,) over the prior map, height + slopes . (x, y from `at` (2,)):
    number of cells compared, sum of their weights, matrix (3, 3), right side (3,)."""
    n, total = 0, 0.0
    a, b = np.zeros((3, 3)), np.zeros(3)
    j = np.ones(3)
    size = np.int64(1) << shift
    for s in range(len(which)):
        if not abs(off[s]) <= HEIGHT_GATE:
            continue
        index = which[s]
        r, c = (index >> shift) & (size - 1), index & (size - 1)
        slot = index >> (2 * shift)
        j[1] = (tiles[slot, 1] * size + c) * resolution - at[0]
        j[2] = (tiles[slot, 0] * size + r) * resolution - at[1]
        w = 1.0 / (1.0 + (off[s] / HEIGHT_SCALE) ** 2)
        w *= w
        n += 1
        total += w
        for k in range(3):
            b[k] += w * j[k] * off[s]
            for m in range(3):
                a[k, m] += w * j[k] * j[m]
    return n, total, a, b
