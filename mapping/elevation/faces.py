"""Which cells a face fills: a cell is wall only if most of it is.

A wall's surface lies anywhere in a cell, and range noise scatters its points into the cell before it. Taken as they fall, both cells
become wall, and a lane loses up to 9 cm a side. Here the front cell of a face keeps it if the face lies in the near half of the
cell; otherwise the face belongs to the cell behind. That holds for faces that go on to both sides; a pole stays where it is seen.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mapping.elevation.fusion import BOTTOM, DEPTH, POINTS, SHARED, TOP, WEIGHT
from mapping.elevation.tile_kernels import base_of

PASSES = 2
"""The scatter before a face and the face itself."""
SIDEWAYS = 0.02
"""Share of the view direction along an axis below which a cell has no front on it."""


@njit(cache=True)
def _entry(mark, which, k, index):  # pragma: no cover
    """Row of pool cell `index` in the scan, -1 if it is not there."""
    if index < 0:
        return np.int64(-1)
    s = np.int64(mark[index])
    return s if 0 <= s < k and which[s] == index else np.int64(-1)


@njit(cache=True)
def fill_faces(
    z, weight, shared, slot, m, ends, ray, sensor, band, resolution, directory, first, shift,
    cells, mark, which, sums, k,
):  # fmt: skip  # pragma: no cover
    """Hand faces whose points lie in the far half of their cell to the cell behind; see the module.

    z, weight, shared (m,): the points of one scan, see `fusion.project`; slot (m,): row of each in which (k,), sums (k, 8) of
    `fusion.reduce_cells`; ray (m,): row of each in ends (q, 3), world; sensor (3,) world; mark: scratch of `reduce_cells`, as it left it.
    A cell that hands its face on keeps its foot where the cell before it is as high, else the scan says nothing of it. Points within `band` of the top
    are not of the face: a box has a top. Returns the new number of rows k.
    """
    inv = 1.0 / resolution
    size = np.int64(1) << shift
    # the ground that a face stands on: seen in this scan, known in the cell, or in the cells before it
    ground = np.empty(k, np.float32)
    tall, open_ = np.zeros(k, np.bool_), np.zeros(k, np.bool_)
    # few cells are tall or open; all the rest is worked out for those alone
    some, number = np.empty(k, np.int32), np.empty(k, np.int32)
    n = 0
    for t in range(k):
        cell = cells[which[t]]
        ground[t] = sums[t, BOTTOM]
        if cell.source == 2:
            ground[t] = min(ground[t], cell.height)
        open_[t] = cell.source != 2
        tall[t] = sums[t, TOP] - ground[t] > 2.0 * band
        number[t] = -1
        if tall[t] or open_[t]:
            number[t] = n
            some[n] = t
            n += 1
    place = np.empty((n, 2), np.int64)
    left = n
    for p in range(m - 1, -1, -1):
        if left == 0:
            break
        c = number[slot[p]]
        if c >= 0:
            number[slot[p]] = -1
            left -= 1
            place[c, 0] = np.int64(np.floor(ends[ray[p], 1] * inv + 0.5))
            place[c, 1] = np.int64(np.floor(ends[ray[p], 0] * inv + 0.5))
    faces = 0
    for c in range(n):
        t = some[c]
        if open_[t]:
            i, j = place[c, 0], place[c, 1]
            di = np.int64(1) if i * resolution > sensor[1] else np.int64(-1)
            dj = np.int64(1) if j * resolution > sensor[0] else np.int64(-1)
            for axis in range(2):
                near = _pool(directory, first, shift, size, i - di * axis, j - dj * (1 - axis))
                if near >= 0 and cells[near].source == 2:
                    ground[t] = min(ground[t], cells[near].height)
            tall[t] = sums[t, TOP] - ground[t] > 2.0 * band
        if tall[t]:
            some[faces], place[faces, 0], place[faces, 1] = t, place[c, 0], place[c, 1]
            number[t] = faces
            faces += 1
    if faces == 0:
        return k
    # points, their sums of x and y from the middle of the cell: on the face, on face and top
    face, above = np.zeros((faces, 3)), np.zeros((faces, 3))
    for p in range(m):
        t = slot[p]
        c = number[t]
        if c < 0 or z[p] <= ground[t] + band:
            continue
        x = np.float64(ends[ray[p], 0]) - place[c, 1] * resolution
        y = np.float64(ends[ray[p], 1]) - place[c, 0] * resolution
        above[c, 0] += 1.0
        above[c, 1] += x
        above[c, 2] += y
        if z[p] < sums[t, TOP] - band:
            face[c, 0] += 1.0
            face[c, 1] += x
            face[c, 2] += y
    most = k + PASSES * faces
    handed, given = np.zeros(most, np.uint8), np.zeros(most, np.bool_)
    again = np.ones(faces, np.bool_)
    rows, gone = k, False
    for _ in range(PASSES):
        front = tall.copy()
        for q in range(faces):
            t = some[q]
            if not again[q] or not front[t] or given[t] or above[q, 0] == 0.0:
                continue
            again[q] = False  # without a face before it nothing changes until the next pass
            # points of a top fill their cell, those of a face alone stand where it is
            on_face = face[q, 0] > 0.0
            points = face[q, 0] if on_face else above[q, 0]
            best, behind, before = 0.0 if on_face else 0.25 * resolution, np.int64(-1), np.int64(-1)
            i, j = place[q, 0], place[q, 1]
            dx, dy = j * resolution - sensor[0], i * resolution - sensor[1]
            far = np.sqrt(dx * dx + dy * dy)
            for axis in range(2):
                along = dx if axis == 0 else dy
                if abs(along) < SIDEWAYS * far:
                    continue
                d = np.int64(1) if along > 0.0 else np.int64(-1)
                di, dj = (np.int64(0), d) if axis == 0 else (d, np.int64(0))
                depth = d * (face[q, 1 + axis] if on_face else above[q, 1 + axis]) / points
                if not depth > best:
                    continue
                near = _pool(directory, first, shift, size, i - di, j - dj)
                s = _entry(mark, which, k, near)
                if s >= 0 and front[s]:
                    again[q] = True
                    continue
                wide, side = True, np.int64(-1)
                while wide and side <= 1:
                    wide = False
                    for deep in range(2):
                        r, c = i + deep * di + side * dj, j + deep * dj + side * di
                        s = _entry(mark, which, k, _pool(directory, first, shift, size, r, c))
                        if s >= 0 and number[s] >= 0 and 2.0 * above[number[s], 0] >= above[q, 0]:
                            wide = True
                            break
                    side += 2
                if wide:
                    best, before = depth, near
                    behind = _pool(directory, first, shift, size, i + di, j + dj)
            if behind < 0:
                continue
            s = _entry(mark, which, rows, behind)
            if s < 0:
                s = np.int64(rows)
                rows += 1
                mark[behind] = s
                which[s] = behind
                _copy_row(sums, t, s)
            elif handed[s] != 0 or sums[s, TOP] < sums[t, TOP] - band:
                foot = sums[s, BOTTOM]
                _copy_row(sums, t, s)
                sums[s, BOTTOM] = foot
                handed[s] = 0
            given[s] = True
            tall[t] = False
            gone = True
            foot = sums[t, BOTTOM]
            s = _entry(mark, which, k, before)
            level = before >= 0 and cells[before].source == 2 and abs(cells[before].height - foot) <= band
            level = level or (s >= 0 and abs(sums[s, TOP] - foot) <= band)
            handed[t] = 1 if level and foot <= ground[t] + band else 2
    if not gone:
        return k
    for t in range(k):
        if handed[t] == 1:
            sums[t, TOP] = sums[t, BOTTOM]
            sums[t, WEIGHT] = sums[t, DEPTH] = sums[t, POINTS] = sums[t, SHARED] = 0.0
    for p in range(m):
        t = slot[p]
        if handed[t] == 1 and z[p] <= sums[t, BOTTOM] + band:
            w = weight[p]
            sums[t, WEIGHT] += w
            sums[t, DEPTH] += w * (z[p] - sums[t, TOP])
            sums[t, POINTS] += np.float32(1.0)
            sums[t, SHARED] += shared[p]
    n = 0
    for t in range(rows):
        if handed[t] != 2:
            if n < t:
                which[n] = which[t]
                _copy_row(sums, t, n)
            n += 1
    return n


@njit(cache=True)
def _copy_row(sums, of, to):  # pragma: no cover
    """One row onto another, without the views that an assignment of rows makes."""
    for column in range(sums.shape[1]):
        sums[to, column] = sums[of, column]


@njit(cache=True)
def _pool(directory, first, shift, size, i, j):  # pragma: no cover
    """Pool index of cell (i, j), -1 if its tile is absent."""
    base = base_of(directory, first, shift, i >> shift, j >> shift)
    return base + ((i & (size - 1)) << shift) + (j & (size - 1)) if base >= 0 else np.int64(-1)
