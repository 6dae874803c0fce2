"""The edge test of the corrected graph: the whole footprint, swept along the edge, must stay on drivable ground."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.raster import cell_of
from planning.graph.edge_price import edge_price, room_for, wheel_track
from planning.graph.edge_risk import F32, edge_risk
from planning.graph.flags import FACE, HOLE, PLANTS, POSTS, TIP, UNSEEN, VIRTUAL

CORRIDOR_MARGIN = 0.02
"""The footprint is this much larger on each side [m]: a low ledge's corner cell averages out, and nobody tracks
exactly."""
SECTION_LENGTH = 0.04
"""Length of one cross-section of the corridor [m]."""
SLOPE_LENGTH = 0.30
"""Ground is averaged over this length before its slope is taken [m]: one stair tread."""
SLOPE_TOLERANCE = 1.05
"""Factor on the tangent of the slope limit, for map noise."""
SUM_COLUMNS = 9
"""Sums over the cells of a section: how many there are, unseen, known; their height; height and count of those under
the left and the right wheels; the risers there."""
PLANTS_RISK = 0.5
"""Added to the native risk of an edge whose whole corridor is grass: with sigma = 3 a metre counts as 2.5, as it is
driven at 0.2 instead of 0.5 m/s."""


@njit(cache=True)
def row_span(y, xa, ya, ux, uy, lo, hi, half):
    """x interval of the points (x, y) with lo <= along <= hi and |across| <= half of the axis at a, heading u."""
    low = -np.inf
    high = np.inf
    dy = y - ya
    # along = (x - xa) ux + dy uy ; across = -(x - xa) uy + dy ux
    for k in range(2):
        slope = ux if k == 0 else -uy
        rest = dy * uy if k == 0 else dy * ux
        a = (lo if k == 0 else -half) - rest
        b = (hi if k == 0 else half) - rest
        if abs(slope) < 1e-12:
            if a > 0.0 or b < 0.0:
                return 1.0, 0.0
            continue
        p = a / slope
        q = b / slope
        low = max(low, min(p, q))
        high = min(high, max(p, q))
    return xa + low, xa + high


@njit(cache=True)
def _covered(flags, x0, y0, res, xa, ya, ux, uy, end, front, half, r_lo, r_hi):
    """All flags under the corridor that begins `front` behind a and ends `end` ahead of it. Most edges end here, so
    this is a loop that runs in vector registers."""
    cols = flags.shape[1]
    met = np.uint16(0)
    for r in range(r_lo, r_hi + 1):
        low, high = row_span(y0 + r * res, xa, ya, ux, uy, -front, end, half)
        c_lo = max(0, math.ceil((low - x0) / res))
        c_hi = min(cols - 1, math.floor((high - x0) / res))
        row = flags[r]
        for c in range(c_lo, c_hi + 1):
            met |= row[np.uint64(c)]
    return met


# error_model: no test for zero before each division.
@njit(cache=True, error_model="numpy")
def corridor(
    height,
    flags,
    faces,
    x0,
    y0,
    res,
    xa,
    ya,
    xb,
    yb,
    length,
    width,
    max_tan,
    max_gap,
    min_coverage,
    sums,
    stood,
    prices,
):
    """-1 if the footprint (length x width) cannot be moved straight from a to b, else what is added to the native risk
    for the share of its area that is grass.

    Not both sides of a step under it, no tip of a wide pit, no field of too high posts, no line along the travel over a
    hole for more than `max_gap` (a crack is driven across, not along), every cross-section seen to at least
    `min_coverage`, and nowhere steeper than `max_tan` over a wheelbase, pitch and roll together. Ground outside the map
    is not seen. `sums` is scratch, (sections, COLUMNS) float64. `stood`: the robot stands at a along u, so the ground
    under it there is not too steep, whatever the map says. With measured `prices` stairs are no slope: what their
    risers rise by is left out, and `edge_price` tells whether they are a way.
    """
    rows, cols = height.shape
    dx = xb - xa
    dy = yb - ya
    d = math.sqrt(dx * dx + dy * dy)
    ux = dx / d
    uy = dy / d
    front = 0.5 * length + CORRIDOR_MARGIN
    half = 0.5 * width + CORRIDOR_MARGIN
    span = d + 2.0 * front
    n = math.ceil(span / SECTION_LENGTH)
    sums[:n] = 0.0
    reach_y = abs(uy) * front + abs(ux) * half
    r_lo = math.ceil((min(ya, yb) - reach_y - y0) / res)
    r_hi = math.floor((max(ya, yb) + reach_y - y0) / res)
    reach_x = abs(ux) * front + abs(uy) * half
    if (
        r_lo < 0
        or r_hi >= rows
        or min(xa, xb) - reach_x < x0 - res
        or max(xa, xb) + reach_x > x0 + cols * res
    ):
        return -1.0
    met = _covered(flags, x0, y0, res, xa, ya, ux, uy, d + front, front, half, r_lo, r_hi)
    if met & FACE == FACE or met & (TIP | POSTS):
        return -1.0
    strip = half / 3.0
    plants = 0
    for r in range(r_lo, r_hi + 1):
        y = y0 + r * res
        low, high = row_span(y, xa, ya, ux, uy, -front, d + front, half)
        c_lo = max(0, math.ceil((low - x0) / res))
        c_hi = min(cols - 1, math.floor((high - x0) / res))
        for c in range(c_lo, c_hi + 1):
            flag = flags[r, np.uint64(c)]
            plants += flag & PLANTS > 0
            ex = x0 + c * res - xa
            ey = y - ya
            k = int((ex * ux + ey * uy + front) / SECTION_LENGTH)
            i = np.uint64(min(max(k, 0), n - 1))
            sums[i, 0] += 1.0
            if flag & UNSEEN:
                sums[i, 1] += 1.0
                continue
            if flag & VIRTUAL:
                continue  # only faces tell of it: filled from a wall beside it, it looks steep
            z = height[r, np.uint64(c)]
            if z != z:
                continue
            across = ey * ux - ex * uy
            sums[i, 2] += 1.0
            sums[i, 3] += z
            if across > strip:
                sums[i, 4] += z
                sums[i, 5] += 1.0
            elif across < -strip:
                sums[i, 6] += z
                sums[i, 7] += 1.0
    area = 0.0
    for k in range(n):
        area += sums[k, 0]
        if sums[k, 1] > (1.0 - min_coverage) * sums[k, 0]:
            return -1.0
    if met & HOLE and _falls_in(flags, x0, y0, res, xa, ya, ux, uy, -front, d + front, half, max_gap):
        return -1.0
    under = int(2.0 * front / SECTION_LENGTH) if stood else 0
    limit = max_tan * SLOPE_TOLERANCE
    if not _not_steep(sums, n, limit, 2.0 * prices.axle, 4.0 * strip, under):
        if not prices.measured or not _risers(
            height, flags, faces, x0, y0, res, prices, xa, ya, ux, uy, front, span, sums
        ):
            return -1.0
        if not _not_steep(sums, n, limit, 2.0 * prices.axle, 4.0 * strip, under):
            return -1.0
    return PLANTS_RISK * plants / area


@njit(cache=True)
def _falls_in(flags, x0, y0, res, xa, ya, ux, uy, low, high, half, max_gap):
    """True if some line along the travel, within `half` of it, is over a hole for more than `max_gap`."""
    rows, cols = flags.shape
    step = 0.5 * res
    most = math.floor((max_gap + res) / step)
    n = math.ceil((high - low) / step)
    tracks = math.ceil(2.0 * half / res)
    for t in range(tracks + 1):
        across = -half + 2.0 * half * t / tracks
        run = 0
        for s in range(n + 1):
            along = low + s * step
            c = cell_of(xa + along * ux - across * uy, x0, res)
            r = cell_of(ya + along * uy + across * ux, y0, res)
            if 0 <= r < rows and 0 <= c < cols and flags[r, c] & HOLE:
                run += 1
                if run > most:
                    return True
            else:
                run = 0
    return False


@njit(cache=True)
def _risers(height, flags, faces, x0, y0, res, prices, xa, ya, ux, uy, front, span, sums):
    """Note in each section how far [m] the risers of stairs lift the robot, by the tracks of its left and its right
    wheels; whether there are any."""
    crossed, gaps = np.empty((room_for(span), 4)), np.empty((room_for(span), 2))
    some = False
    for aside in (prices.tread, -prices.tread):
        xw, yw = xa - front * ux - aside * uy, ya - front * uy + aside * ux
        found = wheel_track(
            height, flags, faces, x0, y0, res, prices.radius, xw, yw, ux, uy, span, crossed, gaps
        )[0]
        for k in range(found):
            if crossed[k, 3] > 0.0 and 0.0 <= crossed[k, 0] < span:
                sums[int(crossed[k, 0] / SECTION_LENGTH), 8] += 0.5 * crossed[k, 1]
                some = True
    return some


@njit(cache=True)
def _not_steep(sums, n, limit, wheelbase, track, under):
    """Pitch over the `wheelbase` and roll over `track`, the distance of the two wheel strips [m], of the swept profile
    stay under `limit`. What lies within the first `under` sections is not judged."""
    ahead = round(wheelbase / SECTION_LENGTH)
    reach = round(0.5 * SLOPE_LENGTH / SECTION_LENGTH)
    for i in range(max(1, n - ahead)):
        j = i + ahead
        if j < under:
            continue
        back = 0.0
        back_n = 0.0
        fore = 0.0
        fore_n = 0.0
        for k in range(max(0, i - reach), min(n, i + reach + 1)):
            back += sums[k, 3]
            back_n += sums[k, 2]
        for k in range(max(0, j - reach), min(n, j + reach + 1)):
            fore += sums[k, 3]
            fore_n += sums[k, 2]
        pitch = 0.0
        if back_n > 0.0 and fore_n > 0.0 and j < n:
            # where the averages are cut short at the ends, their centres are nearer than the wheelbase
            centre_b = 0.5 * (max(0, i - reach) + min(n - 1, i + reach))
            centre_f = 0.5 * (max(0, j - reach) + min(n - 1, j + reach))
            rise, stairs = fore / fore_n - back / back_n, 0.0
            for k in range(max(0, i - reach), min(n, j + reach + 1)):
                stairs += sums[k, 8]
            if stairs * rise > 0.0:
                rise = max(abs(rise) - abs(stairs), 0.0)
            pitch = rise / ((centre_f - centre_b) * SECTION_LENGTH)
        left = 0.0
        right = 0.0
        left_n = 0.0
        right_n = 0.0
        for k in range(i, min(n, j + 1)):
            left += sums[k, 4]
            left_n += sums[k, 5]
            right += sums[k, 6]
            right_n += sums[k, 7]
        roll = 0.0
        if left_n > 0.0 and right_n > 0.0:
            roll = (left / left_n - right / right_n) / track
        if pitch * pitch + roll * roll > limit * limit:
            return False
    return True


@njit(cache=True)
def move(
    height, flags, faces, xs, ys, x0, y0, res, xa, ya, xb, yb, length, width, max_tan, max_gap, min_coverage, radius,
    prices, sums, stood, price,
):  # fmt: skip
    """Native risk of the straight move from a to b with what `corridor` adds; negative where it cannot be driven. Its
    prices [m] come into `price` (2, 2), see `edge_price`."""
    more = corridor(
        height, flags, faces, x0, y0, res, xa, ya, xb, yb, length, width, max_tan, max_gap, min_coverage, sums, stood,
        prices,
    )  # fmt: skip
    if more < 0.0:
        return F32(-1.0)
    found = edge_risk(height, xs, ys, x0, y0, res, F32(xa), F32(ya), F32(xb), F32(yb), radius, False)
    if found < 0.0 or not edge_price(height, flags, faces, x0, y0, res, prices, xa, ya, xb, yb, price):
        return F32(-1.0)
    return found + F32(more)


@njit(cache=True)
def connect(
    height, flags, faces, xs, ys, x0, y0, res, chosen, where, offsets, reach, moved, boxes, margin, rank,
    length, width, max_tan, max_gap, min_coverage, radius, prices, risk, price,
):  # fmt: skip
    """Test again every edge with a moved end or whose surroundings touch one of `boxes` (k, 4: x0, y0, x1, y1 [m])."""
    ny, nx = chosen.shape
    sums = np.empty((rank, SUM_COLUMNS))
    for j in range(ny):
        for i in range(nx):
            for o in range(len(offsets)):
                jj = j + offsets[o, 0]
                ii = i + offsets[o, 1]
                outside = jj >= ny or ii < 0 or ii >= nx  # the map may have become smaller
                if outside or chosen[j, i] < 0 or chosen[jj, ii] < 0:
                    risk[j, i, o] = -1.0
                    continue
                xa = where[j, i, 0]
                ya = where[j, i, 1]
                xb = where[jj, ii, 0]
                yb = where[jj, ii, 1]
                again = moved[j, i] or moved[jj, ii]
                if not again:
                    lo_x = min(xa, xb) - margin
                    hi_x = max(xa, xb) + margin
                    lo_y = min(ya, yb) - margin
                    hi_y = max(ya, yb) + margin
                    for k in range(len(boxes)):
                        if (
                            lo_x < boxes[k, 2]
                            and hi_x > boxes[k, 0]
                            and lo_y < boxes[k, 3]
                            and hi_y > boxes[k, 1]
                        ):
                            again = True
                            break
                if not again:
                    continue
                risk[j, i, o] = -1.0
                if (xb - xa) ** 2 + (yb - ya) ** 2 > reach * reach:
                    continue
                risk[j, i, o] = move(
                    height, flags, faces, xs, ys, x0, y0, res, xa, ya, xb, yb, length, width, max_tan, max_gap,
                    min_coverage, radius, prices, sums, np.bool_(False), price[j, i, o],  # False: a variant more
                )  # fmt: skip
