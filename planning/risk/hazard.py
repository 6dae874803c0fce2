"""The price of crossing a face or turning at one, for ground whose height the map knows with a standard deviation.

`HazardTable` holds one manoeuvre of an envelope as arrays over height, angle (or slope) and a third axis; `risk` reads it inside kernels.
What the map does not know well costs by itself: the probability is the mean over height - sqrt(3) sigma, height and height + sqrt(3)
sigma with weights 1/6, 2/3, 1/6 (Gauss and Hermite with three points, exact for the first five moments of the height).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from hal.envelope import FALL_COST, MAX_RISK, Envelope

SPREAD = math.sqrt(3.0)
"""Of the outer points, in standard deviations."""
MIDDLE, OUTER = 2.0 / 3.0, 1.0 / 6.0
"""Weights of the points."""
HEIGHT_STEP = 0.01
"""Of a table's heights [m]: the fit is smooth on that scale."""
ANGLE_STEP = math.radians(5.0)

Grid = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class HazardTable:
    """Probabilities of failure of one manoeuvre over equidistant values of its axes, for kernels."""

    mean: Grid
    """(heights, n, m): by which it costs."""
    bound: Grid
    """(heights, n, m): by which it is no way; one beyond what was tested."""
    steps: tuple[float, float, float]
    """Between the values of each axis, which begin at zero [m, rad]."""

    @classmethod
    def of(cls, envelope: Envelope, name: str) -> HazardTable:
        """For faces (height, angle, slope) and turns (height, slope, astride). Raises KeyError for a manoeuvre that was not measured."""
        axes = envelope.manoeuvres[name].axes
        steps = tuple(HEIGHT_STEP if a.unit == "m" else 1.0 if a.unit == "-" else ANGLE_STEP for a in axes)
        # One value beyond the largest, where there is no way.
        values = [
            s * np.arange(math.floor(a.si[-1] / s + 1e-6) + 2) for a, s in zip(axes, steps, strict=True)
        ]
        grid = np.meshgrid(*values, indexing="ij")
        mean, bound = envelope.mean(name, *grid), envelope.bound(name, *grid)
        return cls(
            np.where(bound >= 1.0, np.maximum(mean, bound), mean), bound, (steps[0], steps[1], steps[2])
        )

    def price(self, height: float, sigma: float, second: float, third: float) -> float:
        """Price [m] of one crossing or radian; infinite where it is no way. `height`, `sigma` [m]; the other axes in SI units."""
        return float(price(self.mean, self.bound, self.steps, height, sigma, second, third))


def hazards(
    envelope: Envelope, name: str, sigma: ArrayLike, height: ArrayLike, *rest: ArrayLike, share: float = 1.0
) -> Grid:
    """-ln(1 - p) of units of a manoeuvre whose first axis is known with `sigma`, in numpy, as far as the fit reaches. SI units, broadcast.

    It tells the chance of what is driven; what is no way is the business of `price`.
    """
    height, aside = np.asarray(height, np.float64), SPREAD * np.asarray(sigma, np.float64)
    p = MIDDLE * envelope.mean(name, height, *rest) + OUTER * (
        envelope.mean(name, np.maximum(height - aside, 0.0), *rest)
        + envelope.mean(name, height + aside, *rest)
    )
    return -np.log1p(-share * np.minimum(p, 1.0 - 1e-9))


@njit(cache=True)
def price(mean, bound, steps, height, sigma, second, third):
    """See `HazardTable.price`."""
    if risk(bound, steps, height, sigma, second, third) > MAX_RISK:
        return math.inf
    return -FALL_COST * math.log1p(-risk(mean, steps, height, sigma, second, third))


@njit(cache=True)
def risk(table, steps, height, sigma, second, third):
    """Mean probability over a height (mean and standard deviation, m)."""
    aside = SPREAD * sigma
    return MIDDLE * _at(table, steps, height, second, third) + OUTER * (
        _at(table, steps, max(height - aside, 0.0), second, third)
        + _at(table, steps, height + aside, second, third)
    )


@njit(cache=True)
def _at(table, steps, height, second, third):
    """Linear between the values of the table; its last value beyond them."""
    out = 0.0
    i, u = _between(height / steps[0], table.shape[0])
    j, v = _between(second / steps[1], table.shape[1])
    k, w = _between(third / steps[2], table.shape[2])
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if c else 1.0 - w)
                if weight > 0.0:
                    out += weight * table[i + a, j + b, k + c]
    return out


@njit(cache=True)
def _between(value, n):
    """Index of the value below, and the share of the way to the next; axes have two values at least."""
    value = min(max(value, 0.0), n - 1.0)
    low = min(int(value), n - 2)
    return low, value - low
