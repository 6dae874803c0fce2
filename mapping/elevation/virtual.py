"""Virtual ground: unmeasured cells over which a ray passed low, after the surfaces of CSIRO's robots at SubT.

The upper bound of such a cell is its best case. If even that is too steep nothing drives there. Otherwise it may be
ground or a pit, which shows only from near. Plans may lead over it; the robot drives on it after it was seen."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

LOW_RAY = 0.25
"""A ray this near above the nearest known ground [m] leaves no room for a wall."""
SLIT_WIDTH = 0.24
"""Cells without a ray in a gap up to this width [m] count as the cells beside them: behind a crest the rays begin a
bit farther."""


def virtual_ground(
    filled: NDArray[np.float32],
    trusted: NDArray[np.bool_],
    upper: NDArray[np.float32],
    resolution: float,
) -> NDArray[np.bool_]:
    """(rows, cols) which cells are virtual ground.

    filled: heights as of `fill_unknown` [m]; upper: bounds [m], NaN where no ray tells.
    """
    return _virtual(filled, trusted, upper, LOW_RAY, int(SLIT_WIDTH / resolution + 1e-6))


@njit(cache=True)
def _virtual(filled, trusted, upper, low, slit):  # pragma: no cover
    rows, cols = filled.shape
    out = np.zeros((rows, cols), np.bool_)
    for r in range(rows):
        for c in range(cols):
            out[r, c] = not trusted[r, c] and upper[r, c] <= filled[r, c] + low
    believed = out | trusted
    far = -(1 << 30)
    above = np.full(
        cols, far, np.int64
    )  # row of the last believed cell of each column, unless a high ray came after it
    for r in range(rows):
        left = far
        for c in range(cols):
            if believed[r, c]:
                if c - left - 1 <= slit:
                    out[r, left + 1 : c] = True
                if r - above[c] - 1 <= slit:
                    out[above[c] + 1 : r, c] = True
                left, above[c] = c, r
            elif upper[r, c] == upper[r, c]:
                left, above[c] = far, far
    return out
