"""Terrain assessment: a plane per cell from the points around it, and what speaks against driving there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from tools.baselines.t_hybrid.params import THybridParams

CEILING_HEIGHT = 1.0
"""Points this far above the lowest of a window are dropped [m]."""
ROUGHNESS_SCALE = 0.05
"""Roughness 1 is a mean distance from the plane of so much [m]."""
PLANE_DISTANCE = 0.20
"""Largest distance of a point from the plane of a traversable cell [m]."""
OCCUPIED_POINTS = 2
"""Points in a blocked cell from which it counts as an obstacle."""
NO_RECORD, BLOCKED, TRAVERSABLE = -1, 0, 1


@dataclass(frozen=True, slots=True)
class HybridMap:
    """The assessed terrain; cell [r, c] covers x from `origin[0] + c cell`, y from `origin[1] + r cell`."""

    flag: NDArray[np.int8]
    """(rows, cols): `NO_RECORD` (fewer than three points around), `BLOCKED`, `TRAVERSABLE`."""
    rough: NDArray[np.float64]
    """(rows, cols) mean distance of the window's points from their plane over 5 cm; 0 where not traversable."""
    normal: NDArray[np.float64]
    """(rows, cols, 3) unit, upward."""
    occupied: NDArray[np.bool_]
    """(rows, cols): obstacles of the 2-D layer."""
    origin: tuple[float, float]
    """x, y [m] of the CORNER of cell [0, 0]."""
    cell: float
    """[m]"""


def assess(grid: ElevationGrid, params: THybridParams) -> HybridMap:
    """Assess the trusted cells of a grid as points."""
    r, c = np.nonzero(grid.trusted & np.isfinite(grid.height))
    half = 0.5 * grid.resolution
    corner = (grid.origin[0] - half, grid.origin[1] - half)
    xyz = np.column_stack(
        [
            grid.origin[0] + c * grid.resolution,
            grid.origin[1] + r * grid.resolution,
            grid.height[r, c],
        ]
    )
    rows, cols = (math.ceil(n * grid.resolution / params.cell - 1e-6) for n in grid.shape)
    return assess_points(xyz, corner, (rows, cols), params)


def assess_points(
    points: NDArray[np.float64], origin: tuple[float, float], shape: tuple[int, int], params: THybridParams
) -> HybridMap:
    """Assess points (n, 3) [m] on `shape` (rows, cols) cells from the corner `origin` x, y [m]. Their order counts, see
    `_judge`."""
    rows, cols = shape
    p = np.ascontiguousarray(points, np.float64) - (*origin, 0.0)
    # A ring's squares may reach beyond the last cell.
    ring = max(1, math.ceil(1.0 / params.cell)) if params.ring else 0
    column = np.floor(p[:, 0] / params.cell).astype(np.int64)
    row = np.floor(p[:, 1] / params.cell).astype(np.int64)
    inside = (column >= 0) & (column < cols + ring) & (row >= 0) & (row < rows + ring)
    p, column, row = p[inside], column[inside], row[inside]
    index = row * (cols + ring) + column
    order = np.argsort(index, kind="stable")
    count = np.bincount(index, minlength=(rows + ring) * (cols + ring))
    first = np.concatenate([[0], np.cumsum(count)])
    flag = np.full((rows, cols), NO_RECORD, np.int8)
    rough = np.zeros((rows, cols))
    normal = np.zeros((rows, cols, 3))
    _assess(p[order], first, cols + ring, params.cell, params.max_slope, params.ring, flag, rough, normal)
    many = count.reshape(rows + ring, cols + ring)[:rows, :cols] >= OCCUPIED_POINTS
    return HybridMap(flag, rough, normal, (flag == BLOCKED) & many, origin, params.cell)


@njit(cache=True)
def _assess(points, first, stride, cell, max_slope, ring, flag, rough, normal):
    """Fill flag, rough, normal; `points` are sorted by cell, cell k holds `first[k]:first[k + 1]`."""
    rows, cols = flag.shape
    window = np.empty((points.shape[0], 3))
    total_rows = (first.size - 1) // stride
    for r in range(rows):
        for c in range(cols):
            x, y = c * cell + 1e-9, r * cell + 1e-9
            own = 0
            n = 0
            if x < ring or x > cols * cell - ring or y < ring or y > rows * cell - ring:
                x0, y0 = np.floor(x), np.floor(y)
                for rr in range(int(y0 / cell), min(int((y0 + 1.0) / cell) + 1, total_rows)):
                    for cc in range(int(x0 / cell), min(int((x0 + 1.0) / cell) + 1, stride)):
                        for k in range(first[rr * stride + cc], first[rr * stride + cc + 1]):
                            inside = x0 <= points[k, 0] < x0 + 1.0 and y0 <= points[k, 1] < y0 + 1.0
                            if inside:
                                window[n] = points[k]
                                n += 1
            else:
                for rr in range(max(r - 1, 0), min(r + 2, rows)):
                    for cc in range(max(c - 1, 0), min(c + 2, cols)):
                        for k in range(first[rr * stride + cc], first[rr * stride + cc + 1]):
                            window[n] = points[k]
                            n += 1
            own = first[r * stride + c + 1] - first[r * stride + c]
            _judge(window[:n], own, max_slope, flag, rough, normal, r, c)


@njit(cache=True)
def _judge(window, own, max_slope, flag, rough, normal, r, c):
    """Judge one cell by its window of points. Of the release: the residuals tested are those of the first `own`
    points."""
    if window.shape[0] < 3:
        return
    low = window[:, 2].min()
    kept = window[window[:, 2] <= low + CEILING_HEIGHT]
    n = kept.shape[0]
    if n < 3:
        return
    mean = np.zeros(3)
    for k in range(n):
        mean += kept[k]
    mean /= n
    scatter = np.zeros((3, 3))
    for k in range(n):
        d = kept[k] - mean
        for i in range(3):
            for j in range(3):
                scatter[i, j] += d[i] * d[j]
    up = smallest_axis(scatter)
    normal[r, c] = up
    flag[r, c] = BLOCKED
    if math.acos(min(1.0, up[2])) > max_slope:
        return
    residual = np.empty(n)
    for k in range(n):
        d = kept[k] - mean
        residual[k] = d[0] * up[0] + d[1] * up[1] + d[2] * up[2]
    if own > 0:
        values = np.unique(residual[: min(own, n)])
        for k in range(2, values.size - 2):
            if abs(values[k]) > PLANE_DISTANCE:
                return
    flag[r, c] = TRAVERSABLE
    rough[r, c] = np.abs(residual).mean() / ROUGHNESS_SCALE


@njit(cache=True)
def smallest_axis(m):
    """(3,) unit eigenvector of the smallest eigenvalue of a symmetric (3, 3) matrix, upward (Jacobi rotations)."""
    a = m.copy()
    v = np.eye(3)
    for _ in range(30):
        p, q = 0, 1
        if abs(a[0, 2]) > abs(a[p, q]):
            p, q = 0, 2
        if abs(a[1, 2]) > abs(a[p, q]):
            p, q = 1, 2
        if abs(a[p, q]) <= 1e-15 * (abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2])):
            break
        theta = 0.5 * math.atan2(2.0 * a[p, q], a[q, q] - a[p, p])
        c, s = math.cos(theta), math.sin(theta)
        for k in range(3):
            x, y = a[k, p], a[k, q]
            a[k, p], a[k, q] = c * x - s * y, s * x + c * y
        for k in range(3):
            x, y = a[p, k], a[q, k]
            a[p, k], a[q, k] = c * x - s * y, s * x + c * y
            x, y = v[k, p], v[k, q]
            v[k, p], v[k, q] = c * x - s * y, s * x + c * y
    best = 0
    for k in range(1, 3):
        if a[k, k] < a[best, best]:
            best = k
    out = v[:, best].copy()
    return out if out[2] >= 0.0 else -out
