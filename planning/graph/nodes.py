"""Where the corrected graph puts its nodes: one per cell of a seeded lattice that is fixed to the ground.

Candidates in a lattice cell come from a hash of (seed, cell, number), so a node is a function of the map around it and
of the seed (which changes where others are drawn, `Cells.drawn`): rebuilding a part of the map gives exactly the nodes
that a full rebuild gives, with the same ids.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.raster import cell_of
from planning.graph.flags import FACE, HIGH, LOW, UNSEEN

CLEAR_LEVELS = (0.45, 0.36, 0.28)
"""Candidates are taken for the best of these clearances they reach [m]; steps, so that noise does not move nodes. Nodes
with less than the best move away from what is near: to where edges in more directions fit, and in a passage to its
middle, so that edges along it are parallel to its walls."""
CANDIDATE_TRIES = 6
"""Valid candidates looked at beside an obstacle."""
CORE_SHARE = 0.5
"""The first half of a cell's candidates lie in its inner part of this width: evenly spaced nodes on open ground."""


@njit(cache=True)
def _hash(a):
    """splitmix64 finaliser."""
    a = (a ^ (a >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    a = (a ^ (a >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return a ^ (a >> np.uint64(31))


@njit(cache=True)
def candidate(seed, ix, iy, k, samples, side):
    """x, y [m] of candidate k of lattice cell (ix, iy)."""
    h = _hash(np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(ix + (1 << 30)))
    h = _hash(h + np.uint64(iy + (1 << 30)) * np.uint64(0x9E3779B97F4A7C15))
    h = _hash(h + np.uint64(k))
    u = float(h >> np.uint64(32)) / 4294967296.0
    v = float(h & np.uint64(0xFFFFFFFF)) / 4294967296.0
    if 2 * k < samples:
        u = 0.5 + CORE_SHARE * (u - 0.5)
        v = 0.5 + CORE_SHARE * (v - 0.5)
    return (ix + u) * side, (iy + v) * side


@njit(cache=True)
def step_distance2(flags, x0, y0, res, x, y, radius):
    """Squared distance [m^2] at which a disc covers both sides of a step, and the cell centre that makes it so.

    radius^2 where a disc of `radius` does not.
    """
    rows, cols = flags.shape
    limit = radius * radius
    high = limit
    high_x = x
    high_y = y
    low = limit
    low_x = x
    low_y = y
    r_mid = cell_of(y, y0, res)
    k = math.ceil(radius / res)
    for j in range(2 * k + 1):
        # rows from the middle outwards, so that the search narrows early beside an obstacle
        r = r_mid + ((j + 1) // 2 if j % 2 else -(j // 2))
        if r < 0 or r >= rows:
            continue
        dy = y0 + r * res - y
        rest = max(high, low) - dy * dy
        if rest <= 0.0:
            continue
        w = math.sqrt(rest)
        for c in range(
            max(0, math.ceil((x - w - x0) / res)), min(cols - 1, math.floor((x + w - x0) / res)) + 1
        ):
            flag = flags[r, c]
            if flag & FACE:
                dx = x0 + c * res - x
                d = dx * dx + dy * dy
                if flag & HIGH and d < high:
                    high = d
                    high_x = x + dx
                    high_y = y + dy
                if flag & LOW and d < low:
                    low = d
                    low_x = x + dx
                    low_y = y + dy
    if high >= low:
        return high, high_x, high_y
    return low, low_x, low_y


@njit(cache=True)
def _seen(flags, x0, y0, res, x, y, radius, share):
    """True if at least `share` of the disc is seen."""
    rows, cols = flags.shape
    k = math.ceil(radius / res)
    r_mid = cell_of(y, y0, res)
    c_mid = cell_of(x, x0, res)
    total = 0
    seen = 0
    for r in range(r_mid - k, r_mid + k + 1):
        py = y0 + r * res
        for c in range(c_mid - k, c_mid + k + 1):
            px = x0 + c * res
            if (px - x) ** 2 + (py - y) ** 2 > radius * radius:
                continue
            total += 1
            if 0 <= r < rows and 0 <= c < cols and not flags[r, c] & UNSEEN:
                seen += 1
    return seen >= share * total


@njit(cache=True)
def _keep_off2(flags, x0, y0, res, x, y, radius):
    """As `step_distance2`, and unseen ground counts like a step: what a node should keep off where it can."""
    rows, cols = flags.shape
    best, bx, by = step_distance2(flags, x0, y0, res, x, y, radius)
    for r in range(
        max(0, math.ceil((y - radius - y0) / res)), min(rows, math.floor((y + radius - y0) / res) + 1)
    ):
        py = y0 + r * res
        rest = best - (py - y) ** 2
        if rest <= 0.0:
            continue
        w = math.sqrt(rest)
        for c in range(
            max(0, math.ceil((x - w - x0) / res)), min(cols - 1, math.floor((x + w - x0) / res)) + 1
        ):
            if flags[r, c] & UNSEEN:
                px = x0 + c * res
                d2 = (px - x) ** 2 + (py - y) ** 2
                if d2 < best:
                    best = d2
                    bx = px
                    by = py
    return best, bx, by


@njit(cache=True)
def _centred(flags, x0, y0, res, x, y, low_x, low_y, side):
    """x, y moved away from what is nearest, 2 cm at a time, inside its lattice cell, while that gives clearance."""
    best, sx, sy = _keep_off2(flags, x0, y0, res, x, y, CLEAR_LEVELS[0])
    for _ in range(12):
        if best >= CLEAR_LEVELS[0] * CLEAR_LEVELS[0] or best == 0.0:
            break
        d = math.sqrt(best)
        # not quite to the cell's border, or neighbours could meet there
        px = min(max(x + 0.02 * (x - sx) / d, low_x + 0.05 * side), low_x + 0.95 * side)
        py = min(max(y + 0.02 * (y - sy) / d, low_y + 0.05 * side), low_y + 0.95 * side)
        d2, sx, sy = _keep_off2(flags, x0, y0, res, px, py, CLEAR_LEVELS[0])
        if d2 <= best:
            break
        best = d2
        x = px
        y = py
    return x, y


@njit(cache=True)
def place_nodes(
    flags, x0, y0, res, ix0, iy0, side, seed, drawn, samples, todo, half_width, min_coverage, chosen, where
):  # fmt: skip
    """Choose the node of every lattice cell in `todo` (ny, nx); writes chosen (-1: none), where (x, y)."""
    ny, nx = todo.shape
    rows, cols = flags.shape
    levels = len(CLEAR_LEVELS)
    for j in range(ny):
        for i in range(nx):
            if not todo[j, i]:
                continue
            best_level = levels + 1
            best = -1
            tried = 0
            for k in range(samples):
                x, y = candidate(seed + drawn[j, i], ix0 + i, iy0 + j, k, samples, side)
                if x < x0 or y < y0 or x > x0 + (cols - 1) * res or y > y0 + (rows - 1) * res:
                    continue
                own = flags[cell_of(y, y0, res), cell_of(x, x0, res)]
                if own & (FACE | UNSEEN):
                    continue
                if step_distance2(flags, x0, y0, res, x, y, half_width)[0] < half_width * half_width:
                    continue
                if not _seen(flags, x0, y0, res, x, y, half_width, min_coverage):
                    continue
                d2 = _keep_off2(flags, x0, y0, res, x, y, CLEAR_LEVELS[0])[0]
                level = 0
                while level < levels and d2 < CLEAR_LEVELS[level] ** 2:
                    level += 1
                tried += 1
                if level >= best_level:
                    if tried == CANDIDATE_TRIES:
                        break
                    continue
                best_level = level
                best = k
                where[j, i, 0] = x
                where[j, i, 1] = y
                if level == 0:
                    break
            chosen[j, i] = best
            if best >= 0 and best_level > 0:
                x, y = _centred(
                    flags, x0, y0, res, where[j, i, 0], where[j, i, 1],
                    (ix0 + i) * side, (iy0 + j) * side, side,
                )  # fmt: skip
                if _seen(flags, x0, y0, res, x, y, half_width, min_coverage):
                    where[j, i, 0] = x
                    where[j, i, 1] = y
