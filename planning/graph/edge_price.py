"""Price of a straight move: what its four wheels cross and stand on, by the prices of the controller.

A wheel that rises or falls over a face makes a quarter of a crossing: a kerb under all wheels is one crossing, one
under the left wheels is half of one. A crossing belongs to the move in whose part of the wheel's track its middle lies,
so moves that follow each other in a line count it once. Backward a face counts from where the tyre touches it: robots
back up a little to turn, and one that turned with its wheels against a kerb climbed it and fell.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.kernels import inlined
from hal.raster import cell_of
from planning.graph.faces import FACE_NOISE
from planning.graph.flags import FIELD, HOLE, STEP_BASE, UNSEEN, VIRTUAL
from planning.graph.prices import LONGEST_TREAD, SIZE_COUNT, SIZE_STEP, angle_at, size_at, tread_at

HIGHEST_FACE = (SIZE_COUNT - 1) * SIZE_STEP
"""Higher ones [m] are walls, which a move stays off."""
TRACK_BEYOND = 0.50
"""A wheel's track is looked at so far [m] before and after the move: a face at its end is told as a whole, and the
tread beyond it."""
FACE_SPACING = 0.06
"""A wheel meets no more than one face, and no more than one gap, each so many [m]."""
EVEN_TAN = math.tan(math.radians(5.0))
"""Slopes below [m/m] are noise of the map."""
NO_SIGN, SIGN_UP, SIGN_DOWN = 0, 1, 2


@njit(cache=True)
def face_normal(faces, res, r, c):
    """Unit vector of the normal of the face at a cell, uphill: one cell tells it to 45 deg, because both parts of a
    step that lies askew are as high as the step. Those around it that rise the same way tell it to 2 deg."""
    rows, cols, _ = faces.shape
    n = round(STEP_BASE / res)
    fx, fy = float(faces[r, c, 0]), float(faces[r, c, 1])
    x = y = 0.0
    for i in range(max(0, r - n), min(rows, r + n + 1)):
        for j in range(max(0, c - n), min(cols, c + n + 1)):
            ax, ay = float(faces[i, j, 0]), float(faces[i, j, 1])
            if ax * fx + ay * fy > 0.0 and max(abs(ax), abs(ay)) <= 1000.0 * HIGHEST_FACE:
                x += ax
                y += ay
    size = math.hypot(x, y)
    if size == 0.0:
        return 1.0, 0.0
    return x / size, y / size


@njit(cache=True)
def room_for(d):
    """Rows that `wheel_track` needs for a move of `d` [m]."""
    return 2 + int((d + 2.0 * TRACK_BEYOND) / FACE_SPACING)


@njit(cache=True)
def wheel_track(height, flags, faces, x0, y0, res, radius, xw, yw, ux, uy, d, crossed, gaps):
    """What a wheel crosses that goes straight from xw, yw [m] along the unit vector ux, uy for `d` [m].

    Into `crossed` (k, 4): place along the track [m], height of the face [m] (negative: down), angle between way and
    normal [rad], depth of the tread [m] (0: no stairs); into `gaps` (k, 2): place along the track and width [m]. Both
    have `room_for` rows and hold what has its middle in the move, faces also those within a wheel's `radius` [m] of
    it. Returns how many there are of each, the share of the track in a stepfield, and the height of its highest
    post [m].
    """
    rows, cols = height.shape
    step = 0.5 * res
    beyond = int(TRACK_BEYOND / step)
    n = math.ceil(d / step)
    sign, begin, low, high, first = NO_SIGN, 0, 0.0, 0.0, 0.0
    highest_post = 0
    in_field = hole = holes = 0
    found = np.int64(0)
    for k in range(-beyond, n + beyond + 2):
        c = cell_of(xw + k * step * ux, x0, res)
        r = cell_of(yw + k * step * uy, y0, res)
        now, over, z = NO_SIGN, False, 0.0
        if 0 <= r < rows and 0 <= c < cols and k <= n + beyond:
            flag = flags[r, c]
            big = max(abs(faces[r, c, 0]), abs(faces[r, c, 1]))
            over = flag & HOLE > 0
            if 0 <= k < n and flag & FIELD:
                in_field += 1
                if big <= 1000.0 * HIGHEST_FACE:
                    highest_post = max(highest_post, big)
            if big >= 1000.0 * FACE_NOISE and not flag & (FIELD | HOLE | UNSEEN | VIRTUAL):
                rise = faces[r, c, 0] * ux + faces[r, c, 1] * uy
                now = SIGN_UP if rise > 0.0 else (SIGN_DOWN if rise < 0.0 else NO_SIGN)
                z = float(height[r, c])
        if now != sign:
            if sign != NO_SIGN and found < len(crossed):
                middle = (begin + k - 1) // 2
                size = high - first if sign == SIGN_UP else first - low
                size, angle = _face_at(faces, x0, y0, res, xw, yw, ux, uy, step, middle, size)
                if FACE_NOISE <= size <= HIGHEST_FACE:
                    crossed[found, 0] = middle
                    crossed[found, 1] = size if sign == SIGN_UP else -size
                    crossed[found, 2] = angle
                    found += 1
            sign, begin, low, high, first = now, k, z, z, z
        elif now != NO_SIGN:
            low, high = min(low, z), max(high, z)
        if over:
            hole += 1
        elif hole > 0:
            middle = k - 1 - (hole - 1) // 2
            if 0 <= middle < n and holes < len(gaps):
                gaps[holes, 0], gaps[holes, 1] = middle * step, (hole - 1) * step
                holes += 1
            hole = 0
    return _in_move(crossed, found, step, n, radius), holes, in_field / n, 0.001 * highest_post


@njit(cache=True)
def _in_move(crossed, found, step, n, radius):
    """Tell the treads of these crossings, and keep those whose middle (a number of steps) lies in the move, or nearer
    to it than `radius` [m]; how many."""
    for k in range(found):
        tread, beside = 0.0, 0  # a face is told to a cell or two: the mean of the treads on both sides
        for other in (k - 1, k + 1):
            if 0 <= other < found and crossed[other, 1] * crossed[k, 1] > 0.0:
                apart = abs(crossed[other, 0] - crossed[k, 0]) * step
                if apart <= LONGEST_TREAD:
                    tread, beside = tread + apart, beside + 1
        crossed[k, 3] = tread / beside * math.cos(crossed[k, 2]) if beside else 0.0
    kept = 0
    for k in range(found):
        if -radius < crossed[k, 0] * step < n * step + radius:
            for part in range(crossed.shape[1]):  # a row at once compiles for 2 s
                crossed[kept, part] = crossed[k, part]
            crossed[kept, 0] *= step
            kept += 1
    return kept


@inlined
def is_met(at, d, way, near):
    """Whether a wheel meets a face at `at` [m] on its track of `d` [m], which it goes there (0) or back (1). It does
    `near` [m] before: backward by its radius, forward by nothing."""
    return 0.0 <= at < d + near if way == 0 else -near <= at < d


@njit(cache=True)
def crossed_by(height, flags, faces, x0, y0, res, prices, wheel, xa, ya, ux, uy, d, crossed, gaps):
    """Where a wheel is when the body is at xa, ya [m], and what it crosses in a move along ux, uy: see
    `wheel_track`."""
    ahead = prices.axle if wheel < 2 else -prices.axle
    aside = prices.tread if wheel % 2 == 0 else -prices.tread
    xw, yw = xa + ahead * ux - aside * uy, ya + ahead * uy + aside * ux
    found, holes, field, post = wheel_track(
        height, flags, faces, x0, y0, res, prices.radius, xw, yw, ux, uy, d, crossed, gaps
    )
    return xw, yw, found, holes, field, post


@njit(cache=True)
def edge_price(height, flags, faces, x0, y0, res, prices, xa, ya, xb, yb, out):
    """Write the prices [m] of the straight move from a to b into `out` (2, 2): there and back, driven forward and
    backward. False where it crosses stairs that are no way. `faces` [mm] as of `planning.graph.faces`; coordinates in
    m, `map`."""
    d = math.hypot(xb - xa, yb - ya)
    ux, uy = (xb - xa) / d, (yb - ya) / d
    crossed, gaps = np.empty((room_for(d), 4)), np.empty((room_for(d), 2))
    out[:] = 0.0
    share = posts = 0.0
    for wheel in range(4):
        _, _, found, holes, field, post = crossed_by(
            height, flags, faces, x0, y0, res, prices, wheel, xa, ya, ux, uy, d, crossed, gaps
        )
        for k in range(found):
            size, angle, tread = crossed[k, 1], crossed[k, 2], crossed[k, 3]
            i, j = size_at(size), angle_at(angle)
            for way in range(2):  # there and back
                down = (size < 0.0) != (way == 1)
                up_or_down = 1 if down else 0
                if is_met(crossed[k, 0], d, way, 0.0):
                    if tread > 0.0:
                        out[way, 0] += prices.stairs[up_or_down, i, tread_at(tread), j]
                    else:
                        out[way, 0] += prices.face[up_or_down, 0, i, j]
                if is_met(crossed[k, 0], d, way, prices.radius):
                    out[way, 1] += prices.face[up_or_down, 1, i, j]
        for k in range(holes):
            out += prices.gap[size_at(gaps[k, 1])]
        share += 0.25 * field
        posts = max(posts, post)
    out += prices.posts[size_at(posts)] * d * share
    slopes(height, flags, faces, x0, y0, res, prices, xa, ya, ux, uy, d, out)
    return out[0, 0] < np.inf


@njit(cache=True)
def _face_at(faces, x0, y0, res, xw, yw, ux, uy, step, middle, size):
    """Height [m] of the face that a wheel crosses there, where the ground under its track rises or falls by `size` [m],
    and the angle [rad] between its way and the face's normal. A height of 0: the place is off the map."""
    rows, cols, _ = faces.shape
    c = cell_of(xw + middle * step * ux, x0, res)
    r = cell_of(yw + middle * step * uy, y0, res)
    if not (0 <= r < rows and 0 <= c < cols):
        return 0.0, 0.0
    size = min(size, 0.001 * max(abs(faces[r, c, 0]), abs(faces[r, c, 1])))
    nx, ny = face_normal(faces, res, r, c)
    return size, math.acos(min(abs(nx * ux + ny * uy), 1.0))


@njit(cache=True)
def slopes(height, flags, faces, x0, y0, res, prices, xa, ya, ux, uy, d, out):
    """Add the price of the slopes under the wheels, where no wheel stands on a face. Returns how far along [m] the
    steepest is, how steep [m/m], and the angle between travel and uphill there [rad]."""
    rows, cols = height.shape
    n = math.ceil(d / (2.0 * res))
    z = np.empty(4)
    steepest, where, ahead_is = 0.0, 0.0, 0.0
    for k in range(n):
        along = (k + 0.5) * d / n
        known = True
        for wheel in range(4):
            ahead = along + (prices.axle if wheel < 2 else -prices.axle)
            aside = prices.tread if wheel % 2 == 0 else -prices.tread
            c = cell_of(xa + ahead * ux - aside * uy, x0, res)
            r = cell_of(ya + ahead * uy + aside * ux, y0, res)
            if not (0 <= r < rows and 0 <= c < cols) or flags[r, c] & (FIELD | HOLE | UNSEEN | VIRTUAL):
                known = False
                break
            if max(abs(faces[r, c, 0]), abs(faces[r, c, 1])) >= 1000.0 * FACE_NOISE:
                known = False
                break
            z[wheel] = height[r, c]
        if not known:
            continue
        pitch = (z[0] + z[1] - z[2] - z[3]) / (4.0 * prices.axle)
        roll = (z[0] + z[2] - z[1] - z[3]) / (4.0 * prices.tread)
        steep = math.hypot(pitch, roll)
        if not steep > EVEN_TAN:  # NaN: not known
            continue
        i, direction = angle_at(math.atan(steep)), math.atan2(abs(roll), pitch)
        there, back = prices.slope[i, angle_at(direction)], prices.slope[i, angle_at(math.pi - direction)]
        for way in range(2):
            out[0, way] += there * d / n
            out[1, way] += back * d / n
        if steep > steepest:
            steepest, where, ahead_is = steep, along, direction
    return where, steepest, ahead_is
