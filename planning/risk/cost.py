"""Eq. 5 of the paper: what driving one edge costs, the turns at its ends included."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


class Weights(NamedTuple):
    """`BodyModel` as plain numbers for the kernels."""

    scale: NDArray[np.float64]
    """(4,) divisors of the features."""
    clip: float
    mean: float
    tail: float
    native: float
    body: float
    unknown: float
    edge_step: float
    sweep_step: float
    """[rad]"""


@njit(cache=True)
def transition_cost(w, length, risk, body, unknown):
    """Cost [m] of a transition: l (1 + sigma r + lambda_b B + lambda_u U) (eq. 5). Works on numbers and on arrays.

    `length` is planar [m], `risk` the native risk r; `body` B and `unknown` U are the worst of the transition's pose
    sets. With B = U = 0 it is the native cost, a lower bound for what is not evaluated yet.
    """
    return length * (1.0 + w.native * risk + w.body * body + w.unknown * unknown)
