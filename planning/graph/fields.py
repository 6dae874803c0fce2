"""Stepfields: ground whose faces point in two directions all around. A controller that climbs one face may get stuck
between posts of that height."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.faces import FACE_NOISE
from planning.graph.flags import FIELD, POSTS
from planning.graph.params import Window

LOCAL_SIDE = 0.30
"""Side of the square in which faces are compared [m]: two to three posts."""
FIELD_SIDE, FIELD_SHARE = 0.80, 0.65
"""So much of a square of this side [m], larger than the wheelbase, has faces in two directions: a field. The ends of
bars and rails, crossing ramps and rough ground have less."""
LEAST_MOMENT = 0.26
"""Smaller eigenvalue of the faces' second moment, averaged over the local square, where the highest posts are 1 m
[m^2]. It grows with their height squared."""
RIM_SHARE, FIELD_SPREAD = 0.5, 1.2
"""From outside a LiDAR sees the tops of the posts alone, which lie as if they were half as high or less. So a field
whose rim was seen goes on over ground within this distance [m] on which posts would be above this share of the least
height, as far as that ground was seen."""
ENTERED_WAY = 0.5
"""So much of a way [m] in a field that was not reckoned with is reason to look for another."""
EVEN_CELLS = 1
"""Even ground is a square of this many cells on each side of one: a lane between posts and a wall is not much wider on
the map."""
OBSTACLE_FACE = 0.25
"""A face this high [m] is an obstacle whatever the controller: what is lower may still be crossed further on. Higher
ones are no posts, and nothing is compared beside them."""


def reach(res: float) -> int:
    """Cells around a changed face in which the flag may change."""
    return (
        math.ceil(0.5 * FIELD_SIDE / res)
        + math.ceil(0.5 * LOCAL_SIDE / res)
        + math.ceil(FIELD_SPREAD / res)
        + 2
    )


def mark_fields(
    flags: NDArray[np.uint16],
    faces: NDArray[np.int16],
    trusted: NDArray[np.bool_],
    res: float,
    window: Window,
    max_posts: float,
) -> None:
    """Set or clear `POSTS` and `FIELD` in the window of `flags` (rows, cols): fields with posts higher than `max_posts`
    [m], and than a third of it.

    faces: (rows, cols, 2) [mm], see `planning.graph.faces`, known around the window as far as `reach`. A field that is
    out must be seen well; for a price that part of it tells which is `trusted` (rows, cols), and the field goes on as
    far as `FIELD_SPREAD`. Sums are of whole numbers, so that a part gives exactly what the whole map gives.
    """
    r0, c0, r1, c1 = window
    pad = reach(res)
    around = np.s_[max(0, r0 - pad) : r1 + pad, max(0, c0 - pad) : c1 + pad]
    inner = np.s_[min(r0, pad) : min(r0, pad) + r1 - r0, min(c0, pad) : min(c0, pad) + c1 - c0]
    out = flags[r0:r1, c0:c1]
    # Copies: a piece and a whole map would be two layouts, and the kernel would be compiled for both.
    piece = np.ascontiguousarray(faces[around]), np.ascontiguousarray(trusted[around])
    sides = round(0.5 * LOCAL_SIDE / res), round(0.5 * FIELD_SIDE / res)

    found = compared(piece[0], *sides)

    def higher(posts: float, *, parts: bool) -> NDArray[np.bool_]:
        return fields_in(found, piece[1], parts, *sides, LEAST_MOMENT * (1000.0 * posts) ** 2)

    rim = higher(max_posts / 3.0, parts=True)
    near = sums(rim.astype(np.int32), round(FIELD_SPREAD / res)) > 0
    uneven = higher(RIM_SHARE * max_posts / 3.0, parts=True)
    for flag, where in ((POSTS, higher(max_posts, parts=False)), (FIELD, rim | (near & uneven))):
        out[:] = np.where(where[inner], out | np.uint16(flag), out & ~np.uint16(flag))


@njit(cache=True)
def compared(faces, local, wide):
    """Sums over the square of 2 `local` + 1 cells around each: x x, y y and x y of its faces [mm^2], and the number of
    its walls; then whether a wall is in the square of 2 `wide` + 1 cells. (5, rows, cols) int32, the same for every
    height of posts."""
    rows, cols, _ = faces.shape
    out = np.zeros((5, rows, cols), np.int32)
    for r in range(rows):
        for c in range(cols):
            x = np.int64(faces[r, c, 0])
            y = np.int64(faces[r, c, 1])
            size2 = x * x + y * y
            if size2 > (1000.0 * OBSTACLE_FACE) ** 2:
                out[3, r, c] = 1
            elif size2 >= (1000.0 * FACE_NOISE) ** 2:
                out[0, r, c], out[1, r, c], out[2, r, c] = x * x, y * y, x * y
    for k in range(4):
        summed = sums(out[k], local)
        for r in range(rows):
            for c in range(cols):
                out[k, r, c] = summed[r, c]
    beside_wall = sums(out[3], wide)
    for r in range(rows):
        for c in range(cols):
            out[4, r, c] = beside_wall[r, c] > 0
    return out


@njit(cache=True)
def fields_in(found, trusted, parts, local, wide, least):
    """(rows, cols) where a square of 2 `wide` + 1 cells is a field. `found`: see `compared`. `least`: the smaller
    eigenvalue of a cell [mm^2], averaged over a square of 2 `local` + 1 cells; `parts`: over that part of it which is
    `trusted`. Of what lies outside nothing is known."""
    rows, cols = trusted.shape
    out = np.zeros((rows, cols), np.bool_)
    known = np.ones((rows, cols), np.int32)
    if parts:
        for r in range(rows):
            for c in range(cols):
                known[r, c] = trusted[r, c]
    count = sums(known, local) if parts else known
    whole = (2 * local + 1) ** 2
    ground = np.zeros((rows, cols), np.int32)
    both = np.zeros((rows, cols), np.int32)
    number = 0
    for r in range(rows):
        for c in range(cols):
            if found[3, r, c] == 0 and known[r, c] > 0:
                ground[r, c] = 1
                # the smaller eigenvalue, mean - hypot(half, xy), is above the least; without the root
                xx, yy, xy = found[0, r, c], found[1, r, c], float(found[2, r, c])
                mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
                over = mean - least * (count[r, c] if parts else whole)
                both[r, c] = over > 0.0 and over * over > half * half + xy * xy
                number += both[r, c]
    if number == 0:  # most ground has no faces in two directions anywhere
        return out
    area, share, beside = sums(ground, wide), sums(both, wide), sums(both, local)
    enough = (1.0 - FIELD_SHARE) * (2 * wide + 1) ** 2
    even = _even(ground, both, local)
    for r in range(rows):
        for c in range(cols):
            of_it = both[r, c] > 0 or (known[r, c] == 0 and beside[r, c] > 0)
            # beside a wall little ground is left of the square: an even lane there would count as the field beside it
            lane = found[4, r, c] > 0 and even[r, c] > 0
            out[r, c] = of_it and not lane and area[r, c] > enough and share[r, c] > FIELD_SHARE * area[r, c]
    return out


@njit(cache=True)
def _even(ground, both, local):
    """(rows, cols) above 0 where a square of even ground begins within half a local square: so far from posts a cell
    has faces in two directions that are theirs."""
    rows, cols = ground.shape
    uneven = np.empty((rows, cols), np.int32)
    for r in range(rows):
        for c in range(cols):
            uneven[r, c] = both[r, c] > 0 or ground[r, c] == 0
    near = sums(uneven, np.int64(EVEN_CELLS))
    for r in range(rows):
        for c in range(cols):
            uneven[r, c] = near[r, c] == 0
    return sums(uneven, EVEN_CELLS + local)


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
