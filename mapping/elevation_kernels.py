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


@njit(cache=True)
def project(
    points, rotation, position, origin, limits, body, noise, resolution, i, j, xyz, var, rays, counts
):  # pragma: no cover
    """Points of one scan to world cells.

    points (n,3) f32 base_link; rotation (3,3) world <- base; position (3,); origin (3,) sensor in base_link.
    limits: min range, max range, ceiling above base at the robot, ceiling growth per metre.
    body (6,): x0, x1, y0, y1, z0, z1 of the self-filter box, base_link.
    noise: range sigma, beam angle sigma, attitude sigma, height sigma.
    Out, compacted: i, j (n,) cells; xyz (n,3) world; var (n,2): per-point variance of z, and the part all points of a
    place share (attitude, pose), which does not average out; rays (q,3): world ends of all rays, dropped for their
    distance or height included: they still tell what is empty. Returns n and q.
    """
    m = 0
    q = 0
    for k in range(points.shape[0]):
        px, py, pz = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
        if not (np.isfinite(px) and np.isfinite(py) and np.isfinite(pz)):
            counts[DROP_NAN] += 1
            continue
        dx, dy, dz = px - origin[0], py - origin[1], pz - origin[2]
        rr = dx * dx + dy * dy + dz * dz
        if rr < limits[0] * limits[0]:
            counts[DROP_RANGE] += 1
            continue
        if body[0] < px < body[1] and body[2] < py < body[3] and body[4] < pz < body[5]:
            counts[DROP_BODY] += 1
            continue
        x = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz
        y = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz
        z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz
        rays[q, 0], rays[q, 1], rays[q, 2] = x + position[0], y + position[1], z + position[2]
        q += 1
        if rr > limits[1] * limits[1]:
            counts[DROP_RANGE] += 1
            continue
        dd = x * x + y * y
        if z > limits[2] + limits[3] * np.sqrt(dd):
            counts[DROP_CEILING] += 1
            continue
        uz = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
        uz2 = uz * uz / rr
        var[m, 0] = noise[0] * noise[0] * uz2 + noise[1] * noise[1] * rr * (1.0 - uz2)
        var[m, 1] = noise[2] * noise[2] * dd + noise[3] * noise[3]
        xyz[m] = rays[q - 1]
        i[m] = np.int64(np.floor(xyz[m, 1] / resolution + 0.5))
        j[m] = np.int64(np.floor(xyz[m, 0] / resolution + 0.5))
        m += 1
    counts[USED] = m
    return m, q


@njit(cache=True)
def reduce_cells(cell, z, var, m, mark, band, clearance, which, top, bottom, sums):  # pragma: no cover
    """One measurement per cell and scan: the mean of the points within `band` under the highest.

    A face (wall, box, step) thus keeps its top. Points that hang more than `clearance` above everything else in the
    cell are an overhang and ignored. `mark` is scratch over the pool (sparse set: no clearing needed).
    Out: which (k,) pool index; top, bottom (k,) [m]; sums (k,5): weight, weight*z, points, shared variance, next above.
    Returns k and the number of overhangs.
    """
    k = 0
    for p in range(m):
        c = cell[p]
        s = mark[c]
        if s >= k or s < 0 or which[s] != c:
            mark[c] = k
            which[k] = c
            top[k] = bottom[k] = z[p]
            sums[k, :] = 0.0
            sums[k, 4] = np.inf
            k += 1
        else:
            top[s] = max(top[s], z[p])
            bottom[s] = min(bottom[s], z[p])
    overhangs = 0
    tall = False
    for s in range(k):
        tall = tall or top[s] - bottom[s] > clearance
    if tall:
        low = np.full(k, -np.inf)
        for p in range(m):
            s = mark[cell[p]]
            if top[s] - bottom[s] > clearance:
                if z[p] < bottom[s] + clearance:
                    low[s] = max(low[s], z[p])
                else:
                    sums[s, 4] = min(sums[s, 4], z[p])
        for s in range(k):
            if sums[s, 4] < np.inf and sums[s, 4] - low[s] > clearance:
                top[s] = low[s]
                overhangs += 1
    for p in range(m):
        s = mark[cell[p]]
        if z[p] <= top[s] and z[p] >= top[s] - band:
            w = 1.0 / var[p, 0]
            sums[s, 0] += w
            sums[s, 1] += w * z[p]
            sums[s, 2] += 1.0
            sums[s, 3] += var[p, 1]
    return k, overhangs


@njit(cache=True)
def fuse(
    which, top, bottom, sums, k, height, variance, count, seen, source, alt, streak, below, upper, passes,
    now, gate, gate_min, face, clearance, up_after, down_after, v_min, drift_rate, v_new_max, counts, residuals,
):  # fmt: skip  # pragma: no cover
    """Fuse one measurement per cell into the map (1-D Kalman with two modes per cell).

    A measurement that disagrees (beyond `gate` sigmas and `gate_min` metres) builds up the cell's second mode; after
    `up_after` (higher) or `down_after` (lower) scans without agreement the second mode takes over. A lower measurement
    on a face (more than `face` of vertical extent in this scan) contradicts nothing: the wall's top is only out of view.
    residuals: [sum of z - h over agreeing cells, their number], for the drift estimate.
    """
    for s in range(k):
        c = which[s]
        z = sums[s, 1] / sums[s, 0]
        shared = sums[s, 3] / sums[s, 2]
        pv = 1.0 / sums[s, 0] + shared
        n = np.int64(sums[s, 2])
        counts[CELLS] += 1
        if source[c] != 2:
            height[c] = z
            variance[c] = max(pv, v_min)
            count[c] = min(n, 65535)
            source[c] = 2
            seen[c] = now
            alt[c] = np.nan
            below[c] = np.nan
            streak[c] = 0
            passes[c] = 0
            upper[c] = np.inf
            counts[NEW] += 1
            continue
        h = np.float64(height[c])
        v = np.float64(variance[c])
        dz = z - h
        limit = max(gate_min, gate * np.sqrt(v + pv))
        if abs(dz) <= limit:
            v = min(v + drift_rate * max(0, now - seen[c]), v_new_max)
            height[c] = (v * z + pv * h) / (v + pv)
            variance[c] = max(v * pv / (v + pv), v_min)
            count[c] = min(np.int64(count[c]) + n, 65535)
            seen[c] = now
            streak[c] = 0
            passes[c] = 0
            counts[AGREED] += 1
            residuals[0] += dz
            residuals[1] += 1.0
            continue
        if dz < 0.0 and top[s] - bottom[s] > face:
            seen[c] = now
            passes[c] = 0
            continue
        if dz > 0.0 and np.float64(bottom[s]) - h > clearance:
            counts[OVERHANG] += 1
            continue
        counts[CONFLICT] += 1
        if streak[c] > 0 and abs(z - alt[c]) <= limit:
            alt[c] += np.float32((z - alt[c]) / (streak[c] + 1.0))
            streak[c] += 1
        else:
            alt[c] = z
            streak[c] = 1
        if streak[c] >= (up_after if dz > 0.0 else down_after):
            if dz > 0.0:
                if not below[c] < h:
                    below[c] = height[c]
            elif not below[c] < alt[c] - limit:
                below[c] = np.nan
            height[c] = alt[c]
            variance[c] = max(pv, v_min)
            count[c] = min(n * np.int64(streak[c]), 65535)
            seen[c] = now
            streak[c] = 0
            passes[c] = 0
            alt[c] = np.nan
            counts[REPLACED] += 1
