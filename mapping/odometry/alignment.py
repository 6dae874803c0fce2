"""Clock and mount of each LiDAR, found while the robot moves. Two least-squares fits with a fading memory:

`GyroFit`, for the LiDAR that is registered. Sweeps that were measured `offset` [s] after their stamps show the body
where it was later: from scan to scan registration turns more than the gyro by the change of the rate times the
offset. A mount that is turned by e [rad] turns the axis of every motion (hand-eye calibration, Daniilidis 1999):

    registered - gyro = offset (rate_k - rate_k-1) + e x turn

A robot on wheels drives ahead: a mount that is turned about z makes it drive askew. `MapFit`, for every other LiDAR.
Its cloud lies beside the planes of the local map by a constant error of the mount, and by the motion during the
offset."""

from __future__ import annotations

import math

import numpy as np

from hal.rotation import rotation, rotation_vector, skew, turn
from hal.types import Array
from mapping.odometry.registration.observability import observed

PRIOR_OFFSET, PRIOR_TURN, PRIOR_PLACE = 0.05, 0.05, 0.05
"""Standard deviations of offset [s], turn [rad] and place [m] of the mount before anything is measured."""
MEMORY_SCANS = 300.0
"""Scans of a moving robot after which one counts 1/e."""
KEPT_WEIGHT = 0.1
"""Weight of what was measured before the stamps were shifted: those sweeps were bent by the wrong time. After the
largest shift they still are."""
ASSUMED_COUNT = 30.0
"""Measurements that the assumed noise counts for beside those that were made."""
CONSECUTIVE_GAP = 150_000_000
"""Two scans that end within this time [ns] follow each other."""
WAVER_SIGMA = 5e-4
"""Rotation [rad] by which one registration differs from the next beside what its covariance tells."""
ASKEW_VARIANCE, AT_FIRST = np.diag(np.radians([0.25, 0.25, 0.0]) ** 2), 10
"""The same for roll and pitch [rad^2], base_link, in the first scans of motion. The map of a robot that has only
stood knows the ground from one attitude, and lies askew once the nose points down. In a lane a registration was 18
mrad off there; its covariance said 2 mrad."""
CALM_RATE = 0.05
"""A slower turn [rad/s] tells nothing."""
STRAIGHT_RATE, STRAIGHT_STEP = 0.1, 0.02
"""Turn rate [rad/s] up to which, and distance from scan to scan [m] from which the robot drives ahead,"""
SIDEWAYS_SIGMA, SIDEWAYS_SLIP = 0.003, 0.1
"""by so much to the side [m] and per metre [-], one standard deviation: a skid-steered robot drives up to about a
degree askew."""
STRANGE_SIGMAS = 5.0
"""A difference between registration and gyro from scan to scan beyond this [standard deviations] is neither clock nor
mount."""
INDEPENDENT_POINTS = 60
"""Points of a cloud whose errors are independent."""
PLANE_GATE, PLANE_SCALE = 0.15, 0.05
"""Distance from a plane at which a point counts no more, and width of its weight [m]."""


class LeastSquares:
    """Weighted least squares with a prior around zero and a fading memory."""

    def __init__(self, prior: Array) -> None:
        """`prior` (k,): standard deviation of each unknown before anything is measured."""
        self._prior = np.diag(np.asarray(prior, np.float64) ** -2)
        self._a, self._b = np.zeros_like(self._prior), np.zeros(len(prior))
        self._c = self._n = 0.0
        self._solved: tuple[Array, Array] | None = None

    def add(self, a: Array, b: Array, c: float, n: float) -> None:
        """Normal equations of `n` measurements r = J x with weight W: J^T W J (k, k), J^T W r (k,), r^T W r."""
        self.fade(math.exp(-1.0 / MEMORY_SCANS))
        self._a += a
        self._b += b
        self._c += c
        self._n += n

    def fade(self, share: float) -> None:
        """Keep this share of what was measured."""
        self._solved = None
        self._a *= share
        self._b *= share
        self._c *= share
        self._n *= share

    def solve(self) -> tuple[Array, Array]:
        """The unknowns (k,) and their standard deviations (k,); the scatter about the fit widens or narrows these."""
        if self._solved is None:
            inverse = np.linalg.inv(self._a + self._prior)
            x = inverse @ self._b
            left = self._c - 2.0 * float(self._b @ x) + float(x @ self._a @ x)
            scatter = (max(left, 0.0) + ASSUMED_COUNT) / (self._n + ASSUMED_COUNT)
            self._solved = x, np.sqrt(scatter * np.diag(inverse))
        x, sigma = self._solved
        return x.copy(), sigma


class GyroFit:
    """Unknowns (4,): offset of the stamps [s], turn of the mount [rad] in base_link."""

    def __init__(self) -> None:
        self._prior = np.array([PRIOR_OFFSET, *[PRIOR_TURN] * 3])
        self._fit = LeastSquares(self._prior)
        self._last: tuple[int, Array, Array, Array] | None = None
        """Stamp [ns], pose (4, 4), covariance (3, 3) and mean rate (3,) of the scan before."""
        self._moves = 0

    def add(
        self, stamp: int, turned: Array, seconds: float, pose: Array, covariance: Array, shift: float
    ) -> None:
        """One scan that ended at `stamp` [ns].

        `turned` (3, 3): rotation by the gyro since `seconds` ago; `pose` (4, 4) `odom` <- base_link as registered, the
        `covariance` (3, 3) of its rotation in base_link axes [rad^2]; `shift` [s]: was added to the stamp.
        """
        rate = rotation_vector(turned) / seconds
        last, self._last = self._last, (stamp, pose, covariance, rate)
        if last is None or stamp - last[0] > CONSECUTIVE_GAP:
            return
        change = rate - turned.T @ last[3]
        moved = np.linalg.solve(last[1], pose)
        ahead, aside = float(moved[0, 3]), float(moved[1, 3])
        if abs(ahead) > STRAIGHT_STEP and abs(rate[2]) < STRAIGHT_RATE:
            weight = 1.0 / (SIDEWAYS_SIGMA**2 + (SIDEWAYS_SLIP * ahead) ** 2)
            row = np.array([0.0, 0.0, 0.0, ahead])
            self._fit.add(weight * np.outer(row, row), weight * aside * row, weight * aside**2, 1.0)
        off = rotation_vector(turned.T @ moved[:3, :3])
        if np.abs([change, rate]).max() < CALM_RATE:
            return
        jacobian = np.column_stack([change, -skew(rate * seconds)])
        residual = off + shift * change
        noise = covariance + turned.T @ last[2] @ turned + WAVER_SIGMA**2 * np.eye(3)
        if self._moves < AT_FIRST:
            noise += ASKEW_VARIANCE
        self._moves += 1
        usual = noise + (jacobian * self._prior**2) @ jacobian.T
        if off @ np.linalg.solve(usual, off) > STRANGE_SIGMAS**2:
            return
        weighted = np.linalg.solve(noise, np.column_stack([jacobian, residual]))
        a = jacobian.T @ weighted
        self._fit.add(a[:, :4], a[:, 4], float(residual @ weighted[:, 4]), 3.0)

    def shifted(self, wholly: bool = True) -> None:
        """The stamps are shifted by another time from now on; `wholly`: by all that they are off."""
        self._last = None
        if wholly:
            self._fit.fade(KEPT_WEIGHT)

    def solve(self) -> tuple[Array, Array]:
        """The unknowns and their standard deviations, (4,) each."""
        return self._fit.solve()


class MapFit:
    """Unknowns (7,): offset of the stamps [s], turn [rad] and place [m] of the mount in base_link."""

    def __init__(self) -> None:
        self._fit = LeastSquares(np.array([PRIOR_OFFSET, *[PRIOR_TURN] * 3, *[PRIOR_PLACE] * 3]))

    def pose(self, pose: Array, linear: Array, angular: Array, shift: float) -> tuple[Array, Array]:
        """Where the cloud of a body at `pose` (4, 4) would lie by what is known, and the displacement (6,) place, turn
        in base_link that this takes out. `linear`, `angular` (3,): velocity during the sweep [m/s, rad/s].
        """
        x = self._fit.solve()[0]
        x[0] -= shift
        off = _displacement(linear, angular) @ x
        back = np.eye(4)
        q = np.array([0.0, 0.0, 0.0, 1.0])
        turn(q, *-off[3:])
        back[:3, :3], back[:3, 3] = rotation(q), -off[:3]
        return np.ascontiguousarray(pose @ back), off

    def add(
        self,
        fitted: tuple[Array, Array, int, int, int, float, float],
        pose: Array,
        off: Array,
        linear: Array,
        angular: Array,
        sigma: float,
        shift: float,
    ) -> None:
        """Add the result of `VoxelPlanes.fit` at the `pose` that was found with `off`, see `pose`; `sigma` [m]: error
        of a plane."""
        h, b, _, _, inliers, total, _ = fitted
        if inliers < INDEPENDENT_POINTS:
            return
        axes = np.zeros((6, 6))
        axes[:3, :3] = axes[3:, 3:] = pose[:3, :3].T
        weight = INDEPENDENT_POINTS / inliers / (sigma**2 + total / inliers)
        d = _displacement(linear, angular)
        known = off + shift * d[:, 0]
        # A plane that noise tilts says of a cloud that lies beside its middle that it lies ahead or aside.
        h, b = observed(axes @ h @ axes.T).earned(axes @ b)
        h, b = weight * h, weight * b
        c = weight * total + 2.0 * float(known @ b) + float(known @ h @ known)
        b = b + h @ known
        self._fit.add(d.T @ h @ d, d.T @ b, c, INDEPENDENT_POINTS)

    def shifted(self, wholly: bool = True) -> None:
        """The stamps are shifted by another time from now on; `wholly`: by all that they are off."""
        if wholly:
            self._fit.fade(KEPT_WEIGHT)

    def solve(self) -> tuple[Array, Array]:
        """The unknowns and their standard deviations, (7,) each."""
        return self._fit.solve()


def _displacement(linear: Array, angular: Array) -> Array:
    """(6, 7) place and turn of a cloud beside its true place, base_link, for each unknown: it was taken `offset`
    later, so it lies behind by the motion."""
    out = np.zeros((6, 7))
    out[:3, 0], out[3:, 0] = -linear, -angular
    out[3:, 1:4] = np.eye(3)
    out[:3, 4:] = np.eye(3)
    return out
