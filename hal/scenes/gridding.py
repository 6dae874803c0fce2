"""From points and triangles to a height array without holes, and a place to start on it."""

from __future__ import annotations

from collections.abc import Mapping
from math import atan2

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.scenes.scene import Geometry, Goal, Pose, SceneError
from hal.scenes.survey import relief

MAX_CELLS = 16_000_000
MAX_FACED = 20 * MAX_CELLS
"""Cells within the bounding boxes of all faces."""
MAX_COORDINATE = 10_000.0
"""[m]; beyond, single precision no longer holds a millimetre."""
LEAST_HEADROOM = 0.8
"""Free height [m] over ground under a ceiling; what hangs lower stands on the ground. As `clearance` of the elevation
map."""
SAME_SURFACE = 1e-3
"""Surfaces closer above one another than this are one [m]."""
START_CLEARANCE = 0.45
"""Half side of the square that must be level around a start [m]."""
LEVEL_RANGES = (0.06, 0.12, 0.25)
"""Height range on that square [m]; the strictest with a place wins."""
HIGHEST_STEP = 0.08
"""Highest edge between neighbouring cells of one connected area [m]."""


def grid(
    geometry: Geometry, resolution: float, name: str
) -> tuple[NDArray[np.float32], tuple[float, float], bool]:
    """The ground of each cell: height (rows, cols) [m] with NaN where nothing was, the origin, and whether a mesh
    goes on above it.

    Of points, the highest is the ground. Of a mesh, it is the lowest surface that faces up and has LEAST_HEADROOM
    below the next one, which must face down (a ceiling, a bridge): faces run counterclockwise seen from the free side,
    as modelling programs write them. Where there is none, the highest surface is the ground."""
    if np.abs(geometry.vertices).max() > MAX_COORDINATE:
        raise SceneError(
            f"{name}: points lie more than {MAX_COORDINATE / 1000:.0f} km from the origin: shift the file to "
            "a local frame"
        )
    low = np.floor(geometry.vertices.min(axis=0) / resolution) * resolution
    cols, rows = (np.ceil((geometry.vertices.max(axis=0) - low) / resolution)[:2] + 1).astype(int)
    if rows * cols > MAX_CELLS:
        wide = float(np.sqrt(rows * cols / MAX_CELLS) * resolution)
        raise SceneError(
            f"{name}: {cols * resolution:.0f} x {rows * resolution:.0f} m at {resolution} m are too many cells:"
            f" give a resolution of {wide:.2f} m or more, or cut the file"
        )
    if min(rows, cols) < 2:
        raise SceneError(f"{name}: smaller than two cells of {resolution} m: give a finer resolution")
    scaled = (geometry.vertices[:, :2] - low[:2]) / resolution
    z = geometry.vertices[:, 2]
    origin = (float(low[0]), float(low[1]))
    if len(geometry.triangles):
        corners = scaled[geometry.triangles]
        if (np.ptp(corners, axis=1) + 1.0).prod(axis=1).sum() > MAX_FACED:
            raise SceneError(
                f"{name}: its faces cover each cell many times: leave out what lies below others"
            )
        first = np.zeros(rows * cols + 1, np.int64)
        _rasterise(scaled, z, geometry.triangles, rows, cols, first, np.empty(0), np.empty(0, np.int8))
        first = np.concatenate([[0], np.cumsum(first[:-1])])
        levels, faces = np.empty(first[-1]), np.empty(first[-1], np.int8)
        _rasterise(scaled, z, geometry.triangles, rows, cols, first.copy(), levels, faces)
        height, top = np.full((2, rows * cols), np.nan, np.float32)
        _ground(first, levels, faces, LEAST_HEADROOM, SAME_SURFACE, height, top)
        return height.reshape(rows, cols), origin, bool((top > height).any())
    height = np.full((rows, cols), -np.inf, np.float32)
    cell = np.round(scaled).astype(np.int64)
    np.maximum.at(height, (cell[:, 1], cell[:, 0]), z.astype(np.float32))
    height[np.isinf(height)] = np.nan
    return height, origin, False


@njit(cache=True)
def _rasterise(
    xy: NDArray[np.float64],
    z: NDArray[np.float64],
    triangles: NDArray[np.int64],
    rows: int,
    cols: int,
    place: NDArray[np.int64],
    levels: NDArray[np.float64],
    faces: NDArray[np.int8],
) -> None:
    """Where each triangle stands over the cell centres. `xy` in cells.

    With empty `levels`, counts the surfaces of each cell in `place` (rows * cols + 1). Else `place` is where each cell
    begins in `levels` [m] and `faces` (1 up, -1 down), and moves on.
    """
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k]
        ux, uy = xy[b, 0] - xy[a, 0], xy[b, 1] - xy[a, 1]
        vx, vy = xy[c, 0] - xy[a, 0], xy[c, 1] - xy[a, 1]
        area = ux * vy - uy * vx
        if abs(area) < 1e-12:
            continue  # vertical or degenerate: its upper edge belongs to a neighbour
        c0 = max(int(np.ceil(min(xy[a, 0], xy[b, 0], xy[c, 0]) - 1e-9)), 0)
        c1 = min(int(np.floor(max(xy[a, 0], xy[b, 0], xy[c, 0]) + 1e-9)), cols - 1)
        r0 = max(int(np.ceil(min(xy[a, 1], xy[b, 1], xy[c, 1]) - 1e-9)), 0)
        r1 = min(int(np.floor(max(xy[a, 1], xy[b, 1], xy[c, 1]) + 1e-9)), rows - 1)
        for r in range(r0, r1 + 1):
            for col in range(c0, c1 + 1):
                px, py = col - xy[a, 0], r - xy[a, 1]
                s = (px * vy - py * vx) / area
                t = (ux * py - uy * px) / area
                if s >= -1e-9 and t >= -1e-9 and s + t <= 1.0 + 1e-9:
                    at = place[r * cols + col]
                    place[r * cols + col] += 1
                    if len(levels):
                        levels[at] = z[a] + s * (z[b] - z[a]) + t * (z[c] - z[a])
                        faces[at] = 1 if area > 0.0 else -1


@njit(cache=True)
def _ground(
    first: NDArray[np.int64],
    levels: NDArray[np.float64],
    faces: NDArray[np.int8],
    headroom: float,
    same: float,
    height: NDArray[np.float32],
    top: NDArray[np.float32],
) -> None:
    """Out, per cell with surfaces: `height`, the ground as `grid` defines it, and `top`, the highest surface [m]."""
    for cell in range(len(height)):
        begin, end = first[cell], first[cell + 1]
        if begin == end:
            continue
        order = begin + np.argsort(levels[begin:end])
        top[cell] = height[cell] = levels[order[-1]]
        k = 0
        while k < len(order):
            z, up, down = levels[order[k]], False, False
            while k < len(order) and levels[order[k]] <= z + same:
                up |= faces[order[k]] > 0
                down |= faces[order[k]] < 0
                k += 1
            if not up or down or k == len(order):
                continue  # the underside of something, or something stands on it, or it is the highest
            above, ceiling = levels[order[k]], False
            for j in range(k, len(order)):
                if levels[order[j]] > above + same:
                    break
                ceiling |= faces[order[j]] < 0
            if ceiling and above - z >= headroom:
                height[cell] = z
                break


def fill(height: NDArray[np.float32]) -> NDArray[np.float32]:
    """Holes closed: small ones by the median of their neighbours, large ones from ever coarser means."""
    if np.isnan(height).all():
        raise SceneError("the terrain has no known cell")
    out = height.copy()
    for _ in range(2):
        hole = np.isnan(out)
        if not hole.any():
            return out
        padded = np.pad(out, 1, constant_values=np.nan)
        rows, cols = np.nonzero(hole)
        around = np.stack([padded[rows + i, cols + j] for i in range(3) for j in range(3)])
        enough = np.isfinite(around).sum(axis=0) >= 4
        out[rows[enough], cols[enough]] = np.nanmedian(around[:, enough], axis=0)
    return _pull(out)


def _pull(height: NDArray[np.float32]) -> NDArray[np.float32]:
    hole = np.isnan(height)
    if not hole.any():
        return height
    rows, cols = height.shape
    even = np.pad(height, ((0, rows % 2), (0, cols % 2)), constant_values=np.nan)
    quads = np.stack([even[i::2, j::2] for i in (0, 1) for j in (0, 1)])
    known = np.isfinite(quads).sum(axis=0)
    coarse = np.where(known > 0, np.nansum(quads, axis=0) / np.maximum(known, 1), np.nan).astype(np.float32)
    filled = np.repeat(np.repeat(_pull(coarse), 2, axis=0), 2, axis=1)[:rows, :cols]
    return np.where(hole, filled, height)


def place_start(
    height: NDArray[np.float32],
    known: NDArray[np.bool_],
    resolution: float,
    origin: tuple[float, float],
    name: str,
) -> tuple[Pose, Mapping[str, Goal]]:
    """A start on level ground in the largest connected area, goal `far` at its far end and `home` at the start."""
    cells = max(1, round(START_CLEARANCE / resolution))
    uneven = relief(height, cells)
    seen = _share(known, 2) > 0.6
    # On the way, half the width of the robot is enough; to stand and turn it takes the whole clearance.
    narrow = relief(height, max(1, cells // 2))
    for level in LEVEL_RANGES:
        free = (uneven < level) & seen
        free[:cells] = free[-cells:] = False
        free[:, :cells] = free[:, -cells:] = False
        if free.any():
            break
    else:
        raise SceneError(
            f"{name}: no level place of {2 * START_CLEARANCE:.1f} m to start on: give one (`up --start X Y YAW`, "
            "`plan FILE X,Y`), coarser cells (--resolution), "
            "or say what its numbers are (--units, --up)"
        )
    way = free | ((narrow < level) & (_share(known, 2) > 0.3))
    best, area, done = np.zeros_like(free), 0, np.zeros_like(free)
    for seed in zip(*np.nonzero(free), strict=True):
        if not done[seed]:
            reached = free & (_flood(way, height, HIGHEST_STEP, seed[0], seed[1]) >= 0)
            done |= reached
            if reached.sum() > area:
                best, area = reached, int(reached.sum())
    inside = np.argwhere(best)
    start = inside[np.argmin(((inside - inside.mean(axis=0)) ** 2).sum(axis=1))]
    distance = np.where(best, _flood(way, height, HIGHEST_STEP, start[0], start[1]), -1)
    far = np.unravel_index(int(np.argmax(distance)), distance.shape)
    x, y = origin[0] + start[1] * resolution, origin[1] + start[0] * resolution
    fx, fy = origin[0] + float(far[1]) * resolution, origin[1] + float(far[0]) * resolution
    yaw = atan2(fy - y, fx - x)
    return (float(x), float(y), yaw), {"home": (float(x), float(y), None), "far": (fx, fy, None)}


def _share(mask: NDArray[np.bool_], cells: int) -> NDArray[np.float64]:
    """(rows, cols) share of true cells within a square of +-`cells` cells; outside counts as false."""
    sums = (
        np.pad(mask.astype(np.int64), ((cells + 1, cells), (cells + 1, cells))).cumsum(axis=0).cumsum(axis=1)
    )
    side = 2 * cells + 1
    box = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    return np.asarray(box / side**2, np.float64)


@njit(cache=True)
def _flood(
    free: NDArray[np.bool_], height: NDArray[np.float32], step: float, row: int, col: int
) -> NDArray[np.int32]:
    """Steps (rows, cols) from a cell over free neighbours less than `step` [m] apart in height; -1 beyond."""
    rows, cols = free.shape
    out = np.full((rows, cols), -1, np.int32)
    queue = np.empty((rows * cols, 2), np.int32)
    queue[0, 0], queue[0, 1] = row, col
    out[row, col] = 0
    head, tail = 0, 1
    while head < tail:
        r, c = queue[head]
        head += 1
        for k in range(4):
            i = r + (1 if k == 0 else -1 if k == 1 else 0)
            j = c + (1 if k == 2 else -1 if k == 3 else 0)
            if i < 0 or j < 0 or i >= rows or j >= cols or out[i, j] >= 0 or not free[i, j]:
                continue
            if abs(height[i, j] - height[r, c]) < step:
                out[i, j] = out[r, c] + 1
                queue[tail, 0], queue[tail, 1] = i, j
                tail += 1
    return out
