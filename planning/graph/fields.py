"""Stepfields: ground whose faces point in two directions all around. A controller that climbs one face may get stuck between posts of that height."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.flags import FIELD, POSTS
from planning.graph.params import Window

LOCAL = 0.30
"""Side of the square in which faces are compared [m]: two to three posts."""
SIDE, SHARE = 0.80, 0.65
"""So much of a square of this side [m], larger than the wheelbase, has faces in two directions: a field. The ends of bars and rails, crossing
ramps and rough ground have less."""
FACES = 0.26
"""Smaller eigenvalue of the faces' second moment, averaged over the local square, where the highest posts are 1 m [m^2]. It grows with
their height squared."""
LEAST = 0.03
"""Lower faces [m] are noise."""
WALL = 0.25
"""Higher ones [m] are no posts, and nothing is compared beside them."""


def reach(res: float) -> int:
    """Cells around a changed face in which the flag may change."""
    return math.ceil(0.5 * SIDE / res) + math.ceil(0.5 * LOCAL / res) + 2


def mark_fields(
    flags: NDArray[np.uint16],
    faces: NDArray[np.int16],
    trusted: NDArray[np.bool_],
    res: float,
    window: Window,
    max_posts: float,
) -> None:
    """Set or clear `POSTS` and `FIELD` in the window of `flags` (rows, cols): fields with posts higher than `max_posts` [m], and than a third of it.

    faces: (rows, cols, 2) [mm], see `planning.graph.faces`, known around the window as far as `reach`. A field that is out must be seen well;
    for a price that part of it tells which is `trusted` (rows, cols). Sums are of whole numbers, so that a part gives exactly what the whole map gives.
    """
    local, wide = round(0.5 * LOCAL / res), round(0.5 * SIDE / res)
    for flag, posts, parts in ((POSTS, max_posts, False), (FIELD, max_posts / 3.0, True)):
        least = FACES * (1000.0 * posts) ** 2
        _mark(flags, np.uint16(flag), faces, trusted, parts, *window, reach(res), local, wide, least)


@njit(cache=True)
def _mark(flags, flag, faces, trusted, parts, r0, c0, r1, c1, pad, local, wide, least):
    """Set or clear `flag`, see `mark_fields`; `least`: the smaller eigenvalue of a cell, averaged over a local square. `parts`: over that part of it
    which is trusted."""
    ra, ca = max(0, r0 - pad), max(0, c0 - pad)
    rows, cols = min(flags.shape[0], r1 + pad) - ra, min(flags.shape[1], c1 + pad) - ca
    xx = np.zeros((rows, cols), np.int32)
    yy = np.zeros((rows, cols), np.int32)
    xy = np.zeros((rows, cols), np.int32)
    walls = np.zeros((rows, cols), np.int32)
    known = np.ones((rows, cols), np.int32)
    for r in range(rows):
        for c in range(cols):
            x = np.int64(faces[ra + r, ca + c, 0])
            y = np.int64(faces[ra + r, ca + c, 1])
            size2 = x * x + y * y
            if parts and not trusted[ra + r, ca + c]:
                known[r, c] = 0
            if size2 > (1000.0 * WALL) ** 2:
                walls[r, c] = 1
            elif size2 >= (1000.0 * LEAST) ** 2:
                xx[r, c], yy[r, c], xy[r, c] = x * x, y * y, x * y
    xx, yy, xy, walls = sums(xx, local), sums(yy, local), sums(xy, local), sums(walls, local)
    count = sums(known, local)
    whole = (2 * local + 1) ** 2
    ground = np.zeros((rows, cols), np.int32)
    both = np.zeros((rows, cols), np.int32)
    for r in range(rows):
        for c in range(cols):
            if walls[r, c] == 0 and known[r, c] > 0:
                ground[r, c] = 1
                # the smaller eigenvalue, mean - hypot(half, xy), is above the least; without the root
                mean, half = 0.5 * (xx[r, c] + yy[r, c]), 0.5 * (xx[r, c] - yy[r, c])
                off = float(xy[r, c])
                over = mean - least * (count[r, c] if parts else whole)
                both[r, c] = over > 0.0 and over * over > half * half + off * off
    ground, both = sums(ground, wide), sums(both, wide)
    enough = (1.0 - SHARE) * (2 * wide + 1) ** 2
    for r in range(r0, r1):
        for c in range(c0, c1):
            area = ground[r - ra, c - ca]
            if area > enough and both[r - ra, c - ca] > SHARE * area:
                flags[r, c] |= flag
            else:
                flags[r, c] &= ~flag


@njit(cache=True)
def sums(values, k):
    """Sum of `values` (rows, cols) int32 over the square of 2 k + 1 cells around each; nothing outside."""
    rows, cols = values.shape
    out = np.empty((rows, cols), np.int32)
    column = np.zeros(cols, np.int32)
    for r in range(min(k, rows)):
        column += values[r]
    # sum of the columns before each one, from k left of the first on
    before = np.zeros(cols + 2 * k + 1, np.int32)
    for r in range(rows):
        if r + k < rows:
            column += values[r + k]
        if r > k:
            column -= values[r - k - 1]
        for c in range(cols + k):
            before[c + k + 1] = before[c + k] + (column[c] if c < cols else 0)
        for c in range(cols):
            out[r, c] = before[c + 2 * k + 1] - before[c]
    return out
