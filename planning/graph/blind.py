"""Blind zone: ground around the first start that no LiDAR on this body sees. It counts as seen."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.raster import cell_of
from planning.graph.flags import ASSUMED, FACE, UNSEEN, UNSEEN_RAW


@njit(cache=True)
def assume_blind(flags, x0, y0, res, x, y, radius):
    """Mark unseen ground within `radius` [m] of the start x, y as seen if no step separates it from the start.

    Behind a wall nothing is assumed: the robot never stood there. Returns the window (row0, col0, row1, col1) of the
    cells whose `UNSEEN` flag changed; empty when none did.
    """
    rows, cols = flags.shape
    r0 = max(0, math.ceil((y - radius - y0) / res))
    c0 = max(0, math.ceil((x - radius - x0) / res))
    r1 = min(rows, math.floor((y + radius - y0) / res) + 1)
    c1 = min(cols, math.floor((x + radius - x0) / res) + 1)
    if r0 >= r1 or c0 >= c1:
        return 0, 0, 0, 0
    sight = np.zeros((r1 - r0, c1 - c0), np.bool_)
    rays = math.ceil(2.0 * math.pi * radius / (0.7 * res))
    steps = math.floor(2.0 * radius / res)
    for a in range(rays):
        dx = 0.5 * res * math.cos(2.0 * math.pi * a / rays)
        dy = 0.5 * res * math.sin(2.0 * math.pi * a / rays)
        for s in range(steps + 1):
            c = cell_of(x + s * dx, x0, res)
            r = cell_of(y + s * dy, y0, res)
            if r < r0 or c < c0 or r >= r1 or c >= c1 or flags[r, c] & FACE:
                break
            sight[r - r0, c - c0] = True
    low_r, low_c, high_r, high_c = r1, c1, r0, c0
    for r in range(r0, r1):
        for c in range(c0, c1):
            flag = flags[r, c]
            assumed = sight[r - r0, c - c0]
            if assumed == (flag & ASSUMED > 0):
                continue
            flags[r, c] = flag ^ ASSUMED
            if flag & UNSEEN_RAW:
                flags[r, c] ^= UNSEEN
                low_r, high_r = min(low_r, r), max(high_r, r + 1)
                low_c, high_c = min(low_c, c), max(high_c, c + 1)
    if low_r >= high_r:
        return 0, 0, 0, 0
    return low_r, low_c, high_r, high_c
