"""Hazard of crossing a face or turning at one, for ground whose height the map knows with a standard deviation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hal.envelope import Envelope

SPREAD = math.sqrt(3.0)
"""Of the outer points, in standard deviations."""
MIDDLE, OUTER = 2.0 / 3.0, 1.0 / 6.0
"""Weights of the points."""


def hazards(
    envelope: Envelope, name: str, sigma: ArrayLike, height: ArrayLike, *rest: ArrayLike, share: float = 1.0
) -> NDArray[np.float64]:
    """-ln(1 - p) of units of a manoeuvre, as far as the fit reaches. SI units, broadcast.

    p is the mean over height - sqrt(3) sigma, height and height + sqrt(3) sigma with weights 1/6, 2/3, 1/6 (Gauss and
    Hermite with three points, exact for the first five moments of the height), times `share`. What is no way is the
    business of `Envelope.hazard`.
    """
    height, aside = np.asarray(height, np.float64), SPREAD * np.asarray(sigma, np.float64)
    p = MIDDLE * envelope.mean(name, height, *rest) + OUTER * (
        envelope.mean(name, np.maximum(height - aside, 0.0), *rest)
        + envelope.mean(name, height + aside, *rest)
    )
    return np.asarray(-np.log1p(-share * np.minimum(p, 1.0 - 1e-9)))
