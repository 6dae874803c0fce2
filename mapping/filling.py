"""Finite heights for planning: the nearest known cell, but never above what a ray proved empty."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def fill_unknown(
    height: NDArray[np.float32], upper_bound: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Copy of `height` (rows, cols) whose cells that are not finite hold the height of the nearest known cell [m].

    Where `upper_bound` (NaN: none) is lower than that, the bound is taken: a hole whose floor was never seen becomes a
    hole. An array without any known cell comes back as zeros.
    """
    height = np.ascontiguousarray(height, dtype=np.float32)
    if upper_bound is None:
        upper_bound = np.full_like(height, np.nan)
    return _fill(height, np.ascontiguousarray(upper_bound, dtype=np.float32))


@njit(cache=True)
def _known_rows(height):  # pragma: no cover
    """Row of the nearest known cell in each cell's column, -1 in a column without any; and the number of known cells.

    The upper of two that are equally near. Both sweeps go along rows, as the memory does.
    """
    rows, cols = height.shape
    near = np.empty((rows, cols), np.int32)
    count = 0
    for c in range(cols):
        near[0, c] = 0 if np.isfinite(height[0, c]) else -1
        count += near[0, c] == 0
    for r in range(1, rows):
        for c in range(cols):
            if np.isfinite(height[r, c]):
                near[r, c] = r
                count += 1
            else:
                near[r, c] = near[r - 1, c]
    for r in range(rows - 2, -1, -1):
        for c in range(cols):
            up, down = near[r, c], near[r + 1, c]
            if down > r and (up < 0 or down - r < r - up):
                near[r, c] = down
    return near, count


@njit(cache=True)
def _fill(height, upper):  # pragma: no cover
    """Exact Euclidean, columns then rows: each row takes the lower envelope of the parabolas of its columns."""
    rows, cols = height.shape
    out = height.copy()
    near, count = _known_rows(height)
    if count == 0:
        out[:] = 0.0
    if count == 0 or count == rows * cols:
        return out
    apex = np.empty(cols, np.int64)
    bound = np.empty(cols, np.float64)
    for r in range(rows):
        some = False
        for c in range(cols):
            some |= near[r, c] != r
        if not some:
            continue
        count = 0
        for c in range(cols):
            if near[r, c] < 0:
                continue
            d = float(near[r, c] - r)
            start = -np.inf
            while count > 0:
                p = apex[count - 1]
                e = float(near[r, p] - r)
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
            if near[r, c] != r:
                z = height[near[r, apex[k]], apex[k]]
                if upper[r, c] < z:
                    z = upper[r, c]
                out[r, c] = z
    return out


@njit(cache=True)
def slope_and_step(height, resolution):  # pragma: no cover
    """Slope [rad] and step [m] of each cell, (rows, cols) float32, NaN where the height is.

    slope: of the plane through the known cells among the 3 x 3 around it (central or one-sided differences per axis);
    step: largest height difference to one of its eight neighbours.
    """
    rows, cols = height.shape
    slope = np.full((rows, cols), np.nan, dtype=np.float32)
    step = np.full((rows, cols), np.nan, dtype=np.float32)
    for r in range(rows):
        for c in range(cols):
            h = height[r, c]
            if h != h:
                continue
            big = np.float32(0.0)
            for a in range(max(r - 1, 0), min(r + 2, rows)):
                for b in range(max(c - 1, 0), min(c + 2, cols)):
                    d = abs(height[a, b] - h)
                    if d > big:
                        big = d
            step[r, c] = big
            grade = 0.0
            for axis in range(2):
                before, after = h, h
                n = 0
                if axis == 0:
                    if r > 0 and height[r - 1, c] == height[r - 1, c]:
                        before, n = height[r - 1, c], n + 1
                    if r < rows - 1 and height[r + 1, c] == height[r + 1, c]:
                        after, n = height[r + 1, c], n + 1
                else:
                    if c > 0 and height[r, c - 1] == height[r, c - 1]:
                        before, n = height[r, c - 1], n + 1
                    if c < cols - 1 and height[r, c + 1] == height[r, c + 1]:
                        after, n = height[r, c + 1], n + 1
                if n > 0:
                    g = (after - before) / (n * resolution)
                    grade += g * g
            slope[r, c] = np.arctan(np.sqrt(grade))
    return slope, step
