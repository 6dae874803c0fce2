"""Visibility: what a ray passed through is not there (any more).

One walk along the rays of a scan gives both the clean-up (surfaces that rays looked through) and the upper bound (the
lowest ray over a cell never hit). Source of the idea: lowest-point clean-up of ANYbotics/elevation_mapping; here every
ray is walked exactly (Amanatides & Woo) over the tiles.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mapping.elevation.tiles import PLANTS
from mapping.elevation.walk import first_cell, next_cell

SETTLED_RAYS = 2
"""Rays of one scan that must look through a settled cell: a mixed pixel's ray seems to cross what it grazed."""
COMPANY_BAND = 0.05
"""Ground under something that left agrees with the ground around it within this [m]."""
HANGING_RAYS = 6
"""Rays of one scan that must pass deep under a surface that is still seen: a beam or a lintel hangs there."""


@njit(cache=True)
def _stands_alone(cells, index, height, shift):  # pragma: no cover
    """Whether no neighbour in the tile reaches this height [m]: a wall goes on, one mixed pixel does not."""
    size = 1 << shift
    i, j = (index >> shift) & (size - 1), index & (size - 1)
    for a in range(max(i - 1, 0), min(i + 2, size)):
        for b in range(max(j - 1, 0), min(j + 2, size)):
            if (a != i or b != j) and cells[
                index + ((a - i) << shift) + (b - j)
            ].height > height - COMPANY_BAND:
                return False
    return True


@njit(cache=True)
def trace(
    xyz, m, stride, first_ray, sensor, directory, first, shift, resolution, reach, skip, margin, angle, settled,
    cells, touched, mark, hit, low, many,
):  # fmt: skip  # pragma: no cover
    """Walk rays from sensor (3,) to every `stride`-th of xyz[:m] (world), over cells of allocated tiles.

    Lowers `upper` of cells without a LiDAR height and flags their tile in `touched`. Collects in `hit` the pool index
    of each cell with a height that a ray passed under by more than `margin` + 3 sigma. The ray's last `skip` [m] do
    not count (a quarter of it if nothing beside the cell is as high). `low`: the lowest such ray; `many`: their
    number. angle: sigma of the ray direction [rad]; settled: points of an established cell. `mark` is scratch (sparse
    set). Returns the number of cells in `hit`."""
    n = 0
    size = np.int64(1) << shift
    mask = size - 1
    rows, cols = directory.shape
    inv = 1.0 / resolution
    # lattice coordinates in which cell k spans [k, k+1)
    sx, sy = sensor[0] * inv + 0.5, sensor[1] * inv + 0.5
    for p in range(first_ray, m, stride):
        dx, dy = xyz[p, 0] - sensor[0], xyz[p, 1] - sensor[1]
        dist = np.sqrt(dx * dx + dy * dy)
        if dist < 2.0 * resolution:
            continue
        dz = (xyz[p, 2] - sensor[2]) / dist
        ux, uy = dx / dist, dy / dist
        end = min(dist - resolution, reach)
        solid_end = min(dist - skip, reach)
        stray_end = min(dist - 0.25 * skip, reach)
        gap_i = resolution / abs(uy) if uy != 0.0 else np.inf
        gap_j = resolution / abs(ux) if ux != 0.0 else np.inf
        i, j, next_i, next_j = first_cell(sx, sy, ux, uy, 0.0, resolution)
        at = 0.0
        tile_i, tile_j = np.int64(1) << 40, np.int64(1) << 40
        base = np.int64(-1)
        while True:
            leave = min(next_i, next_j)
            if not leave <= end:  # a direction that is no number ends here too
                break
            ti, tj = i >> shift, j >> shift
            if ti != tile_i or tj != tile_j:
                tile_i, tile_j = ti, tj
                r, c = ti - first[0], tj - first[1]
                base = np.int64(-1)
                if 0 <= r < rows and 0 <= c < cols:
                    slot = directory[r, c]
                    if slot >= 0:
                        base = np.int64(slot) << (2 * shift)
            if base >= 0:
                index = base + ((i & mask) << shift) + (j & mask)
                cell = cells[index]
                # the ray's highest point over the cell: only what lies above all of it is disproved
                z = sensor[2] + dz * (at if dz < 0.0 else leave)
                if cell.source == 2:
                    over = cell.height - z - margin
                    # stray cells and what a thing that left has left behind have no face that the ray could graze
                    if over > 0.0 and (
                        leave <= solid_end
                        or (
                            leave <= stray_end
                            and (cell.count < settled or _stands_alone(cells, index, cell.height, shift))
                        )
                    ):
                        spread = 9.0 * (cell.variance + angle * angle * leave * leave)
                        if over * over > spread:
                            s = mark[index]
                            if s >= 0 and s < n and hit[s] == index:
                                low[s] = min(low[s], z)
                                many[s] += 1
                            elif n < hit.size:
                                mark[index] = n
                                hit[n] = index
                                low[n] = z
                                many[n] = 1
                                n += 1
                elif cell.source != PLANTS:
                    # the middle of the crossing, one sigma up
                    bound = sensor[2] + dz * 0.5 * (at + leave) + angle * leave
                    if bound < cell.upper:
                        cell.upper = bound
                        touched[base >> (2 * shift)] = 1
            at = leave
            i, j, next_i, next_j = next_cell(i, j, next_i, next_j, ux, uy, gap_i, gap_j)
    return n


@njit(cache=True)
def _has_company(cells, index, below, shift):  # pragma: no cover
    """Whether three of the neighbours in the tile know this height [m] too, now or from before. Ground goes on; the
    foot of a face, which was seen first, is a line."""
    size = 1 << shift
    i, j = (index >> shift) & (size - 1), index & (size - 1)
    n = 0
    for a in range(max(i - 1, 0), min(i + 2, size)):
        for b in range(max(j - 1, 0), min(j + 2, size)):
            other = cells[index + ((a - i) << shift) + (b - j)]
            if (a != i or b != j) and (
                abs(other.height - below) <= COMPANY_BAND or abs(other.below - below) <= COMPANY_BAND
            ):
                n += 1
    return n >= 3


@njit(cache=True)
def judge(
    hit, low, many, n, passes_needed, unseen, settled, clearance, now, cells, touched, area
):  # pragma: no cover
    """Remove cells looked through in `passes_needed` clean-ups and unconfirmed for `unseen` [ms].

    The ground that was known before returns if the rays passed above it; otherwise the cell becomes unknown. One look
    is enough for a stray cell of fewer than `settled` points, and for a surface more than `clearance` [m] above the
    rays, seen or not. Returns the number of cells removed."""
    removed = 0
    for k in range(n):
        cell = cells[hit[k]]
        if many[k] < SETTLED_RAYS and cell.count >= settled:
            continue
        if cell.passes < 255:
            cell.passes += 1
        hangs = many[k] >= HANGING_RAYS and cell.height - low[k] > clearance
        if not hangs and (
            now - cell.seen < unseen or (cell.passes < passes_needed and cell.count >= settled)
        ):
            continue
        removed += 1
        touched[hit[k] >> area] = 1
        cell.passes = 0
        cell.streak = 0
        cell.alt = np.nan
        if cell.below < low[k] and _has_company(cells, hit[k], cell.below, area >> 1):
            cell.height = cell.below
            cell.below = np.nan
            cell.seen = now
            continue
        cell.height = np.nan
        cell.variance = np.nan
        cell.below = np.nan
        cell.count = 0
        cell.source = 0
        cell.upper = low[k] if hangs else np.inf
    return removed
