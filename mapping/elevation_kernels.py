"""Numba kernels of the elevation map: project a scan onto cells, fuse it into the two modes of each cell.

No `fastmath`: it deletes the NaN tests that mean "unknown".
"""

from __future__ import annotations

import numpy as np
from numba import njit

DROP_NAN, DROP_RANGE, DROP_BODY, DROP_CEILING, USED = 0, 1, 2, 3, 4
"""Counters of `project`."""
CELLS, AGREED, NEW, CONFLICT, REPLACED, OVERHANG = 0, 1, 2, 3, 4, 5
"""Counters of `fuse`."""
TOP, BOTTOM, WEIGHT, DEPTH, POINTS, SHARED = 0, 1, 2, 3, 4, 5
"""Columns of a cell's measurement: highest and lowest point [m]; sums over its surface points: weight, weight times
height under the top, number, shared variance."""


@njit(cache=True)
def project(
    points, rotation, position, origin, limits, body, noise, resolution, i, j, z, var, rays, counts
):  # pragma: no cover
    """Points of one scan to world cells.

    points (n,3) f32 base_link; rotation (3,3) world <- base; position (3,); origin (3,) sensor in base_link.
    limits: min range, max range, ceiling above base at the robot, ceiling growth per metre.
    body (6,): x0, x1, y0, y1, z0, z1 of the self-filter box, base_link.
    noise: range sigma, beam angle sigma, attitude sigma, height sigma.
    Out, compacted: i, j (n,) cells; z (n,) f32 world height; var (n,2) f32: per-point variance of z, and the part all
    points of a place share (attitude, pose), which does not average out; rays (q,3): world ends of all rays, dropped
    for their distance or height included: they still tell what is empty. Returns n and q.
    """
    m = 0
    q = 0
    inv = 1.0 / resolution
    near, far = limits[0] * limits[0], limits[1] * limits[1]
    along, across = noise[0] * noise[0], noise[1] * noise[1]
    tilt, lift = noise[2] * noise[2], noise[3] * noise[3]
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for k in range(points.shape[0]):
        px, py, pz = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
        dx, dy, dz = px - origin[0], py - origin[1], pz - origin[2]
        rr = dx * dx + dy * dy + dz * dz
        if not np.isfinite(rr):
            counts[DROP_NAN] += 1
            continue
        if rr < near:
            counts[DROP_RANGE] += 1
            continue
        if body[0] < px < body[1] and body[2] < py < body[3] and body[4] < pz < body[5]:
            counts[DROP_BODY] += 1
            continue
        x = r00 * px + r01 * py + r02 * pz
        y = r10 * px + r11 * py + r12 * pz
        h = r20 * px + r21 * py + r22 * pz
        wx, wy, wz = x + position[0], y + position[1], h + position[2]
        rays[q, 0], rays[q, 1], rays[q, 2] = wx, wy, wz
        q += 1
        if rr > far:
            counts[DROP_RANGE] += 1
            continue
        dd = x * x + y * y
        if h > limits[2] and h > limits[2] + limits[3] * np.sqrt(dd):
            counts[DROP_CEILING] += 1
            continue
        uz = r20 * dx + r21 * dy + r22 * dz
        uz2 = uz * uz
        var[m, 0] = along * uz2 / rr + across * (rr - uz2)
        var[m, 1] = tilt * dd + lift
        z[m] = wz
        i[m] = np.int64(np.floor(wy * inv + 0.5))
        j[m] = np.int64(np.floor(wx * inv + 0.5))
        m += 1
    counts[USED] = m
    return m, q


@njit(cache=True)
def reduce_cells(cell, z, var, m, mark, band, clearance, which, slot, sums):  # pragma: no cover
    """One measurement per cell and scan: the mean of the points within `band` under the highest.

    A face (wall, box, step) thus keeps its top. Points that hang more than `clearance` above everything else in the
    cell are an overhang and ignored. `mark` is scratch over the pool (sparse set: no clearing needed), `slot` over the
    points. Out: which (k,) pool index; sums (k, 6) f32, see the columns. Returns k and the number of overhangs.
    """
    k = 0
    zero = np.float32(0.0)
    spread = zero
    for p in range(m):
        c = cell[p]
        s = mark[c]
        h = z[p]
        if s < k and which[s] == c:
            slot[p] = s
            if h > sums[s, TOP]:
                sums[s, TOP] = h
                spread = max(spread, h - sums[s, BOTTOM])
            elif h < sums[s, BOTTOM]:
                sums[s, BOTTOM] = h
                spread = max(spread, sums[s, TOP] - h)
        else:
            mark[c] = k
            slot[p] = k
            which[k] = c
            sums[k, TOP] = h
            sums[k, BOTTOM] = h
            sums[k, WEIGHT] = sums[k, DEPTH] = sums[k, POINTS] = sums[k, SHARED] = zero
            k += 1
    overhangs = 0
    if spread > clearance:
        low = np.full(k, -np.inf)
        above = np.full(k, np.inf)
        for p in range(m):
            s = slot[p]
            if sums[s, TOP] - sums[s, BOTTOM] > clearance:
                if z[p] < sums[s, BOTTOM] + clearance:
                    low[s] = max(low[s], z[p])
                else:
                    above[s] = min(above[s], z[p])
        for s in range(k):
            if above[s] < np.inf and above[s] - low[s] > clearance:
                sums[s, TOP] = low[s]
                overhangs += 1
    deepest = np.float32(-band)
    for p in range(m):
        s = slot[p]
        d = z[p] - sums[s, TOP]
        if zero >= d >= deepest:
            w = np.float32(1.0) / var[p, 0]
            sums[s, WEIGHT] += w
            sums[s, DEPTH] += w * d
            sums[s, POINTS] += np.float32(1.0)
            sums[s, SHARED] += var[p, 1]
    return k, overhangs


@njit(cache=True)
def fuse(which, sums, k, cells, now, rule, counts, residuals, touched, area):  # pragma: no cover
    """Fuse one measurement per cell into the map (1-D Kalman with two modes per cell).

    rule: gate [sigmas], smallest gate [m], face [m], clearance [m], scans until a higher and until a lower surface takes
    over, smallest variance, drift variance per ms, largest variance, points of an established cell, memory of a
    contradiction [ms].
    A measurement beyond the gate builds up the cell's second mode, which takes over after enough scans in a row. A lower
    measurement on a face (vertical extent in this scan) contradicts nothing: the wall's top is only out of view.
    residuals: [sum of z - h over agreeing established cells, their number], for the drift estimate. touched: flag per
    tile of 1 << area cells.
    """
    gate, gate_min, face, clearance = rule[0], rule[1], rule[2], rule[3]
    v_min, drift_rate, v_max, settled, memory = rule[6], rule[7], rule[8], rule[9], rule[10]
    for s in range(k):
        cell = cells[which[s]]
        touched[which[s] >> area] = 1
        top, bottom = np.float64(sums[s, TOP]), np.float64(sums[s, BOTTOM])
        weight, points = np.float64(sums[s, WEIGHT]), np.float64(sums[s, POINTS])
        z = top + sums[s, DEPTH] / weight
        pv = 1.0 / weight + sums[s, SHARED] / points
        n = np.int64(points)
        counts[CELLS] += 1
        new = cell.source != 2
        if new and bottom - cell.upper > clearance:
            counts[OVERHANG] += 1  # rays passed far below
            continue
        if not new:
            h = np.float64(cell.height)
            v = np.float64(cell.variance)
            dz = z - h
            limit = max(gate_min, gate * np.sqrt(v + pv))
            # one or two stray points (mixed pixels at edges) give way at once
            new = abs(dz) > limit and cell.count < settled and n >= cell.count
        if new:
            cell.height = z
            cell.variance = max(pv, v_min)
            cell.count = min(n, 255)
            cell.source = 2
            cell.seen = now
            cell.alt = np.nan
            cell.below = np.nan
            cell.streak = 0
            cell.passes = 0
            cell.upper = np.inf
            counts[NEW] += 1
            continue
        if abs(dz) <= limit:
            v = min(v + drift_rate * max(0, now - cell.seen), v_max)
            if cell.count >= settled:
                residuals[0] += dz
                residuals[1] += 1.0
            cell.height = (v * z + pv * h) / (v + pv)
            cell.variance = max(v * pv / (v + pv), v_min)
            cell.count = min(np.int64(cell.count) + n, 255)
            cell.seen = now
            cell.streak = 0
            cell.passes = 0
            counts[AGREED] += 1
            continue
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
        if cell.streak >= (rule[4] if dz > 0.0 else rule[5]):
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
