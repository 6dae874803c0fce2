"""Eq. 5 of the paper: what driving one edge costs, the turns at its ends included."""

from __future__ import annotations

from typing import Any, NamedTuple

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


def cost_of(w: Weights, length: Any, risk: Any, body: Any, unknown: Any) -> Any:
    """Cost [m] of transitions: l (1 + sigma r + lambda_b B + lambda_u U) (eq. 5). Works on numbers and on arrays.

    `length` is planar [m], `risk` the native risk r; `body` B and `unknown` U are the worst of the transition's pose
    sets. With B = U = 0 it is the native cost, a lower bound for what is not evaluated yet.
    """
    return length * (1.0 + w.native * risk + w.body * body + w.unknown * unknown)


transition_cost = njit(cache=True)(cost_of)
"""The same for kernels. Called with arrays it would be compiled once more for each kind of them."""
