"""Stepfields: ground whose faces point in two directions all around. A controller that climbs one face may get stuck between posts of that height."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planning.graph.flags import POSTS
from planning.graph.params import Window

LOCAL = 0.30
"""Side of the square in which faces are compared [m]: two to three posts."""
FIELD, SHARE = 0.80, 0.65
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
    return math.ceil(0.5 * FIELD / res) + math.ceil(0.5 * LOCAL / res) + 2


def mark_fields(
    flags: NDArray[np.uint16], faces: NDArray[np.int16], res: float, window: Window, max_posts: float
) -> None:
    """Set or clear `POSTS` in the window of `flags` (rows, cols): fields with posts higher than `max_posts` [m].

    faces: (rows, cols, 2) [mm], see `planning.graph.faces`, known around the window as far as `reach`. Sums are of whole numbers, so that a
    part gives exactly what the whole map gives.
    """
    rows, cols = flags.shape
    r0, c0, r1, c1 = window
    pad = reach(res)
    ra, ca, rb, cb = max(0, r0 - pad), max(0, c0 - pad), min(rows, r1 + pad), min(cols, c1 + pad)
    local, wide = round(0.5 * LOCAL / res), round(0.5 * FIELD / res)
    part = faces[ra:rb, ca:cb].astype(np.int64)
    size = np.hypot(part[..., 0], part[..., 1])
    part[(size < 1000.0 * LEAST) | (size > 1000.0 * WALL)] = 0
    xx, yy, xy = (_sum(part[..., i] * part[..., j], local) for i, j in ((0, 0), (1, 1), (0, 1)))
    smaller = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    open_ground = _sum(size > 1000.0 * WALL, local) == 0
    both = open_ground & (smaller > FACES * (1000.0 * max_posts) ** 2 * (2 * local + 1) ** 2)
    ground = _sum(open_ground, wide)
    field = (_sum(both, wide) > SHARE * ground) & (ground > (1.0 - SHARE) * (2 * wide + 1) ** 2)
    inner = flags[r0:r1, c0:c1]
    inner[...] = np.where(
        field[r0 - ra : r1 - ra, c0 - ca : c1 - ca], inner | POSTS, inner & ~np.uint16(POSTS)
    )


def _sum(values: NDArray[Any], k: int) -> NDArray[np.int64]:
    """Sum of (rows, cols) over the square of 2 k + 1 cells around each; nothing outside."""
    side = 2 * k + 1
    total = np.cumsum(np.cumsum(np.pad(values.astype(np.int64), ((k + 1, k), (k + 1, k))), axis=0), axis=1)
    square = total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
    return np.asarray(square)
