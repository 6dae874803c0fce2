"""The march of rays over the triangulated height surface: exact on the triangles.

One long kernel: a function per ray would count references to the arrays for every ray, which takes as long as the
march."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.lidar.kernels import BLOCK_REACH, BLOCK_SIDE

PARALLEL_DRIFT = 1e-12
"""Cells per metre below which a ray runs along an axis: it is given that small drift, which saves every test for
zero."""
PER_BLOCK = 1.0 / BLOCK_SIDE
LONGEST_JUMP = BLOCK_REACH * BLOCK_SIDE - 1e-3
"""Cells along the faster axis that a ray may go without leaving what `Pyramid.around` covers."""


# error_model: no test for zero before each division. Unsigned indices: none for negative ones. Conditional expressions
# instead of `min` and `max`, and one division per axis: both halve the time.
@njit(cache=True, nogil=True, error_model="numpy")
def cast_surface(
    height: NDArray[np.float32],
    cells: NDArray[np.float32],
    blocks: NDArray[np.float32],
    around: NDArray[np.float32],
    highest: float,
    resolution: float,
    x0: float,
    y0: float,
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    t_max: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Range (n,) [m] to the surface along unit `directions` (n, 3) from `origins` (n, 3), inf for a miss, and |cos|
    (n,) of the angle between ray and surface normal there, 0 for a miss.

    `height` (rows, cols) [m] with its `Pyramid`; (x0, y0) [m]: vertex [0, 0]. Inside, x and y are in cells, z and the
    parameter t of a ray in metres."""
    n = origins.shape[0]
    ranges, cosine = np.empty(n, np.float32), np.empty(n, np.float32)
    top = highest + 1e-3
    scale = 1.0 / resolution
    rows, cols = height.shape
    last_bc, last_br = blocks.shape[1] - 1, blocks.shape[0] - 1
    for i in range(np.uint64(n)):
        ranges[i] = np.inf
        cosine[i] = 0.0
        ox, oy, oz = (origins[i, 0] - x0) * scale, (origins[i, 1] - y0) * scale, float(origins[i, 2])
        dx, dy, dz = directions[i, 0] * scale, directions[i, 1] * scale, float(directions[i, 2])
        # from where to where the ray is over the surface
        t = 0.0
        t1 = t_max
        if dz > 0.0 and oz + dz * t1 > top:  # nothing stands higher
            t1 = (top - oz) / dz
        dx = dx if abs(dx) > PARALLEL_DRIFT else PARALLEL_DRIFT
        dy = dy if abs(dy) > PARALLEL_DRIFT else PARALLEL_DRIFT
        inv_x = 1.0 / dx
        inv_y = 1.0 / dy
        a = -ox * inv_x
        b = (cols - 1.0 - ox) * inv_x
        t = (a if a < b else b) if (a if a < b else b) > t else t
        t1 = (b if a < b else a) if (b if a < b else a) < t1 else t1
        a = -oy * inv_y
        b = (rows - 1.0 - oy) * inv_y
        t = (a if a < b else b) if (a if a < b else b) > t else t
        t1 = (b if a < b else a) if (b if a < b else a) < t1 else t1
        # Which side of the surface the ray is on is carried from cell to cell: a crossing that falls between two
        # cells by rounding is then found in the second one instead of being stepped through.
        known = False
        above = True
        step_c = 1 if dx > 0.0 else -1
        step_r = 1 if dy > 0.0 else -1
        next_c = 1 if dx > 0.0 else 0  # the cell border that a ray leaves through
        next_r = 1 if dy > 0.0 else 0
        jump = LONGEST_JUMP * (abs(inv_x) if abs(inv_x) < abs(inv_y) else abs(inv_y))
        bc = min(max(int((ox + dx * t) * PER_BLOCK), 0), last_bc)
        br = min(max(int((oy + dy * t) * PER_BLOCK), 0), last_br)
        while t < t1:
            far = t + jump
            far = far if far < t1 else t1
            if oz + dz * (t if dz > 0.0 else far) > around[np.uint64(br), np.uint64(bc)]:
                known = True
                above = True
                t = far
                bc = min(max(int((ox + dx * t) * PER_BLOCK), 0), last_bc)
                br = min(max(int((oy + dy * t) * PER_BLOCK), 0), last_br)
                continue
            tx = ((bc + next_c) * BLOCK_SIDE - ox) * inv_x
            ty = ((br + next_r) * BLOCK_SIDE - oy) * inv_y
            t_out = tx if tx < ty else ty
            t_out = t_out if t_out < t1 else t1
            if oz + dz * (t if dz > 0.0 else t_out) > blocks[np.uint64(br), np.uint64(bc)]:
                known = True
                above = True
            else:
                c_low, r_low = bc * BLOCK_SIDE, br * BLOCK_SIDE
                c_high, r_high = min(c_low + BLOCK_SIDE, cols - 1) - 1, min(r_low + BLOCK_SIDE, rows - 1) - 1
                c = min(max(int(ox + dx * t), c_low), c_high)
                r = min(max(int(oy + dy * t), r_low), r_high)
                s = t
                while s < t_out:
                    sx = (c + next_c - ox) * inv_x
                    sy = (r + next_r - oy) * inv_y
                    e = sx if sx < sy else sy
                    e = e if e < t_out else t_out
                    e = e if e > s else s
                    if oz + dz * (s if dz > 0.0 else e) > cells[np.uint64(r), np.uint64(c)]:
                        known = True
                        above = True
                    else:
                        h00, h10 = height[np.uint64(r), np.uint64(c)], height[np.uint64(r), np.uint64(c + 1)]
                        h01 = height[np.uint64(r + 1), np.uint64(c)]
                        h11 = height[np.uint64(r + 1), np.uint64(c + 1)]
                        u, v = ox - c, oy - r
                        # The diagonal u = v cuts the cell; the ray crosses it at `m`: inf or NaN when it goes along.
                        m = (v - u) / (dx - dy)
                        m = m if s < m < e else e
                        lower = u - v + 0.5 * (s + m) * (dx - dy) >= 0.0
                        a, b = s, m
                        for _ in range(2):
                            if b > a or not known:
                                slope_u = h10 - h00 if lower else h11 - h01
                                slope_v = h11 - h10 if lower else h01 - h00
                                gap = oz - h00 - u * slope_u - v * slope_v
                                rate = dz - dx * slope_u - dy * slope_v
                                fa, fb = gap + a * rate, gap + b * rate
                                if not known:
                                    known = True
                                    above = fa >= 0.0
                                if (fb >= 0.0) != above:
                                    between = (fa >= 0.0) == above and fa != fb
                                    ranges[i] = a + (b - a) * fa / (fa - fb) if between else a
                                    steep = (slope_u * slope_u + slope_v * slope_v) * scale * scale
                                    cosine[i] = abs(rate) / np.sqrt(1.0 + steep)
                                    t1 = -1.0
                                    break
                            a, b = b, e
                            lower = not lower
                        if t1 < 0.0:
                            break
                    if sx <= sy:
                        c += step_c
                        if c < c_low or c > c_high:
                            break
                    else:
                        r += step_r
                        if r < r_low or r > r_high:
                            break
                    s = e
            if tx <= ty:
                bc += step_c
                if bc < 0 or bc > last_bc:
                    break
            else:
                br += step_r
                if br < 0 or br > last_br:
                    break
            t = t_out if t_out > t else t
    return ranges, cosine
