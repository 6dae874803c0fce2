"""Kernels shared with the graph of the released planner (`tools/baselines/native.py`): direction-aware terrain risk,
symmetric 3x3 eigenvectors.

Grids are float32 heights [m] with NaN where there is no map point; x0, y0 are the coordinates of the centre of
cell [0, 0] and res is the cell size [m].
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.raster import cell_of

F32 = np.float32


@njit(cache=True)
def top_two_z(a, b, c, d, e, f):
    """|z| of the unit eigenvectors of [[a, b, c], [b, d, e], [c, e, f]] with the largest and second eigenvalue.

    Cyclic Jacobi: stays accurate where two eigenvalues meet, which is the usual case on flat ground.
    """
    m = np.empty((3, 3))
    m[0, 0] = a
    m[1, 1] = d
    m[2, 2] = f
    m[0, 1] = m[1, 0] = b
    m[0, 2] = m[2, 0] = c
    m[1, 2] = m[2, 1] = e
    vz = np.array([0.0, 0.0, 1.0])  # the z row of the eigenvector matrix is all that is needed
    scale = abs(a) + abs(d) + abs(f)
    for _ in range(12):
        off = abs(m[0, 1]) + abs(m[0, 2]) + abs(m[1, 2])
        if off <= 1e-15 * scale:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if m[p, q] == 0.0:
                    continue
                theta = (m[q, q] - m[p, p]) / (2.0 * m[p, q])
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                cs = 1.0 / math.sqrt(t * t + 1.0)
                sn = t * cs
                for i in range(3):
                    u = m[i, p]
                    v = m[i, q]
                    m[i, p] = cs * u - sn * v
                    m[i, q] = sn * u + cs * v
                for i in range(3):
                    u = m[p, i]
                    v = m[q, i]
                    m[p, i] = cs * u - sn * v
                    m[q, i] = sn * u + cs * v
                u = vz[p]
                v = vz[q]
                vz[p] = cs * u - sn * v
                vz[q] = sn * u + cs * v
    first = 0
    for i in range(1, 3):
        if m[i, i] > m[first, first]:
            first = i
    second = -1
    for i in range(3):
        if i != first and (second < 0 or m[i, i] > m[second, second]):
            second = i
    return abs(vz[first]), abs(vz[second])


@njit(cache=True)
def edge_risk(height, xs, ys, x0, y0, res, xa, ya, xb, yb, radius, native):
    """Terrain risk of the straight move a -> b, or -1 where fewer than three map points describe it.

    Principal axes of the points in the ellipse with foci a and b and minor semi-axis `radius`:
    0.8 |e1.z| + 0.2 |e2.z|, below 0.1 counted as 0. `native` keeps two defects of the released planner: the ellipse is
    turned the wrong way (mirrored about the x axis) and the eigenvectors are sqrt(3) too short.
    """
    rows, cols = height.shape
    dx = xb - xa
    dy = yb - ya
    d = F32(math.sqrt(dx * dx + dy * dy))
    cx = (xa + xb) * F32(0.5)
    cy = (ya + yb) * F32(0.5)
    f = d * F32(0.5)
    minor = F32(radius)
    circle = f < minor
    major = minor
    if not circle:
        major = F32(math.sqrt(f * f + minor * minor))
        circle = major == minor
    cs = dx / d
    sn = dy / d
    if not native:
        sn = -sn
    a2 = major * major
    b2 = minor * minor
    r_lo = max(0, math.floor((cy - major - y0) / res))
    r_hi = min(rows - 1, math.ceil((cy + major - y0) / res))
    c_lo = max(0, math.floor((cx - major - x0) / res))
    c_hi = min(cols - 1, math.ceil((cx + major - x0) / res))
    n = 0
    z0 = 0.0
    su = sv = sz = suu = suv = suz = svv = svz = szz = 0.0
    for r in range(r_lo, r_hi + 1):
        v = ys[r] - cy
        for c in range(c_lo, c_hi + 1):
            u = xs[c] - cx
            if u * u + v * v > a2:
                continue
            if not circle:
                lx = cs * u - sn * v
                ly = sn * u + cs * v
                if lx * lx * b2 + ly * ly * a2 >= a2 * b2:
                    continue
            z = height[r, c]
            if z != z:
                continue
            if n == 0:
                z0 = float(z)
            w = float(z) - z0
            n += 1
            du = float(u)
            dv = float(v)
            su += du
            sv += dv
            sz += w
            suu += du * du
            suv += du * dv
            suz += du * w
            svv += dv * dv
            svz += dv * w
            szz += w * w
    if n < 3:
        return F32(-1.0)
    i = 1.0 / n
    j = 1.0 / (n - 1)
    e1, e2 = top_two_z(
        (suu - su * su * i) * j,
        (suv - su * sv * i) * j,
        (suz - su * sz * i) * j,
        (svv - sv * sv * i) * j,
        (svz - sv * sz * i) * j,
        (szz - sz * sz * i) * j,
    )
    risk = 0.8 * e1 + 0.2 * e2
    if native:
        risk /= math.sqrt(3.0)
    return F32(0.0) if risk < 0.1 else F32(risk)


@njit(cache=True)
def height_near(height, x0, y0, res, x, y):
    """Height of the map point nearest to x, y; searched ring by ring, so gaps in the map do not matter."""
    rows, cols = height.shape
    r0 = min(max(cell_of(y, y0, res), 0), rows - 1)
    c0 = min(max(cell_of(x, x0, res), 0), cols - 1)
    z = height[r0, c0]
    if z == z:
        return z
    best = np.inf
    for ring in range(1, max(rows, cols)):
        if best < ring * ring * res * res * 0.5:
            break
        for r in range(max(0, r0 - ring), min(rows, r0 + ring + 1)):
            step = 1 if abs(r - r0) == ring else 2 * ring
            for c in range(c0 - ring, c0 + ring + 1, step):
                if 0 <= c < cols and height[r, c] == height[r, c]:
                    d = (x0 + c * res - x) ** 2 + (y0 + r * res - y) ** 2
                    if d < best:
                        best = d
                        z = height[r, c]
    return z


@njit(cache=True)
def nearest_height(height, x0, y0, res, nodes):
    """Set z of `nodes` (n, 3) from their x, y."""
    for v in range(len(nodes)):
        nodes[v, 2] = height_near(height, x0, y0, res, nodes[v, 0], nodes[v, 1])
