"""What ART derives from the map: where feet may stand, the ground's normals, where poses are drawn."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.filling import fill_unknown
from mapping.grid import ElevationGrid
from tools.baselines.art.params import ArtParams

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Layers:
    """Of a map, all (rows, cols)."""

    height: Array
    """[m], filled."""
    masked: Array
    """[m], NaN where no foot may stand."""
    normal: Array
    """(rows, cols, 3) unit."""
    rise: Array
    """Largest height difference over the arms of the normal [m]."""
    drawn: NDArray[np.bool_]
    """Where poses are drawn."""
    seen: NDArray[np.bool_]


def layers(grid: ElevationGrid, p: ArtParams) -> Layers:
    """All seen ground is traversable; unseen ground is not, but for holes. Unseen heights are filled as the project
    fills them.

    Without `masks` all ground is, as in a run of the release that no traversability layer is given to.
    """
    height = fill_unknown(np.where(grid.trusted, grid.height, np.nan)).astype(np.float64)
    seen = grid.trusted if p.masks else np.ones(grid.shape, np.bool_)
    res = grid.resolution

    def cells(length: float) -> int:
        return max(1, round(length / res))

    safe = closed(seen, cells(p.hole))
    drop = height - least(height, cells(2.0 * p.drop_radius)) > p.drop
    safe[drop] = seen[drop]
    wall = most(height, cells(2.0 * p.margin)) - height > p.drop
    safe[wall] = True
    safe = eroded(safe, cells(2.0 * p.margin))
    keep = ~seen | wall
    safe[keep] = seen[keep]
    safe = dilated(eroded(safe, cells(p.foothold)), cells(p.foothold)) & seen
    drawn = closed(safe, cells(math.hypot(p.reach[0], p.reach[1])))
    drawn = eroded(drawn, cells(min(p.torso[0] - p.reach[0], p.torso[1] - p.reach[1]) / 2.0))
    normal, rise = normals(height, res, cells((p.torso[0] + p.torso[1]) / 4.0))
    return Layers(height, np.where(safe, height, np.nan), normal, rise, drawn, seen)


def density(base: Layers, vertices: NDArray[np.int64], sigma: float, unknown_mass: float) -> Array:
    """(rows, cols) chance of each cell to be drawn: less where vertices (n, 2; row, column) are within `sigma`
    cells."""
    count = np.zeros(base.height.shape)
    np.add.at(count, (vertices[:, 0], vertices[:, 1]), 1.0)
    reach = math.ceil(3.0 * sigma)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        count = np.apply_along_axis(np.convolve, axis, np.pad(count, reach), kernel, "same")[
            reach:-reach, reach:-reach
        ]
    weight = np.where(base.drawn, count.max() - count, 0.0)
    if not weight.any():
        weight = base.drawn.astype(np.float64)
    unseen, rest = weight[~base.seen].sum(), weight[base.seen].sum()
    if rest > 0.0 and unseen > unknown_mass * (unseen + rest):
        weight[~base.seen] *= unknown_mass / (1.0 - unknown_mass) * rest / unseen
    total = weight.sum()
    return weight / total if total > 0.0 else weight


def dilated(mask: NDArray[np.bool_], size: int) -> NDArray[np.bool_]:
    """True within a disc of `size` cells across of a True cell."""
    return _extreme(mask.astype(np.float64), size, True) > 0.5


def eroded(mask: NDArray[np.bool_], size: int) -> NDArray[np.bool_]:
    """True where all of a disc of `size` cells across is True, as far as it lies on the map."""
    return _extreme(mask.astype(np.float64), size, False) > 0.5


def closed(mask: NDArray[np.bool_], size: int) -> NDArray[np.bool_]:
    """Dilated, then eroded."""
    return eroded(dilated(mask, size), size)


def most(height: Array, size: int) -> Array:
    """Largest height within a disc of `size` cells across."""
    return np.asarray(_extreme(height, size, True))


def least(height: Array, size: int) -> Array:
    """Least height within a disc of `size` cells across."""
    return np.asarray(_extreme(height, size, False))


@njit(cache=True)
def _extreme(values, size, largest):
    """Largest or least value over a disc of `size` cells across, row by row of the disc."""
    rows, cols = values.shape
    reach = size // 2
    limit = (0.5 * size) ** 2
    sign = 1.0 if largest else -1.0
    out = np.full((rows, cols), -np.inf)
    for dr in range(-reach, reach + 1):
        width = -1
        while (width + 1) ** 2 + dr * dr <= limit:
            width += 1
        if width < 0:
            continue
        for r in range(rows):
            if not 0 <= r + dr < rows:
                continue
            for c in range(cols):
                best = out[r, c]
                for j in range(max(0, c - width), min(cols, c + width + 1)):
                    v = sign * values[r + dr, j]
                    best = max(best, v)
                out[r, c] = best
    return sign * out


@njit(cache=True)
def normals(height, res, reach):
    """(rows, cols, 3) mean of the unit normals of crosses with arms of 1 to `reach` cells, straight and diagonal;
    (rows, cols) largest
    height difference over an arm's ends [m].
    """
    rows, cols = height.shape
    out = np.zeros((rows, cols, 3))
    rise = np.zeros((rows, cols))
    for r in range(rows):
        for c in range(cols):
            for k in range(1, reach + 1):
                up, down = min(r + k, rows - 1), max(r - k, 0)
                right, left = min(c + k, cols - 1), max(c - k, 0)
                w, d = (right - left) * res, (up - down) * res
                ax, ay = height[r, right] - height[r, left], height[up, c] - height[down, c]
                # (w, 0, ax) x (0, d, ay)
                x, y, z = -ax * d, -w * ay, w * d
                size = math.sqrt(x * x + y * y + z * z)
                bx, by = height[up, right] - height[down, left], height[up, left] - height[down, right]
                # (w, d, bx) x (-w, d, by)
                p, q, s = d * by - bx * d, -bx * w - w * by, 2.0 * w * d
                length = math.sqrt(p * p + q * q + s * s)
                out[r, c, 0] += x / size + p / length
                out[r, c, 1] += y / size + q / length
                out[r, c, 2] += z / size + s / length
                rise[r, c] = max(rise[r, c], abs(ax), abs(ay), abs(bx), abs(by))
            out[r, c] /= math.sqrt((out[r, c] ** 2).sum())
    return out, rise
