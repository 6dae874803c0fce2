"""Ground that a LiDAR sees beside the plane under the wheels, and beside gravity: turn and height of its mount."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from hal.rotation import cross
from hal.types import Array

GROUND_REACH = 3.5
"""Ground within this distance [m] is looked at,"""
GROUND_BAND, GROUND_FAN = 0.08, 0.12
"""within this height of the plane under the wheels [m], and this much more per metre."""
FARTHEST_GROUND = 1.05 * math.hypot(GROUND_REACH, GROUND_BAND + GROUND_FAN * GROUND_REACH)
"""No such ground lies further from the middle of the wheels [m]."""
CELL_SIDE, CELL_POINTS, PLANE_CELLS = 0.25, 3, 25
"""Heights are averaged in cells of this size [m] with so many points at least; so many cells make a plane."""
HALF = math.ceil(GROUND_REACH / CELL_SIDE)
"""Cells from the middle to the rim."""
EVEN_SCATTER = 0.01
"""Scatter of the cells' heights about the plane up to which ground is even [m]."""
PLANE_SHARE = 0.6
"""Share of the cells that must lie on the plane: others are walls and steps."""
CELL_SPREAD = 0.35
"""The cells must reach so far in both directions, one standard deviation [m]."""
KEPT_LOOKS = 60
"""Looks that count."""
ENOUGH_LOOKS = 8
"""Looks that are needed."""
UPRIGHT_COSINE = 0.5
"""Cosine of the tilt of the wheels' plane up to which one looks."""
RECENT_LOOKS = 3
"""Looks."""
LOOK_EVERY = 5
"""Scans between two looks once there are enough."""


class GroundFit:
    """One LiDAR. All figures as roll, pitch [rad] and height [m] at base_link; the median of the last looks."""

    def __init__(self) -> None:
        self._looks: deque[Array] = deque(maxlen=KEPT_LOOKS)
        self._median = np.zeros(5)
        self._scans = 0
        self._uneven = RECENT_LOOKS
        """Looks since the last one that showed even ground."""

    @property
    def known(self) -> bool:
        """There were enough looks at even ground."""
        return len(self._looks) >= ENOUGH_LOOKS

    @property
    def even(self) -> bool:
        """The ground was even lately."""
        return self._uneven < RECENT_LOOKS

    def add(self, cloud: NDArray[np.float32], contacts: Array, up: Array) -> None:
        """Add a `cloud` (n, 3), the wheel contacts `contacts` (k, 3) and the vertical `up` (3,); all in base_link."""
        self._scans += 1
        if self.known and self._scans % LOOK_EVERY:
            return
        self._uneven += 1
        under = wheel_plane(contacts)
        if under is None or under[0][2] @ up < UPRIGHT_COSINE:
            return
        axes, middle = under
        away = cloud - middle.astype(np.float32)
        near = np.flatnonzero(
            np.einsum("ij,ij->i", away, away) < FARTHEST_GROUND**2
        )  # most of a sweep lies beyond
        plane = fit_plane(cloud[near] @ axes.T - axes @ middle)
        if plane is None:
            return
        a, b, c = plane
        self._uneven = 0
        x, y, _ = axes @ middle
        u = axes @ up
        height = c - a * x - b * y
        self._looks.append(np.array([b, -a, height, b + u[1] / u[2], -a - u[0] / u[2]]))
        self._median = np.median(self._looks, axis=0)

    def beside_wheels(self) -> Array:
        """(3,) by which the ground of the LiDAR lies beside the plane under the wheels."""
        return self._median[:3]

    def beside_gravity(self) -> Array:
        """(2,) roll and pitch of the ground of the LiDAR beside the horizontal."""
        return self._median[3:]


def wheel_plane(contacts: Array) -> tuple[Array, Array] | None:
    """Plane under four wheels, of their contacts (4, 3) in base_link: its axes (3, 3), x ahead and z its normal, and
    the middle (3,) of the wheels. None where fewer touch, or it is steeper in base_link than one looks at."""
    if len(contacts) < 4:
        return None
    normal = cross(contacts[0] - contacts[3], contacts[1] - contacts[2])
    normal /= math.copysign(max(float(np.linalg.norm(normal)), 1e-9), normal[2])
    if normal[2] < UPRIGHT_COSINE:
        return None
    side = cross(normal, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    return np.stack([cross(side, normal), side, normal]), contacts.mean(axis=0)


def fit_plane(points: Array) -> tuple[float, float, float] | None:
    """z = a x + b y + c [m] through the points (n, 3) near z = 0; None where they show no even ground around."""
    reach = np.hypot(points[:, 0], points[:, 1])
    points = points[(reach < GROUND_REACH) & (np.abs(points[:, 2]) < GROUND_BAND + GROUND_FAN * reach)]
    column, row = (np.floor(points[:, :2] / CELL_SIDE).astype(np.int64) + HALF).T
    which = column * 2 * HALF + row
    count = np.bincount(which, minlength=4 * HALF * HALF)
    enough = count >= CELL_POINTS
    sums = [np.bincount(which, points[:, k], len(count))[enough] for k in range(3)]
    mean = np.stack(sums, axis=1) / count[enough, None]
    if len(mean) < PLANE_CELLS:
        return None
    design = np.column_stack([mean[:, :2], np.ones(len(mean))])
    keep = np.abs(mean[:, 2] - np.median(mean[:, 2])) < 0.03 + 0.05 * np.hypot(mean[:, 0], mean[:, 1])
    for gate in (0.06, 0.03, 0.03):
        x, *_ = np.linalg.lstsq(design[keep], mean[keep, 2], rcond=None)
        off = np.abs(design @ x - mean[:, 2])
        keep = off < gate
        if keep.sum() < max(PLANE_CELLS, PLANE_SHARE * len(mean)):
            return None
    even = float(np.sqrt(np.mean(off[keep] ** 2))) < EVEN_SCATTER
    wide = float(np.linalg.eigvalsh(np.cov(mean[keep, :2].T))[0]) > CELL_SPREAD**2
    return (float(x[0]), float(x[1]), float(x[2])) if even and wide else None
