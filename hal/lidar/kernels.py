"""Ray kernels: the triangulated height surface and oriented boxes."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

BLOCK = 8
"""Cells per side of one entry of the max pyramid."""


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


@njit(cache=True, nogil=True, inline="always")
def _next_plane(o: float, d: float, index: int) -> float:
    """Ray parameter at which a coordinate leaves the unit interval [index, index + 1]."""
    if d > 0.0:
        return (index + 1 - o) / d
    if d < 0.0:
        return (index - o) / d
    return np.inf


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
) -> float:
    """Distance to the surface along one ray; x, y in cells, z in metres, t in metres. inf for a miss."""
    rows, cols = height.shape
    t0 = 0.0
    t1 = t_max
    for o, d, top in ((ox, dx, cols - 1.0), (oy, dy, rows - 1.0)):
        if d == 0.0:
            if o < 0.0 or o > top:
                return np.inf
        else:
            a = -o / d
            b = (top - o) / d
            t0 = max(t0, min(a, b))
            t1 = min(t1, max(a, b))
    if t0 >= t1:
        return np.inf
    # Which side of the surface the ray is on is carried from cell to cell: a crossing that falls between two
    # cells by rounding is then found in the second one instead of being stepped through.
    known = False
    above = True
    x = ox + dx * t0
    y = oy + dy * t0
    bc = min(max(int(x / BLOCK), 0), blocks.shape[1] - 1)
    br = min(max(int(y / BLOCK), 0), blocks.shape[0] - 1)
    t = t0
    while t < t1:
        tx = _next_plane(ox / BLOCK, dx / BLOCK, bc)
        ty = _next_plane(oy / BLOCK, dy / BLOCK, br)
        t_out = min(tx, ty, t1)
        if min(oz + dz * t, oz + dz * t_out) > blocks[br, bc]:
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
                sx = _next_plane(ox, dx, c)
                sy = _next_plane(oy, dy, r)
                e = min(sx, sy, t_out)
                e = max(e, s)
                top = max(max(height[r, c], height[r, c + 1]), max(height[r + 1, c], height[r + 1, c + 1]))
                if min(oz + dz * s, oz + dz * e) > top:
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
                    c += 1 if dx > 0.0 else -1
                    if c < c_low or c > c_high:
                        break
                else:
                    r += 1 if dy > 0.0 else -1
                    if r < r_low or r > r_high:
                        break
                s = e
        if tx <= ty:
            bc += 1 if dx > 0.0 else -1
            if bc < 0 or bc >= blocks.shape[1]:
                break
        else:
            br += 1 if dy > 0.0 else -1
            if br < 0 or br >= blocks.shape[0]:
                break
        t = max(t, t_out)
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
