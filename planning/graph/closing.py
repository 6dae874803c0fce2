"""What squares of cells say about a map: the largest value in each, closing, and which cells a square of unknown ones
covers."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def _raise(line, other):
    """Each of `line` (n,) to the larger of itself and that of `other`."""
    for i in range(len(line)):
        line[i] = other[i] if other[i] > line[i] else line[i]


@njit(cache=True)
def largest(values, m, back):
    """Largest of the m x m cells that begin at each cell, or end there (`back`); those outside do not count. NaN does
    not count, and stays."""
    rows, cols = values.shape
    out = values.copy()
    line = np.empty(cols, values.dtype)
    for axis in range(2):
        for r in range(rows):
            for c in range(cols):
                if values[r, c] != values[r, c]:
                    out[r, c] = -np.inf
        width = 1
        while width < m:  # twice as many cells with each pass
            s = min(width, m - width)
            width += s
            rest = max(0, cols - s)
            for k in range(rows if axis == 1 else rows - s):
                r = rows - 1 - k if back else k
                if axis == 0:
                    _raise(out[r], out[r - s if back else r + s])
                else:
                    for c in range(cols):
                        line[c] = out[r, c]
                    if back:
                        _raise(out[r, s:], line[:rest])
                    else:
                        _raise(out[r, :rest], line[s:])
    for r in range(rows):
        for c in range(cols):
            if values[r, c] != values[r, c]:
                out[r, c] = np.nan
    return out


@njit(cache=True)
def closed(height, m):
    """Closing: what is narrower than m cells is bridged."""
    return -largest(-largest(height, m, np.bool_(False)), m, np.bool_(True))


@njit(cache=True)
def covered(trusted, m):
    """1.0 where an m x m square of untrusted cells covers the cell, else 0.0; none reaches over the border."""
    rows, cols = trusted.shape
    square = np.zeros((rows, cols), np.float32)
    side = np.zeros(cols + 1, np.int32)  # of the largest such square that ends at each cell of this row
    for r in range(rows):
        above_left = 0
        for c in range(cols):
            above = side[c + 1]
            side[c + 1] = 0 if trusted[r, c] else min(min(above, above_left), side[c]) + 1
            above_left = above
            square[r, c] = side[c + 1] >= m
    return largest(square, m, np.bool_(False))
