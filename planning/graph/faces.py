"""Faces: how high and which way the ground rises within a hand's breadth, per cell. They are better crossed head-on.

A face is a vector: the rise over `BASE` along x and along y, less the slope that the ground has on both sides, or that goes on evenly
to one side: a ridge is no face. What is so steep that wheels slide down sideways is one, and as high as it goes on: along it, one side of the robot on the
foot of a ramp of 45 deg, robots slid 0.2 m aside. Its direction
is the face's normal, uphill; its height is the larger of the two parts, because a step at 45 deg rises by its whole height in
both. Where a rise cannot be told (unknown or untrusted ground) there is no face: `planning.graph.flags` judges that.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

BASE = 0.12
"""Distance over which the rise is taken [m], as for the flags."""
EVEN = 0.7
"""A slope goes on where the next rise is this share of the one here or more, the other way round too."""
STEEPEST = 0.7
"""From here [m/m] on it is no slope: stairs rise evenly as well, and tyres with a friction of 0.7 slide."""
FACE_NOISE = 0.03
"""[m] by which a face on the map may be higher than the true one: what is more than that higher than the robot climbs is a wall."""
LEAST = 0.4
"""Faces below this share of the step limit are crossed at any angle alike."""
OBLIQUE_RISK = 1.0
"""Added to the native risk of an edge that meets a face over the whole width of the body `ASKEW` more obliquely than allowed. About three edges meet
one face, 0.4 m long each: with sigma = 3 about 4 m, as for turning by a radian on such a face (`planning.risk.turns`)."""
ASKEW = math.radians(35.0)
"""The hybrid controller drove straight up a face of 20 cm at 0 to 45 deg 48 times of 48, at 48 and 51 deg 29 of 32 and at 55 deg 2 of 12 (3 falls); 16 cm at 60 deg 8 of
12, 12 cm at 60 deg 12 of 12 (physics alone, start and friction varied)."""
CLIMBED, LOWER = math.radians(30.0), math.radians(30.0)
ALONG = math.radians(80.0)
"""A move more askew than this leads along a face, not up it."""
TIPS = 8.0
"""Added where a wheel climbs a face more obliquely than `CLIMBED` beyond what is allowed (5 deg less than what was climbed: so much robots turn while they climb): most of such drives end there, a quarter in a fall, and a fall weighs as much as 100 m of
driving. Straight down a face at any angle none fell."""


@njit(cache=True)
def update_faces(faces, height, trusted, res, r0, c0, r1, c1):
    """Compute `faces` (rows, cols, 2) int16 [mm] again in the window; x and y part of each cell's face."""
    rows, cols = height.shape
    n = max(1, round(0.5 * BASE / res))
    steep = STEEPEST * 2 * n * res
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
                    if 3 * dr <= r < rows - 3 * dr and 3 * dc <= c < cols - 3 * dc:
                        rises[axis, 1] = height[r - dr, c - dc] - height[r - 3 * dr, c - 3 * dc]
                        rises[axis, 2] = height[r + 3 * dr, c + 3 * dc] - height[r + dr, c + dc]
            main = rises[0] if abs(rises[0, 0]) >= abs(rises[1, 0]) else rises[1]
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
                    if abs(main[0]) >= steep and abs(main[k]) >= steep and main[k] * main[0] > 0.0:
                        more += abs(beside)
                    elif abs(rise) < steep and EVEN * abs(rise) < abs(beside) < abs(rise) / EVEN:
                        common = max(common, min(abs(beside), abs(rise)))
                value = min(abs(rise) + more if more > 0.0 else abs(rise) - common, 30.0)
                faces[r, c, axis] = round(1000.0 * value) * (1 if rise > 0.0 else -1)


@njit(cache=True)
def max_angle(height, max_step, max_oblique):
    """Largest angle [rad] between travel and normal at which crossing a face of `height` [m] costs nothing more.

    `max_oblique` [rad] at `max_step` [m] and above, a right angle at `LEAST` of it and below, between them in proportion.
    """
    share = (height - LEAST * max_step) / ((1.0 - LEAST) * max_step)
    return 0.5 * math.pi + min(max(share, 0.0), 1.0) * (max_oblique - 0.5 * math.pi)


@njit(cache=True)
def askew(face_x, face_y, ux, uy, max_step, max_oblique):
    """How much a face [mm] that is met by a move along the unit vector ux, uy counts: 0 within `max_angle` of its normal, 1 `ASKEW` beyond it, growing with
    the square up to there."""
    height = 0.001 * max(abs(face_x), abs(face_y))
    if height <= LEAST * max_step:
        return 0.0
    size = math.hypot(float(face_x), float(face_y))
    angle = math.acos(min(abs(face_x * ux + face_y * uy) / size, 1.0))
    beyond = max(angle - max_angle(height, max_step, max_oblique), 0.0) / ASKEW
    return min(beyond * beyond, 1.0)


@njit(cache=True)
def tipping(faces, r, c, res, ux, uy, max_step, max_oblique):
    """1 where a move along the unit vector ux, uy climbs the face at a cell more than `CLIMBED` more obliquely than allowed, or a lower one than the robot climbs by up to `LOWER` more,
    -1 where a move the other way does, 0 else.

    The face is that of all cells within `BASE` that are no wall: a cell alone tells the normal to 45 deg, because both parts of a step that lies askew are as
    high as the step; together they tell it to 2 deg.
    """
    rows, cols, _ = faces.shape
    n = round(BASE / res)
    x = y = highest = 0.0
    for i in range(max(0, r - n), min(rows, r + n + 1)):
        for j in range(max(0, c - n), min(cols, c + n + 1)):
            height = 0.001 * max(abs(faces[i, j, 0]), abs(faces[i, j, 1]))
            if LEAST * max_step < height <= max_step + FACE_NOISE:
                x += faces[i, j, 0]
                y += faces[i, j, 1]
                highest = max(highest, height)
    size = math.hypot(x, y)
    if size == 0.0:
        return 0
    up = (x * ux + y * uy) / size
    angle = math.acos(min(abs(up), 1.0))
    least = max_oblique + CLIMBED + LOWER * (1.0 - min(highest / max_step, 1.0))
    if not least < angle < ALONG:
        return 0
    return 1 if up > 0.0 else -1
