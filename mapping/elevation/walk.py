"""A walk along a ray over the cells of the map, exact (Amanatides & Woo). Cell k of the lattice spans [k, k + 1)."""

from __future__ import annotations

import math

import numpy as np

from hal.kernels import inlined


@inlined
def first_cell(x, y, ux, uy, at, resolution):  # pragma: no cover - compiled
    """Start of a walk at lattice coordinates x, y after `at` [m] along the unit vector ux, uy. Returns row and column
    of the cell, and the way [m] to its end in rows and in columns."""
    i, j = np.int64(math.floor(y)), np.int64(math.floor(x))
    next_i = at + ((i + 1 - y) if uy > 0.0 else (y - i)) * (resolution / abs(uy)) if uy != 0.0 else np.inf
    next_j = at + ((j + 1 - x) if ux > 0.0 else (x - j)) * (resolution / abs(ux)) if ux != 0.0 else np.inf
    return i, j, next_i, next_j


@inlined
def next_cell(i, j, next_i, next_j, ux, uy, gap_i, gap_j):  # pragma: no cover - compiled
    """The cell behind the nearer end of cell (i, j), and the ways [m] to its ends; `gap_i`, `gap_j` [m] lie between
    two ends."""
    if next_j < next_i:
        return i, j + (1 if ux > 0.0 else -1), next_i, next_j + gap_j
    return i + (1 if uy > 0.0 else -1), j, next_i + gap_i, next_j
