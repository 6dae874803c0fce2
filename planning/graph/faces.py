"""Faces: how high and which way the ground rises within a hand's breadth, per cell. They are better crossed head-on.

A face is a vector: the rise over `STEP_BASE` along x and along y, less the slope that the ground has on both sides, or
that goes on evenly to one side: a ridge is no face. What is so steep that wheels slide down sideways is one, and as
high as it goes on: along it, one side of the robot on the foot of a ramp of 45 deg, robots slid 0.2 m aside. Its
direction is the face's normal, uphill; its height is the larger of the two parts, because a step at 45 deg rises by its
whole height in both. Where a rise cannot be told (unknown or untrusted ground) there is no face: `planning.graph.flags`
judges that."""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.graph.flags import STEP_BASE

EVEN_RATIO = 0.7
"""A slope goes on where the next rise is this share of the one here or more, the other way round too."""
STEEPEST_SLOPE = 0.7
"""From here [m/m] on it is no slope: stairs rise evenly as well, and tyres with a friction of 0.7 slide."""
TREAD_RATIO = 0.25
"""Where two rises meet, half of each, ground that rises by less than this share of a steep one is a tread: risers do
not go on into each other."""
FACE_NOISE = 0.03
"""[m] by which a face on the map may be higher than the true one: lower ones are none, and what is more than that
higher than the robot climbs is a wall."""


@njit(cache=True)
def _tread(height, r, c, dr, dc, least):
    """Whether the ground is level where the rise at a cell and the next one, on the side of dr, dc, meet."""
    middle = height[r + dr, c + dc]
    here, beyond = middle - height[r, c], height[r + 2 * dr, c + 2 * dc] - middle
    return min(abs(here), abs(beyond)) < least


@njit(cache=True)
def update_faces(faces, height, trusted, res, r0, c0, r1, c1):
    """Compute `faces` (rows, cols, 2) int16 [mm] again in the window; x and y part of each cell's face."""
    rows, cols = height.shape
    n = max(1, round(0.5 * STEP_BASE / res))
    steep = STEEPEST_SLOPE * 2 * n * res
    rises = np.zeros((2, 3), np.float32)  # per axis: here, over as much before and after
    for r in range(r0, r1):
        for c in range(c0, c1):
            rises[:] = 0.0
            for axis in range(2):
                dr, dc = (0, n) if axis == 0 else (n, 0)
                faces[r, c, axis] = 0
                if not (dr <= r < rows - dr and dc <= c < cols - dc):
                    continue
                if not (trusted[r + dr, c + dc] and trusted[r - dr, c - dc]):
                    continue
                rise = height[r + dr, c + dc] - height[r - dr, c - dc]
                if abs(rise) > 0.01:
                    rises[axis, 0] = rise
                    if 3 * dr <= r and 3 * dc <= c:
                        rises[axis, 1] = height[r - dr, c - dc] - height[r - 3 * dr, c - 3 * dc]
                    if r < rows - 3 * dr and c < cols - 3 * dc:
                        rises[axis, 2] = height[r + 3 * dr, c + 3 * dc] - height[r + dr, c + dc]
            along_x = abs(rises[0, 0]) >= abs(rises[1, 0])
            main = rises[0] if along_x else rises[1]
            for axis in range(2):
                rise, before, after = rises[axis]
                if rise == 0.0:
                    continue
                common = (
                    min(abs(before), abs(after), abs(rise)) if before * rise > 0.0 < after * rise else 0.0
                )
                more = 0.0
                for k in range(1, 3):
                    beside = rises[axis, k]
                    if not beside * rise > 0.0:
                        continue
                    goes_on = abs(main[0]) >= steep and abs(main[k]) >= steep and main[k] * main[0] > 0.0
                    if goes_on:
                        ahead = n if k == 2 else -n
                        dr, dc = (0, ahead) if along_x else (ahead, 0)
                        if _tread(height, r, c, dr, dc, TREAD_RATIO * steep):
                            continue
                        more += abs(beside)
                    elif abs(rise) < steep and EVEN_RATIO * abs(rise) < abs(beside) < abs(rise) / EVEN_RATIO:
                        common = max(common, min(abs(beside), abs(rise)))
                value = min(abs(rise) + more if more > 0.0 else abs(rise) - common, 30.0)
                faces[r, c, axis] = round(1000.0 * value) * (1 if rise > 0.0 else -1)
