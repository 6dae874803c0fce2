"""How far below a LiDAR the ground lies, by what it sees and by the legs: that tells its unit at once, at rest.

A LiDAR whose distances are `s` times too long sees the ground `s` times as far below itself. One that hangs upside down
sees it as far above. The ground is what most rays find: of the heights that they tell, as shares of what the legs tell,
the ground is the peak. It counts where it is even and lies around the robot.

No unit changes on the way. So a LiDAR that was right once is not asked again.
"""

from __future__ import annotations

import math

import numpy as np

from hal.safety.monitors import GROUND_HEIGHT
from hal.types import Array, LidarName
from mapping.odometry.ground_fit import CELL_SIDE, GROUND_REACH, fit_plane, wheel_plane

STEEP_SINE = math.sin(math.radians(4.0))
"""Sine of the angle to the plane under the wheels from which on a ray finds the ground near enough."""
LEAST_SHARE, MOST_SHARE, BIN_WIDTH = 0.05, 20.0, 0.06
"""Shares that are looked at, and the step of their logarithm."""
PEAK_COUNT = 3
"""Most frequent shares that are looked at: a wall may be one."""
UPSIDE_DOWN = 0.15
"""Share by which ground that is seen above the LiDAR may be off: other level faces up there are ceilings."""
UNDER_SHARE, SEEN_UNDER = 0.3, 0.05
"""Nothing is seen below the ground: share by which points may lie lower, and share of the points that may lie lower
still."""
WALL_RISE = 0.12
"""[m] from the lowest to the highest point of a cell from which on it is a wall."""
SECTOR_WIDTH, SECTOR_DEPTH, FLAT_BAND = math.radians(15.0), 0.4, 0.05
"""[rad], [m] Ground under the wheels is there where points in two sectors or more lie so far one behind the other, this
near the plane [m], and as much per metre,"""
EVEN_SCATTER = 0.02
"""and scatter less [m]: the rings of a LiDAR on a wall lie farther apart."""
THINNED_POINTS = 4000
"""Points of a sweep that are enough."""
SURE_SWEEPS = 3
"""Sweeps that tell so, and none that tells otherwise."""


class GroundHeight:
    """One LiDAR."""

    def __init__(self, name: LidarName, place: Array) -> None:
        """`place`: (3,) of the LiDAR in base_link [m]."""
        self._name, self._place = name, place
        self._right = False
        self._wrong = 0
        """Sweeps that told so."""
        self.words = ""
        """What the operator reads while the LiDAR is wrong; else empty."""

    @property
    def asks(self) -> bool:
        """Whether it wants to look."""
        return not self._right and GROUND_HEIGHT.active

    def look(self, cloud: Array, contacts: Array) -> None:
        """At a `cloud` (n, 3) and the wheel contacts `contacts` (k, 3) of a robot that stands; both in base_link [m].
        What shows no even ground tells nothing."""
        if (under := wheel_plane(contacts)) is None:
            return
        axes, middle = under
        place = axes @ (self._place - middle)
        step = len(cloud) // THINNED_POINTS | 1  # odd, so that it takes from every ring of a spinning LiDAR
        away = (cloud[::step] - self._place) @ axes.T
        shares = ground_shares(away, place)
        if any(not GROUND_HEIGHT.outside(share) for share in shares):
            self._right, self.words = True, ""
        elif shares and not stands_on(place + away):
            self._wrong += 1
            side, seen = "below" if shares[0] > 0.0 else "above", abs(shares[0]) * place[2]
            words = GROUND_HEIGHT.tell(name=self._name, seen=seen, side=side, told=place[2])
            self.words = words if self._wrong >= SURE_SWEEPS else ""


def ground_shares(away: Array, place: Array) -> list[float]:
    """How far below the LiDAR even ground lies, as shares of what the legs tell; most frequent first, none where there
    is none. Negative: above it.

    `away` (n, 3): points from the LiDAR, axes of the plane under the wheels; `place` (3,): the LiDAR above it [m]."""
    away = away[np.abs(away[:, 2]) > STEEP_SINE * np.linalg.norm(away, axis=1)]
    share = -away[:, 2] / place[2]
    edges = np.arange(math.log(LEAST_SHARE), math.log(MOST_SHARE), BIN_WIDTH)
    found: list[float] = []
    for sign in (1.0, -1.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            size = np.log(sign * share)
        count = np.histogram(size, edges)[0]
        count = count + np.roll(count, 1)
        for _ in range(PEAK_COUNT):
            k = int(count.argmax())
            if not count[k]:
                break
            about = sign * math.exp(float(np.median(size[np.abs(size - edges[k]) <= BIN_WIDTH])))
            count[max(k - 2, 0) : k + 3] = 0
            if sign < 0.0 and abs(about + 1.0) > UPSIDE_DOWN:
                continue
            if (plane := fit_plane(without_walls(place + away / about))) is None:
                continue
            exactly = about * (1.0 - plane[2] / place[2])
            under = np.count_nonzero(share / exactly > 1.0 + UNDER_SHARE)
            if under < SEEN_UNDER * len(share) or not GROUND_HEIGHT.outside(exactly):
                found.append(exactly)
    return found


def without_walls(points: Array) -> Array:
    """Those of `points` (n, 3), axes of the plane under the wheels, whose cell has no wall."""
    points = points[np.hypot(points[:, 0], points[:, 1]) < GROUND_REACH]
    cells, which = np.unique(np.floor(points[:, :2] / CELL_SIDE), axis=0, return_inverse=True)
    low, high = np.full(len(cells), np.inf), np.full(len(cells), -np.inf)
    np.minimum.at(low, which.ravel(), points[:, 2])
    np.maximum.at(high, which.ravel(), points[:, 2])
    return points[(high - low < WALL_RISE)[which.ravel()]]


def stands_on(points: Array) -> bool:
    """Whether some of the `points` (n, 3), axes of the plane under the wheels, lie in that plane one behind the other:
    there is such ground, though it may be a bridge."""
    reach = np.hypot(points[:, 0], points[:, 1])
    on = (reach < GROUND_REACH) & (np.abs(points[:, 2]) < FLAT_BAND + FLAT_BAND * reach)
    reach, height = reach[on], points[on, 2]
    sector = np.floor(np.arctan2(points[on, 1], points[on, 0]) / SECTOR_WIDTH)
    inside = [sector == k for k in np.unique(sector)]
    return sum(np.ptp(reach[k]) > SECTOR_DEPTH and np.std(height[k]) < EVEN_SCATTER for k in inside) > 1
