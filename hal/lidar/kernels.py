"""Ray kernels: the triangulated height surface and oriented boxes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

BLOCK = 8
"""Cells per side of one entry of the max pyramid."""

PARALLEL = 1e-12
"""Cells per metre below which a ray goes along an axis: it is taken to drift by that little, which spares every test for zero."""


def block_maxima(height: NDArray[np.float32]) -> NDArray[np.float32]:
    """Highest vertex of every BLOCK x BLOCK group of cells. Shape ceil((rows-1)/BLOCK), ceil((cols-1)/BLOCK)."""
    rows, cols = height.shape
    brows, bcols = -(-(rows - 1) // BLOCK), -(-(cols - 1) // BLOCK)
    out = np.empty((brows, bcols), np.float32)
    for i in range(brows):
        band = height[i * BLOCK : (i + 1) * BLOCK + 1]
        for j in range(bcols):
            out[i, j] = band[:, j * BLOCK : (j + 1) * BLOCK + 1].max()
    return out


@njit(cache=True, nogil=True)
def _gap(height: NDArray[np.float32], r: int, c: int, u: float, v: float, z: float, lower: bool) -> float:
    """Height of a point above one triangle of cell (r, c). The diagonal runs from (r, c) to (r+1, c+1)."""
    h00 = height[r, c]
    h11 = height[r + 1, c + 1]
    if lower:
        h10 = height[r, c + 1]
        return z - (h00 + u * (h10 - h00) + v * (h11 - h10))
    h01 = height[r + 1, c]
    return z - (h00 + v * (h01 - h00) + u * (h11 - h01))


@njit(cache=True, nogil=True)
def _march(
    height: NDArray[np.float32],
    blocks: NDArray[np.float32],
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    t_max: float,
    top: float,
) -> float:
    """Distance to the surface along one ray; x, y in cells, z in metres, t in metres; `top`: above all of the surface [m]. inf
    for a miss."""
    # Conditional expressions instead of `min` and `max`, and one division per axis: both halve the time.
    rows, cols = height.shape
    t0 = 0.0
    t1 = t_max
    if dz > 0.0 and oz + dz * t1 > top:  # nothing stands higher
        t1 = (top - oz) / dz
    dx = dx if abs(dx) > PARALLEL else PARALLEL
    dy = dy if abs(dy) > PARALLEL else PARALLEL
    inv_x = 1.0 / dx
    inv_y = 1.0 / dy
    for o, inv, edge in ((ox, inv_x, cols - 1.0), (oy, inv_y, rows - 1.0)):
        a = -o * inv
        b = (edge - o) * inv
        low = a if a < b else b
        high = b if a < b else a
        t0 = low if low > t0 else t0
        t1 = high if high < t1 else t1
    if t0 >= t1:
        return np.inf
    # Which side of the surface the ray is on is carried from cell to cell: a crossing that falls between two
    # cells by rounding is then found in the second one instead of being stepped through.
    known = False
    above = True
    step_c = 1 if dx > 0.0 else -1
    step_r = 1 if dy > 0.0 else -1
    next_c = 1 if dx > 0.0 else 0  # the cell border that a ray leaves through
    next_r = 1 if dy > 0.0 else 0
    bc = min(max(int((ox + dx * t0) / BLOCK), 0), blocks.shape[1] - 1)
    br = min(max(int((oy + dy * t0) / BLOCK), 0), blocks.shape[0] - 1)
    t = t0
    while t < t1:
        tx = ((bc + next_c) * BLOCK - ox) * inv_x
        ty = ((br + next_r) * BLOCK - oy) * inv_y
        t_out = tx if tx < ty else ty
        t_out = t_out if t_out < t1 else t1
        lowest = oz + dz * (t if dz > 0.0 else t_out)
        if lowest > blocks[br, bc]:
            known = True
            above = True
        else:
            c_low = bc * BLOCK
            r_low = br * BLOCK
            c_high = min(c_low + BLOCK, cols - 1) - 1
            r_high = min(r_low + BLOCK, rows - 1) - 1
            c = min(max(int(ox + dx * t), c_low), c_high)
            r = min(max(int(oy + dy * t), r_low), r_high)
            s = t
            while s < t_out:
                sx = (c + next_c - ox) * inv_x
                sy = (r + next_r - oy) * inv_y
                e = sx if sx < sy else sy
                e = e if e < t_out else t_out
                e = e if e > s else s
                h0 = height[r, c] if height[r, c] > height[r, c + 1] else height[r, c + 1]
                h1 = height[r + 1, c] if height[r + 1, c] > height[r + 1, c + 1] else height[r + 1, c + 1]
                lowest = oz + dz * (s if dz > 0.0 else e)
                if lowest > (h0 if h0 > h1 else h1):
                    known = True
                    above = True
                else:
                    # The diagonal u = v cuts the cell; the ray crosses it at `m`.
                    m = e
                    rate = dx - dy
                    if rate != 0.0:
                        cut = -((ox - c) - (oy - r)) / rate
                        if s < cut < e:
                            m = cut
                    a = s
                    for b in (m, e):
                        if b > a or not known:
                            mid = 0.5 * (a + b)
                            lower = (ox + dx * mid - c) >= (oy + dy * mid - r)
                            fa = _gap(height, r, c, ox + dx * a - c, oy + dy * a - r, oz + dz * a, lower)
                            fb = _gap(height, r, c, ox + dx * b - c, oy + dy * b - r, oz + dz * b, lower)
                            if not known:
                                known = True
                                above = fa >= 0.0
                            if (fb >= 0.0) != above:
                                if (fa >= 0.0) != above or fa == fb:
                                    return a
                                return a + (b - a) * fa / (fa - fb)
                        a = b
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
            if bc < 0 or bc >= blocks.shape[1]:
                break
        else:
            br += step_r
            if br < 0 or br >= blocks.shape[0]:
                break
        t = t_out if t_out > t else t
    return np.inf


@njit(cache=True, nogil=True)
def cast_surface(
    height: NDArray[np.float32],
    blocks: NDArray[np.float32],
    resolution: float,
    x0: float,
    y0: float,
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    t_max: float,
) -> NDArray[np.float32]:
    """Range (n,) [m] to the triangulated surface, inf for a miss."""
    n = origins.shape[0]
    out = np.empty(n, np.float32)
    top = blocks.max() + 1e-3
    scale = 1.0 / resolution
    for i in range(n):
        out[i] = _march(
            height,
            blocks,
            (origins[i, 0] - x0) * scale,
            (origins[i, 1] - y0) * scale,
            float(origins[i, 2]),
            directions[i, 0] * scale,
            directions[i, 1] * scale,
            float(directions[i, 2]),
            t_max,
            top,
        )
    return out


@njit(cache=True, nogil=True)
def cast_boxes(
    boxes: NDArray[np.float64],
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    ranges: NDArray[np.float32],
) -> None:
    """Lower `ranges` (n,) to the nearest box. Rows of `boxes`: centre (3), half size (3), rotation world <- box (9).

    A ray that starts inside a box leaves it unseen.
    """
    for k in range(boxes.shape[0]):
        b = boxes[k]
        for i in range(origins.shape[0]):
            near = -np.inf
            far = np.inf
            for a in range(3):
                o = 0.0
                d = 0.0
                for w in range(3):
                    axis = b[6 + 3 * w + a]
                    o += axis * (origins[i, w] - b[w])
                    d += axis * directions[i, w]
                if abs(d) < 1e-12:
                    if abs(o) > b[3 + a]:
                        near = np.inf
                    continue
                p = (-b[3 + a] - o) / d
                q = (b[3 + a] - o) / d
                near = max(near, min(p, q))
                far = min(far, max(p, q))
            if 0.0 < near <= far and near < ranges[i]:
                ranges[i] = near


@njit(cache=True, nogil=True)
def incidence(
    height: NDArray[np.float32],
    resolution: float,
    x0: float,
    y0: float,
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    ranges: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """|cos| of the angle between ray and surface normal at each hit, into `out` (n,); 0 for a miss."""
    rows, cols = height.shape
    for i in range(ranges.shape[0]):
        t = ranges[i]
        if not np.isfinite(t):
            out[i] = 0.0
            continue
        gx = (origins[i, 0] + directions[i, 0] * t - x0) / resolution
        gy = (origins[i, 1] + directions[i, 1] * t - y0) / resolution
        c = min(max(int(gx), 0), cols - 2)
        r = min(max(int(gy), 0), rows - 2)
        h00 = height[r, c]
        h11 = height[r + 1, c + 1]
        if gx - c >= gy - r:
            sx = height[r, c + 1] - h00
            sy = h11 - height[r, c + 1]
        else:
            sx = h11 - height[r + 1, c]
            sy = height[r + 1, c] - h00
        sx /= resolution
        sy /= resolution
        dot = -sx * directions[i, 0] - sy * directions[i, 1] + directions[i, 2]
        out[i] = abs(dot) / np.sqrt(1.0 + sx * sx + sy * sy)
