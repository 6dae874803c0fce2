"""Filling unknown heights with the nearest known cell, so that every sample has a height (it stays untrusted)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def _nearest_known(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the nearest known cell for every cell: exact Euclidean, two passes (columns, then rows).

    Ties go to the lower column offset from the left; each pass is linear (lower envelope of parabolas).
    """
    rows, cols = known.shape
    near_row = np.full((rows, cols), -1, np.int64)
    for c in range(cols):
        last = -1
        for r in range(rows):
            if known[r, c]:
                last = r
            near_row[r, c] = last
        last = -1
        for r in range(rows - 1, -1, -1):
            if known[r, c]:
                last = r
            up = near_row[r, c]
            if last >= 0 and (up < 0 or last - r < r - up):
                near_row[r, c] = last
    out_row = np.empty((rows, cols), np.int64)
    out_col = np.empty((rows, cols), np.int64)
    apex = np.empty(cols, np.int64)
    bound = np.empty(cols + 1, np.float64)
    for r in range(rows):
        count = 0
        for c in range(cols):
            if near_row[r, c] < 0:
                continue
            d = float(near_row[r, c] - r)
            start = -np.inf
            while count > 0:
                p = apex[count - 1]
                e = float(near_row[r, p] - r)
                start = ((d * d + c * c) - (e * e + p * p)) / (2.0 * (c - p))
                if start > bound[count - 1]:
                    break
                count -= 1
                start = -np.inf
            apex[count] = c
            bound[count] = start
            count += 1
        k = 0
        for c in range(cols):
            while k + 1 < count and bound[k + 1] < c:
                k += 1
            out_col[r, c] = apex[k]
            out_row[r, c] = near_row[r, apex[k]]
    return out_row, out_col


def fill_unknown(height: NDArray[np.float32]) -> NDArray[np.float32]:
    """`height` (rows, cols) with every non-finite cell replaced by the height of the nearest finite cell.

    Returns the array itself when nothing is missing, zeros when nothing is known.
    """
    known = np.isfinite(height)
    if known.all():
        return height
    if not known.any():
        return np.zeros_like(height)
    row, col = _nearest_known(known)
    return height[row, col]
