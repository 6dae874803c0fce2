"""Numba kernels of the elevation map: project a scan onto cells, fuse it into the two modes of each cell.

No `fastmath`: it deletes the NaN tests that mean "unknown".
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.elevation.exchange import FuseReport
from mapping.elevation.tiles import PLANTS

DROP_NAN, DROP_RANGE, DROP_BODY, DROP_CEILING, USED, RAYS, NEXT = 0, 1, 2, 3, 4, 5, 6
"""Counters of `project`."""
CELLS, AGREED, NEW, CONFLICT, REPLACED, OVERHANG = 0, 1, 2, 3, 4, 5
"""Counters of `fuse`."""
LOW_RISE = 0.1
"""[m] above known ground single points beside the end of a wall are mixed pixels as often as not. What is higher is an
obstacle, or leaves, and in the map at once."""
OVER_LEAVES = 0.1
"""[m] above the leaves: what a scan sees there is something else that came to stand among them."""
TOP, BOTTOM, WEIGHT, DEPTH, POINTS, SHARED, FIRST = 0, 1, 2, 3, 4, 5, 6
"""Columns of a cell's measurement: highest and lowest point [m]; sums over its surface points: weight, weight times
height under the top, number, shared variance; scratch."""


def report_of(
    points: int, drops: NDArray[np.int64], cells: NDArray[np.int64], z_correction: float
) -> FuseReport:
    """The counters of `project` and `fuse` by name."""
    invalid, out_of_range, body, ceiling, used = drops.tolist()[: USED + 1]
    seen, agreed, new, conflict, replaced, overhang = cells.tolist()
    return FuseReport(
        points, used, invalid, out_of_range, body, ceiling,
        seen, agreed, new, conflict, replaced, overhang, z_correction,
    )  # fmt: skip


_FARTHEST_SQUARE = 1e12
"""Square of the distance [m^2] beyond which a point does not count, such as one that is not finite: its ray has no
end in single precision."""


@njit(cache=True)
def project(
    points, rotation, position, origin, limits, body, noise, resolution, directory, first, shift,
    cell, z, weight, shared, ray, rays, counts, absent,
):  # fmt: skip  # pragma: no cover
    """Project the points of one scan onto cells of the pool.

    Goes on at point counts[NEXT]. Returns False if it met a tile that does not exist, with its row and column in
    `absent` (2,): allocate it and call again.

    points (n, 3) f32 base_link; rotation (3, 3) world <- base; position (3,); origin (3,) sensor in base_link.

    limits: min range, max range, ceiling above base at the robot, ceiling growth per metre; x0, x1, y0, y1 in
    base_link of what counts.

    body (6,): x0, x1, y0, y1, z0, z1 of the self-filter box, base_link.

    noise: range sigma, beam angle sigma, attitude sigma, height sigma. directory, first, shift: of the tile store.

    Out, compacted (counts[USED]): cell u32 index into the pool; z f32 world height; weight f32, inverse of the
    variance of z that is each point's own; shared f32, the variance that all points of a place share (attitude,
    pose), which does not average out; ray its row in `rays`.

    rays (q, 3) f32, counts[RAYS]: world ends of all rays, also of those dropped for distance or height: they still
    tell what is empty."""
    # Unsigned indices spare the test for negative ones, here and below.
    one = np.uint64(1)
    m, q = np.uint64(counts[USED]), np.uint64(counts[RAYS])
    inv = 1.0 / resolution
    size = np.int64(1) << shift
    mask = size - 1
    tile_rows, tile_cols = directory.shape
    first_row, first_col = first[0], first[1]
    near, far = limits[0] * limits[0], limits[1] * limits[1]
    along, across = noise[0] * noise[0], noise[1] * noise[1]
    tilt, lift = noise[2] * noise[2], noise[3] * noise[3]
    # Copies: a compiler that cannot know that the outputs lie elsewhere reads these anew for each point.
    ox, oy, oz = origin[0], origin[1], origin[2]
    tx, ty, tz = position[0], position[1], position[2]
    bx0, bx1, by0, by1, bz0, bz1 = body[0], body[1], body[2], body[3], body[4], body[5]
    ceiling, rise = limits[2], limits[3]
    x0, x1, y0, y1 = limits[4], limits[5], limits[6], limits[7]
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for k in range(np.uint64(counts[NEXT]), np.uint64(points.shape[0])):
        px, py, pz = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
        dx, dy, dz = px - ox, py - oy, pz - oz
        rr = dx * dx + dy * dy + dz * dz
        if not rr < _FARTHEST_SQUARE:
            counts[DROP_NAN] += 1
            continue
        if rr < near:
            counts[DROP_RANGE] += 1
            continue
        if bx0 < px < bx1 and by0 < py < by1 and bz0 < pz < bz1:
            counts[DROP_BODY] += 1
            continue
        x = r00 * px + r01 * py + r02 * pz
        y = r10 * px + r11 * py + r12 * pz
        h = r20 * px + r21 * py + r22 * pz
        wx, wy, wz = x + tx, y + ty, h + tz
        rays[q, 0], rays[q, 1], rays[q, 2] = wx, wy, wz
        outside = not (x0 < px < x1 and y0 < py < y1)
        if rr > far or outside:
            q += one
            counts[DROP_RANGE] += 1
            continue
        dd = x * x + y * y
        if h > ceiling and h > ceiling + rise * np.sqrt(dd):
            q += one
            counts[DROP_CEILING] += 1
            continue
        i, j = np.int64(np.floor(wy * inv + 0.5)), np.int64(np.floor(wx * inv + 0.5))
        r, c = (i >> shift) - first_row, (j >> shift) - first_col
        slot = np.int64(-1)
        if 0 <= r < tile_rows and 0 <= c < tile_cols:
            slot = np.int64(directory[np.uint64(r), np.uint64(c)])
        if slot < 0:
            absent[0], absent[1] = i >> shift, j >> shift
            counts[USED], counts[RAYS], counts[NEXT] = m, q, k
            return False
        ray[m] = q
        q += one
        uz = r20 * dx + r21 * dy + r22 * dz
        uz2 = uz * uz
        weight[m] = rr / (along * uz2 + across * (rr - uz2) * rr)
        shared[m] = tilt * dd + lift
        z[m] = wz
        cell[m] = (slot << (2 * shift)) + ((i & mask) << shift) + (j & mask)
        m += one
    counts[USED], counts[RAYS], counts[NEXT] = m, q, points.shape[0]
    return True


@njit(cache=True)
def reduce_cells(cell, z, weight, shared, m, mark, band, clearance, which, slot, sums):  # pragma: no cover
    """One measurement per cell and scan: the mean of the points within `band` under the highest.

    A face (wall, box, step) thus keeps its top. Points that hang more than `clearance` above everything else in the
    cell are an overhang and ignored. `mark` is scratch over the pool (sparse set: no clearing needed), `slot` over the
    points. Out: which (k,) pool index; sums (k, 8) f32, see the columns. Returns k and the number of overhangs.
    """
    # Conditional expressions compile to selects, `max` to branches, and which of two noisy heights is the higher no
    # processor can predict: `max` takes three times as long.
    k = np.uint32(0)
    zero, one = np.float32(0.0), np.float32(1.0)
    for p in range(np.uint64(m)):
        c = np.uint64(cell[p])
        s = np.uint32(mark[c])
        h = z[p]
        w = weight[p]
        if not (s < k and np.uint64(which[s]) == c):
            s = k
            mark[c], which[s], slot[p] = s, c, s
            sums[s, TOP] = sums[s, BOTTOM] = sums[s, FIRST] = h
            sums[s, WEIGHT], sums[s, DEPTH], sums[s, POINTS], sums[s, SHARED] = w, zero, one, shared[p]
            k += np.uint32(1)
            continue
        slot[p] = s
        top, bottom = sums[s, TOP], sums[s, BOTTOM]
        sums[s, TOP] = top if top > h else h
        sums[s, BOTTOM] = bottom if bottom < h else h
        sums[s, WEIGHT] += w
        sums[s, DEPTH] += w * (h - sums[s, FIRST])
        sums[s, POINTS] += one
        sums[s, SHARED] += shared[p]
    tall = np.zeros(k, dtype=np.uint8)  # cells that hold more than their surface
    highest = zero
    for t in range(k):
        extent = sums[t, TOP] - sums[t, BOTTOM]
        highest = extent if extent > highest else highest
        tall[t] = extent > np.float32(band)
        sums[t, DEPTH] += sums[t, WEIGHT] * (sums[t, FIRST] - sums[t, TOP])
    if highest <= np.float32(band):
        return k, 0
    # Which points lie where no processor can predict: they are listed without a branch.
    again = np.empty(m, dtype=np.uint32)  # their points
    n = np.uint32(0)
    for p in range(np.uint64(m)):
        again[n] = p
        n += tall[slot[p]]
    overhangs = 0
    if highest > clearance:
        no = np.float32(np.inf)
        # from the highest of the low points to the lowest of the others
        gap = np.empty((k, 2), dtype=np.float32)
        for t in range(k):
            gap[t, 0], gap[t, 1] = -no, no
        for q in range(n):
            p = again[q]
            s = slot[p]
            h = z[p]
            low = h < sums[s, BOTTOM] + np.float32(clearance)
            under, over = h if low else -no, no if low else h
            gap[s, 0] = under if under > gap[s, 0] else gap[s, 0]
            gap[s, 1] = over if over < gap[s, 1] else gap[s, 1]
        for t in range(k):
            if gap[t, 1] < np.inf and gap[t, 1] - gap[t, 0] > clearance:
                sums[t, TOP] = gap[t, 0]
                overhangs += 1
    for t in range(k):
        if tall[t]:
            sums[t, WEIGHT] = sums[t, DEPTH] = sums[t, POINTS] = sums[t, SHARED] = zero
    surface = np.uint32(0)
    for q in range(n):
        p = again[q]
        d = z[p] - sums[slot[p], TOP]
        again[surface] = p
        surface += np.uint32((d <= zero) & (d >= np.float32(-band)))
    for q in range(surface):
        p = again[q]
        s = slot[p]
        w = weight[p]
        sums[s, WEIGHT] += w
        sums[s, DEPTH] += w * (z[p] - sums[s, TOP])
        sums[s, POINTS] += one
        sums[s, SHARED] += shared[p]
    return k, overhangs


@njit(cache=True)
def fuse(which, sums, k, cells, now, rule, counts, residuals, touched, area):  # pragma: no cover
    """Fuse one measurement per cell into the map (1-D Kalman with two modes per cell).

    rule: gate [sigmas], smallest gate [m], face [m], clearance [m], scans until a higher and until a lower surface
    takes over, smallest variance, drift variance per ms, largest variance, points of an established cell, memory of a
    contradiction [ms], points of a cell that is known for sure.

    A measurement beyond the gate builds up the cell's second mode. That takes over after enough scans in a row, with
    as many points as an established cell has; by no more than LOW_RISE over a height that is known for sure, with as
    many as that has. Few points do not move an established cell up by more than the smallest gate either, however
    uncertain it is. A lower measurement on a face (vertical extent in this scan) contradicts nothing: the wall's top is
    only out of view.

    residuals: [sum of z - h over agreeing established cells, their number], for the drift estimate. touched: flag per
    tile of 1 << area cells."""
    gate, gate_min, face, clearance = rule[0], rule[1], rule[2], rule[3]
    v_min, drift_rate, v_max, settled, memory = rule[6], rule[7], rule[8], rule[9], rule[10]
    gate_min2, gate2 = gate_min * gate_min, gate * gate
    fresh, agreed, apart = 0, 0, 0.0
    agreeing = 0
    for s in range(np.uint64(k)):
        index = np.uint64(which[s])
        cell = cells[index]
        touched[index >> np.uint64(area)] = 1
        top, bottom = np.float64(sums[s, TOP]), np.float64(sums[s, BOTTOM])
        points = np.float64(sums[s, POINTS])
        own = 1.0 / np.float64(sums[s, WEIGHT])
        z = top + sums[s, DEPTH] * own
        pv = own + sums[s, SHARED] / points
        n = np.int64(points)
        if cell.source == PLANTS:
            # Leaves; what is taller, in more than a stray point, is none.
            if not top > cell.upper + OVER_LEAVES or points < settled:
                cell.seen = now
                continue
            cell.upper = np.inf
        new = cell.source != 2
        if new and bottom - cell.upper > clearance:
            counts[OVERHANG] += 1  # rays passed far below
            continue
        if not new:
            h = np.float64(cell.height)
            v = np.float64(cell.variance)
            dz = z - h
            limit2 = gate2 * (v + pv)
            limit2 = limit2 if limit2 > gate_min2 else gate_min2
            far = dz * dz > limit2 or (dz > gate_min and points < settled and cell.count >= settled)
            # one or two stray points (mixed pixels at edges) give way at once
            new = far and cell.count < settled and n >= cell.count
        if new:
            cell.height = z
            cell.variance = pv if pv > v_min else v_min
            cell.count = min(n, 255)
            cell.source = 2
            cell.seen = now
            cell.alt = np.nan
            cell.below = np.nan
            cell.streak = 0
            cell.passes = 0
            cell.upper = np.inf
            fresh += 1
            continue
        if not far:
            age = now - cell.seen
            v += drift_rate * age if age > 0 else 0.0
            v = v if v < v_max else v_max
            settled_cell = cell.count >= settled
            apart += dz if settled_cell else 0.0
            agreeing += settled_cell
            gain = v / (v + pv)
            v = gain * pv
            cell.height = h + gain * dz
            cell.variance = v if v > v_min else v_min
            n += cell.count
            cell.count = n if n < 255 else 255
            cell.seen = now
            cell.streak = 0
            cell.passes = 0
            agreed += 1
            continue
        limit = np.sqrt(limit2)
        if dz < 0.0 and top - bottom > face:
            cell.seen = now
            cell.passes = 0
            continue
        if dz > 0.0 and bottom - h > clearance:
            counts[OVERHANG] += 1
            continue
        counts[CONFLICT] += 1
        if cell.streak > 0 and abs(z - cell.alt) <= limit and now - cell.alt_seen <= memory:
            cell.streak = min(np.int64(cell.streak) + 1, 255)
            cell.alt += np.float32((z - cell.alt) / cell.streak)
        else:
            cell.alt = z
            cell.streak = 1
        cell.alt_seen = now
        # fewer points would leave a cell that is not read out, and that the next stray point begins anew
        wanted = rule[11] if 0.0 < dz <= LOW_RISE and cell.count >= rule[11] else settled
        if cell.streak >= (rule[4] if dz > 0.0 else rule[5]) and n * np.int64(cell.streak) >= wanted:
            if dz > 0.0:
                if not cell.below < h:
                    cell.below = cell.height
            elif not cell.below < cell.alt - limit:
                cell.below = np.nan
            cell.height = cell.alt
            cell.variance = max(pv, v_min)
            cell.count = min(n * np.int64(cell.streak), 255)
            cell.seen = now
            cell.streak = 0
            cell.passes = 0
            cell.alt = np.nan
            counts[REPLACED] += 1
    counts[CELLS] += k
    counts[NEW] += fresh
    counts[AGREED] += agreed
    residuals[0] += apart
    residuals[1] += agreeing
