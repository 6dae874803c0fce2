"""Bends of a path: where it turns round, and the speed limits from bends and from the room to brake. Every speed
profile of a path uses these two."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

FOLD_ANGLE = math.radians(100.0)
"""A path that turns by more at one point turns round: the ways to and from it lie beside each other, so it is driven to
that point first."""


def bend_speed(curvature: Array, lateral_accel: float, max_yaw_rate: float) -> Array:
    """(n,) [m/s] at which `curvature` (n,) [1/m] keeps both limits, [m/s^2] and [rad/s]."""
    bend = np.maximum(np.abs(curvature), 1e-6)
    return np.minimum(np.sqrt(lateral_accel / bend), max_yaw_rate / bend)


@njit(cache=True)
def brake(speed: np.ndarray, ds: np.ndarray, decel: float) -> None:
    """Lower `speed` (n,) [m/s] in place, so that `decel` [m/s^2] suffices for every lower speed ahead.

    `ds` (n - 1,) [m]: distance from each point to the next.
    """
    for i in range(len(ds) - 1, -1, -1):
        speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2.0 * decel * ds[i]))
