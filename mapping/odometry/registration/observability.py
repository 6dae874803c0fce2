"""Which of the six directions a registration observes. Those that only noise pretends to see are left to gyro and
wheels.

A direction is a small motion of the body: displacement and turn together, because a single post ties the two. Turns
are weighed with the root mean square lever of the points [m], so a turn and a displacement that move the points as
far weigh the same. Errors of the normals then pretend the same share in each direction: the information of a flat
floor about the heading comes from nothing else.

Zhang, Kaess, Singh, "On degeneracy of optimization-based state estimation problems", 2016."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hal.types import Array

NORMAL_NOISE = 0.002
"""Share of facing surface that noise of the normals (0.04 rad) alone pretends."""
FREE_SHARE = 2.0 * NORMAL_NOISE
"""Share below which nothing is observed: what is left is as uncertain as what was taken off."""
UNKNOWN_SIGMA = 1e2
"""Standard deviation of a registration along an unconstrained direction, in metres of the points: it says nothing
there."""


@dataclass(frozen=True, slots=True)
class Observed:
    """Analysis of an information matrix (6, 6): position in `odom`, rotation about base_link in `odom` axes."""

    weight: float
    """Of all points together: 1 where each lies on a surface that has earned its full weight."""
    facing: Array
    """(6,) ascending: share of surface that faces each direction, less what noise pretends; 0 where it is free."""
    directions: Array
    """(6, 6) columns: the directions, displacement [m] and turn [rad], each of root mean square length 1 m at the
    points."""
    lever: float
    """Root mean square lever of the points [m]."""

    def step(self, gradient: Array) -> Array:
        """The least-squares step (6,) against `gradient` (6,) within the observed directions; the others stay as they
        are."""
        seen = self.facing > 0.0
        along = self.directions[:, seen]
        return -along @ ((along.T @ gradient) / (self.weight * (self.facing[seen] + NORMAL_NOISE)))

    def earned(self, gradient: Array) -> tuple[Array, Array]:
        """Information (6, 6) and the part of `gradient` (6,) that belongs to it: what noise pretends is taken off."""
        seen = self.facing > 0.0
        along = self.directions[:, seen]
        across = np.linalg.inv(self.directions)[seen]
        facing = self.facing[seen]
        share = facing / (facing + NORMAL_NOISE)
        return self.weight * (across.T * facing) @ across, across.T @ (share * (along.T @ gradient))

    def covariance(self, variance: float) -> Array:
        """(6, 6) for points with `variance` [m^2] that count together as one."""
        spread = np.full(6, UNKNOWN_SIGMA**2)
        seen = self.facing > 0.0
        spread[seen] = variance / (self.weight * self.facing[seen])
        return (self.directions * spread) @ self.directions.T

    def blurred(self, prior: Array) -> float:
        """Variance [m^2] that noise of the normals adds to a point, if the body may be off by `prior` (6, 6), axes as
        those of the information. A surface seen askew takes a displacement along it for one across. If the robot was
        not watched, this is most of the error."""
        return NORMAL_NOISE * float(np.trace(prior[:3, :3]) + self.lever**2 * np.trace(prior[3:, 3:]))


def observed(information: Array) -> Observed:
    """Of `information` (6, 6), the mean of J^T J, see `Match`."""
    weight = float(information[0, 0] + information[1, 1] + information[2, 2])
    turns = float(information[3, 3] + information[4, 4] + information[5, 5])
    if weight <= 0.0 or turns <= 0.0:
        return Observed(0.0, np.zeros(6), np.eye(6), 0.0)
    lever = np.sqrt(turns / weight)
    scale = np.array([1.0, 1.0, 1.0, 1.0 / lever, 1.0 / lever, 1.0 / lever])
    values, vectors = np.linalg.eigh(scale[:, None] * information * scale / weight)
    facing = np.where(values < FREE_SHARE, 0.0, values - NORMAL_NOISE)
    return Observed(weight, facing, scale[:, None] * vectors, float(lever))
