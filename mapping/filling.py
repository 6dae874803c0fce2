"""Finite heights for planning: the nearest known cell, but never above what a ray proved empty."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def fill_unknown(
    height: NDArray[np.float32], upper_bound: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Copy of `height` (rows, cols) whose NaN cells hold the height of the nearest known cell [m].

    Where `upper_bound` (NaN: none) is lower than that, the bound is taken: a hole whose floor was never seen becomes a
    hole. An array without any known cell comes back as zeros.
    """
    height = np.ascontiguousarray(height, dtype=np.float32)
    if upper_bound is None:
        upper_bound = np.full_like(height, np.nan)
    return _fill(height, np.ascontiguousarray(upper_bound, dtype=np.float32))


@njit(cache=True)
def _nearest(known):  # pragma: no cover
    """Row and column of a nearest known cell, by vector propagation (8SED, two sweeps); -1 where none."""
    rows, cols = known.shape
    big = 1 << 20
    dr = np.full((rows, cols), big, dtype=np.int32)
    dc = np.full((rows, cols), big, dtype=np.int32)
    for r in range(rows):
        for c in range(cols):
            if known[r, c]:
                dr[r, c] = 0
                dc[r, c] = 0
    for sweep in range(2):
        sign = 1 - 2 * sweep
        for rr in range(rows):
            r = rr if sweep == 0 else rows - 1 - rr
            # first with the row already done (3 neighbours) and the left, then back with the right
            for half in range(2):
                for cc in range(cols):
                    c = cc if half == 0 else cols - 1 - cc
                    best = np.int64(dr[r, c]) * dr[r, c] + np.int64(dc[r, c]) * dc[r, c]
                    if best == 0:
                        continue
                    for q in range(4):
                        if q < 3:
                            if half == 1:
                                continue
                            pr, pc = r - sign, c + q - 1
                        else:
                            pr, pc = r, (c - 1 if half == 0 else c + 1)
                        if pr < 0 or pr >= rows or pc < 0 or pc >= cols or dr[pr, pc] == big:
                            continue
                        nr = np.int64(dr[pr, pc]) + (pr - r)
                        nc = np.int64(dc[pr, pc]) + (pc - c)
                        d = nr * nr + nc * nc
                        if d < best:
                            best = d
                            dr[r, c], dc[r, c] = nr, nc
    return dr, dc, big


@njit(cache=True)
def _fill(height, upper):  # pragma: no cover
    rows, cols = height.shape
    known = np.empty((rows, cols), dtype=np.bool_)
    some = False
    for r in range(rows):
        for c in range(cols):
            known[r, c] = height[r, c] == height[r, c]
            some = some or known[r, c]
    out = height.copy()
    if not some:
        out[:] = 0.0
        return out
    dr, dc, _ = _nearest(known)
    for r in range(rows):
        for c in range(cols):
            if not known[r, c]:
                z = height[r + dr[r, c], c + dc[r, c]]
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
