"""The release's smoother: gradient steps away from obstacles and towards even spacing. Lengths in cells."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

STEP_COUNT, STEP_RATE = 500, 0.1
SMOOTHNESS_WEIGHT, OBSTACLE_WEIGHT = 0.2, 0.2
OBSTACLE_REACH = 2.0
"""Obstacles nearer than this push."""


@njit(cache=True)
def smooth(poses, occupied):
    """(n, 2) points of `poses` (n, 3) moved off obstacles and smoothed; the two first and last and the cusps stay."""
    n = poses.shape[0]
    xy = poses[:, :2].copy()
    fixed = np.zeros(n, np.bool_)
    for i in range(1, n - 1):
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        before = c * (xy[i, 0] - xy[i - 1, 0]) + s * (xy[i, 1] - xy[i - 1, 1])
        after = c * (xy[i + 1, 0] - xy[i, 0]) + s * (xy[i + 1, 1] - xy[i, 1])
        fixed[i] = before * after < 0.0
    rows, cols = occupied.shape
    for _ in range(STEP_COUNT):
        for i in range(2, n - 2):
            if fixed[i] or fixed[i - 1] or fixed[i + 1]:
                continue
            change = SMOOTHNESS_WEIGHT * (
                xy[i - 2] - 4.0 * xy[i - 1] + 6.0 * xy[i] - 4.0 * xy[i + 1] + xy[i + 2]
            )
            near, ox, oy = OBSTACLE_REACH, 0.0, 0.0
            for r in range(max(0, int(xy[i, 1]) - 2), min(rows, int(xy[i, 1]) + 3)):
                for c in range(max(0, int(xy[i, 0]) - 2), min(cols, int(xy[i, 0]) + 3)):
                    if occupied[r, c]:
                        d = math.hypot(xy[i, 0] - c - 0.5, xy[i, 1] - r - 0.5)
                        if d < near:
                            near, ox, oy = d, xy[i, 0] - c - 0.5, xy[i, 1] - r - 0.5
            if 1e-6 < near < OBSTACLE_REACH:
                change[0] += OBSTACLE_WEIGHT * 2.0 * (near - OBSTACLE_REACH) * ox / near
                change[1] += OBSTACLE_WEIGHT * 2.0 * (near - OBSTACLE_REACH) * oy / near
            x = xy[i, 0] - STEP_RATE * change[0] / (SMOOTHNESS_WEIGHT + OBSTACLE_WEIGHT)
            y = xy[i, 1] - STEP_RATE * change[1] / (SMOOTHNESS_WEIGHT + OBSTACLE_WEIGHT)
            if 0.0 <= x < cols and 0.0 <= y < rows:
                xy[i, 0], xy[i, 1] = x, y
    return xy
