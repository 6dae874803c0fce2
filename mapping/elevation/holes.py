"""How wide a hole is: the one answer to that, from the rims between which its width is measured.

A hole is ground that nobody saw between two rims, into which a ray went down below both, or ground that was seen far
below them. Cells round its width: a few centimetres of ground fill the cell at a rim, and points of the wall below the
far rim scatter into the cell before it. So a rim is the first cell that is as high as the ground behind it, which
counts up to its middle, and the width is measured along eight directions. What is wider than the robot crosses is told
as `exchange.HOLE`; planner and guard read that, each with its own kernel. They know the wider ones by their cells:
`WIDEST_HOLE` ends where every hole has more cells without ground than they cross.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from hal.kernels import borrows
from mapping.elevation.bridging import OVER

LIDAR, WIDE = 2, 9
"""`source` of measured cells, and of a hole that is wider than what is crossed, until it is told as `exchange.HOLE`."""
WIDEST_HOLE = 0.4
"""[m] between the rims of the widest hole that is looked for: less than the body is wide, so no way between two walls
is one."""
LEAST_DEPTH = 0.05
"""[m] below both rims that a ray must have come to show a hole: more than heights and poses are off."""
WALL_DROP = 0.02
"""[m] by which a cell is lower than the ground behind it that holds the wall below a rim."""
GROUND_SHARE = 0.4
"""Of the points of the ground behind it: a cell with fewer is less than half ground, or holds what scatters before the
wall."""
STEEP_FALL, STEEPEST_FALL = 0.1, 0.5
"""[m/m] Ground that falls by more towards the hole goes on so, as in a valley; by so much at most."""
SLOPE_CELLS = 4
"""Cells behind a rim that tell its slope."""
RIM_CELLS, RIM_ROUGHNESS = 3, 0.03
"""Cells behind a rim that must be known and no more uneven [m], or steeper than `STEEPEST_FALL`: a rim is ground, and
no post of a stepfield and no bar."""
CELLS_ASIDE = 2
"""Cells to both sides at which a rim is no more uneven, as far as they are known: a wall that is seen along its length
is none."""
DIRECTION_COUNT = 8
RIM_ROUNDING = 0.25
"""Cells by which the middles of two rims are farther apart along a direction than the slit is wide, as a rule."""
TOGETHER_RADIUS, OF_THEM = 0.3, 0.5
"""Cells within so many [m] tell the width together: a hole is wide where so large a share of them has it wide. One cell
is off by 2 cm (simulated LiDARs, slits of 0.10 to 0.20 m at 0 to 45 deg). With a third instead, a crack of 0.10 m at 45
deg held a robot that was half across."""


class Crossing(NamedTuple):
    """What the robot crosses."""

    gap: float = 0.12
    """Widest hole [m]."""
    drop: float = 0.24
    """[m] Ground that was seen lower than both its rims by more is the floor of a hole."""


@borrows
def _rim(height, source, ground, points, r, c, dr, dc, low, most, out):  # pragma: no cover - compiled
    """The first rim from cell (r, c) along (dr, dc), a vector one cell long, that is not lower than `low` [m]. Into
    `out` (4,): its distance [cells]; its height as it goes on to (r, c) [m], where it falls by more than the third
    number a cell, by the fourth at most. False where there is none within `most` cells."""
    rows, cols = height.shape
    last_r, last_c = r, c
    walls = 0
    for k in range(1, 2 * most + 1):
        i, j = math.floor(r + 0.5 * k * dr + 0.5), math.floor(c + 0.5 * k * dc + 0.5)
        if i < 0 or j < 0 or i >= rows or j >= cols:
            return False
        if (i == last_r and j == last_c) or not ground[i, j] or height[i, j] < low:
            continue
        last_r, last_c = i, j
        z = height[i, j]
        near, far, n, many = 0.0, z, 0, 0.0
        for b in range(1, SLOPE_CELLS + 1):
            x, y = math.floor(i + b * dr + 0.5), math.floor(j + b * dc + 0.5)
            if x < 0 or y < 0 or x >= rows or y >= cols or not ground[x, y]:
                break
            far, n = height[x, y], b
            if b <= 2:
                near += 0.5 * far
                many += 0.5 * points[x, y]
        if (
            n >= 2
            and walls < 2
            and (near - z > WALL_DROP or (source[i, j] == LIDAR and points[i, j] < GROUND_SHARE * many))
        ):
            walls += 1
            continue
        if n < RIM_CELLS or abs(far - z) > max(RIM_ROUGHNESS, n * out[3]):
            return False  # the top of a post or a bar
        for side in (-CELLS_ASIDE, CELLS_ASIDE):
            x, y = math.floor(i + dr - side * dc + 0.5), math.floor(j + dc + side * dr + 0.5)
            inside = 0 <= x < rows and 0 <= y < cols
            if inside and ground[x, y] and abs(height[x, y] - z) > max(RIM_ROUGHNESS, CELLS_ASIDE * out[3]):
                return False  # a wall along the way, seen from its foot
        away = (i - r) * dr + (j - c) * dc
        fall = (far - z) / n if n == SLOPE_CELLS else 0.0
        out[0], out[1] = away, z - (min(fall, out[3]) * away if fall > out[2] else 0.0)
        return True
    return False


@borrows
def _between(height, trusted, bound, deep, r, c, dr, dc, n, most, out):  # pragma: no cover - compiled
    """Raise `out` by one at the cells of a line of `n` from (r, c) along (dr, dc) that lie below its last rim, at most
    so many cells back."""
    last = -1
    rim = np.float32(0.0)
    for k in range(n):
        i, j = r + k * dr, c + k * dc
        z = height[i, j] if trusted[i, j] else bound[i, j]
        below = last >= 0 and k - last <= most and rim - z > (deep if trusted[i, j] else LEAST_DEPTH)
        if below:
            out[i, j] += 1
        elif trusted[i, j]:
            last, rim = k, z


@njit(cache=True)
def widths(height, source, trusted, points, bound, resolution, deep, out):  # pragma: no cover - compiled
    """Into `out` (rows, cols) f32 [m]: how wide the hole is that a cell shows, the narrowest of eight directions; 0
    where it shows none.

    height (rows, cols) [m], NaN unknown; source, points: where it comes from, and of how many; trusted: ground to stand
    on; bound [m]: the ground is not above this where it is not trusted, inf where no ray tells. Trusted ground shows
    one where it is lower than both rims by more than `deep` [m].
    """
    rows, cols = height.shape
    out[:] = 0.0
    most = int(WIDEST_HOLE / resolution)
    # What no row and no column has between two rims is in no slit of any direction.
    oblique = int(math.sqrt(2.0) * WIDEST_HOLE / resolution) + 1
    along, across = np.zeros((rows, cols), np.uint8), np.zeros((rows, cols), np.uint8)
    still, on = np.int64(0), np.int64(1)  # with numbers written out each call would be compiled by itself
    for r in range(rows):
        _between(height, trusted, bound, deep, r, still, still, on, cols, oblique, along)
        _between(height, trusted, bound, deep, r, cols - 1, still, -on, cols, oblique, along)
    for c in range(cols):
        _between(height, trusted, bound, deep, still, c, on, still, rows, oblique, across)
        _between(height, trusted, bound, deep, rows - 1, c, -on, still, rows, oblique, across)
    seeds = [(0, 0) for _ in range(0)]
    for r in range(rows):
        for c in range(cols):
            if along[r, c] == 2 or across[r, c] == 2:
                seeds.append((r, c))
    if len(seeds) == 0:
        return
    ground = np.zeros((rows, cols), np.bool_)  # measured, not bridged: a bridge may begin at what scatters
    for r in range(rows):
        for c in range(cols):
            ground[r, c] = trusted[r, c] and source[r, c] < OVER
    one, other = np.empty(4), np.empty(4)
    one[2] = other[2] = STEEP_FALL * resolution
    one[3] = other[3] = STEEPEST_FALL * resolution
    for r, c in seeds:
        z = np.float64(height[r, c] if trusted[r, c] else bound[r, c])
        drop = deep if trusted[r, c] else LEAST_DEPTH
        narrowest = np.inf
        for k in range(DIRECTION_COUNT):
            dr, dc = math.sin(math.pi * k / DIRECTION_COUNT), math.cos(math.pi * k / DIRECTION_COUNT)
            if not _rim(height, source, ground, points, r, c, dr, dc, z + 0.5 * drop, most, one):
                continue
            if not _rim(height, source, ground, points, r, c, -dr, -dc, z + 0.5 * drop, most, other):
                continue
            width = (one[0] + other[0]) * resolution
            if abs(one[1] - other[1]) > deep:
                continue  # a face with something low before it, whoever looks for a way over it
            if width <= WIDEST_HOLE and min(one[1], other[1]) - z > drop:
                narrowest = min(narrowest, width)
        if narrowest < np.inf:
            out[r, c] = narrowest


@njit(cache=True)
def mark_holes(
    height, source, trusted, points, bound, resolution, gap, drop, width
):  # pragma: no cover - compiled
    """Mark in `source` (rows, cols) the cells that show a hole wider than `gap` [m]; what a bridge led over there is
    unknown again. `width` is scratch; see `widths`."""
    rows, cols = height.shape
    widths(height, source, trusted, points, bound, resolution, drop, width)
    reach = round(TOGETHER_RADIUS / resolution)
    for r in range(rows):
        for c in range(cols):
            if width[r, c] == 0.0:
                continue
            told = wide = 0
            for i in range(max(0, r - reach), min(rows, r + reach + 1)):
                for j in range(max(0, c - reach), min(cols, c + reach + 1)):
                    told += width[i, j] > 0.0
                    wide += width[i, j] > gap + RIM_ROUNDING * resolution
            if wide >= OF_THEM * told:
                source[r, c] = WIDE
                if not trusted[r, c]:
                    height[r, c] = np.nan
