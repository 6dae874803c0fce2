"""Which cells a face fills: a cell is wall only if most of it is.

A wall's surface lies anywhere in a cell, and range noise scatters its points into the cell before it. Taken as they
fall, both cells become wall, and a lane loses up to 9 cm a side. Here the front cell keeps the face if the face lies
in the near half of the cell. Otherwise the face belongs to the cell behind. This holds for faces that continue to
both sides; a pole stays where it is seen."""

from __future__ import annotations

import numpy as np
from numba import njit

from hal.kernels import borrows
from mapping.elevation.fusion import BOTTOM, DEPTH, POINTS, SHARED, TOP, WEIGHT
from mapping.elevation.tile_kernels import base_of

FILL_PASSES = 2
"""The scatter before a face and the face itself."""
SIDEWAYS_SHARE = 0.02
"""Share of the view direction along an axis below which a cell has no front on it."""
X, Y, RIM, FACE, FACE_X, ALL_X = 0, 1, 2, 3, 4, 6
"""Columns of a face, one cache line: middle of its cell [m]; height [m] below which a point lies on the face alone,
and the number of such points; sums of x and y from the middle, over these points and over the points on face and top.
"""


@borrows
def _entry(mark, which, k, index):  # pragma: no cover
    """Row of pool cell `index` in the scan, -1 if it is not there."""
    if index < 0:
        return np.int64(-1)
    s = np.int64(mark[np.uint64(index)])
    return s if 0 <= s < k and which[np.uint64(s)] == index else np.int64(-1)


@njit(cache=True)
def fill_faces(
    z, weight, shared, slot, m, ends, ray, sensor, band, resolution, directory, first, tiles, shift,
    cells, mark, which, sums, k,
):  # fmt: skip  # pragma: no cover
    """Move faces whose points lie in the far half of their cell to the cell behind; see the module.

    z, weight, shared (m,): points of one scan, see `fusion.project`; slot (m,): row of each point in which (k,) and
    sums (k, 8) of `fusion.reduce_cells`; ray (m,): row of each point in ends (q, 3), world; sensor (3,) world;
    directory, first, tiles, shift: of the tile store; mark: scratch of `reduce_cells`, as it left it.

    A cell that gives its face away keeps its foot if the cell before it is as high; otherwise the scan says nothing
    of it. Points within `band` of the top are not of the face: a box has a top. Returns the new number of rows k."""
    # Few cells are tall or unknown, and their points are few: both are listed without a branch, because no processor
    # can predict which they are, and all the rest is worked out for those alone. the ground that a face stands on:
    # seen in this scan, known in the cell, or in the cells before it
    ground = np.empty(k, np.float32)
    tall, open_ = np.empty(k, np.bool_), np.empty(k, np.bool_)
    some, number = np.empty(k, np.uint32), np.empty(k, np.int32)
    n = np.uint32(0)
    for t in range(np.uint64(k)):
        cell = cells[np.uint64(which[t])]
        bottom, height = sums[t, BOTTOM], cell.height
        known = cell.source == 2
        low = height if known and height < bottom else bottom
        ground[t] = low
        open_[t] = not known
        tall[t] = sums[t, TOP] - low > 2.0 * band
        number[t] = -1
        some[n] = t
        n += np.uint32(tall[t] | open_[t])
    place, part = np.empty((n, 2), np.int64), np.zeros((n, 8))
    faces = np.uint32(0)
    for a in range(n):
        t = some[a]
        i, j = _lattice(which[t], tiles, shift)
        y, x = i * resolution, j * resolution
        if open_[t]:
            di = np.int64(1) if y > sensor[1] else np.int64(-1)
            dj = np.int64(1) if x > sensor[0] else np.int64(-1)
            for axis in range(2):
                near = _beside(directory, first, shift, which[t], i, j, -di * axis, -dj * (1 - axis))
                if near >= 0 and cells[np.uint64(near)].source == 2:
                    ground[t] = min(ground[t], cells[np.uint64(near)].height)
            tall[t] = sums[t, TOP] - ground[t] > 2.0 * band
        if tall[t]:
            some[faces], place[faces, 0], place[faces, 1] = t, i, j
            part[faces, X], part[faces, Y], part[faces, RIM] = x, y, sums[t, TOP] - band
            number[t] = faces
            faces += np.uint32(1)
    if faces == 0:
        return k
    floor = np.empty(k)
    for t in range(np.uint64(k)):
        floor[t] = ground[t] + band if number[t] >= 0 else np.inf
    mine = np.empty(m, np.uint32)
    n = np.uint32(0)
    for p in range(np.uint64(m)):
        mine[n] = p
        n += np.uint32(z[p] > floor[slot[p]])
    above = np.zeros(k, np.int32)  # points on face and top of a row
    for a in range(n):
        p = mine[a]
        t, r = slot[p], ray[p]
        c = np.uint32(number[t])
        x = np.float64(ends[r, 0]) - part[c, X]
        y = np.float64(ends[r, 1]) - part[c, Y]
        on_face = 1.0 if z[p] < part[c, RIM] else 0.0
        above[t] += 1
        part[c, FACE] += on_face
        part[c, FACE_X] += on_face * x
        part[c, FACE_X + 1] += on_face * y
        part[c, ALL_X] += x
        part[c, ALL_X + 1] += y
    most = k + FILL_PASSES * faces
    handed, given = np.zeros(most, np.uint8), np.zeros(most, np.bool_)
    todo = np.empty(faces, np.uint32)
    for a in range(faces):
        todo[a] = a
    waiting = faces
    rows, gone = k, False
    for _ in range(FILL_PASSES):
        front = tall.copy()
        left = np.uint32(0)
        for a in range(waiting):
            q = todo[a]
            t = some[q]
            if not front[t] or given[t] or above[t] == 0:
                continue
            # points of a top fill their cell, those of a face alone stand where it is
            on_face = part[q, FACE] > 0.0
            points = part[q, FACE] if on_face else np.float64(above[t])
            best, behind, before = 0.0 if on_face else 0.25 * resolution, np.int64(-1), np.int64(-1)
            here, i, j = which[t], place[q, 0], place[q, 1]
            dx, dy = part[q, X] - sensor[0], part[q, Y] - sensor[1]
            far = np.sqrt(dx * dx + dy * dy)
            hidden = False  # without a face before it nothing changes until the next pass
            for axis in range(2):
                along = dx if axis == 0 else dy
                if abs(along) < SIDEWAYS_SHARE * far:
                    continue
                d = np.int64(1) if along > 0.0 else np.int64(-1)
                di, dj = (np.int64(0), d) if axis == 0 else (d, np.int64(0))
                depth = d * (part[q, FACE_X + axis] if on_face else part[q, ALL_X + axis]) / points
                if not depth > best:
                    continue
                near = _beside(directory, first, shift, here, i, j, -di, -dj)
                s = _entry(mark, which, k, near)
                if s >= 0 and front[np.uint64(s)]:
                    hidden = True
                    continue
                wide, side = True, np.int64(-1)
                while wide and side <= 1:
                    wide = False
                    for deep in range(2):
                        up, right = deep * di + side * dj, deep * dj + side * di
                        s = _entry(mark, which, k, _beside(directory, first, shift, here, i, j, up, right))
                        if s >= 0 and 2 * above[np.uint64(s)] >= above[t]:
                            wide = True
                            break
                    side += 2
                if wide:
                    best, before = depth, near
                    behind = _beside(directory, first, shift, here, i, j, di, dj)
            todo[left] = q
            left += np.uint32(hidden)
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
        waiting = left
    if not gone:
        return k
    for t in range(k):
        foot = handed[t] == 1
        floor[t] = sums[t, BOTTOM] + band if foot else -np.inf
        if foot:
            sums[t, TOP] = sums[t, BOTTOM]
            sums[t, WEIGHT] = sums[t, DEPTH] = sums[t, POINTS] = sums[t, SHARED] = 0.0
    n = np.uint32(0)
    for p in range(np.uint64(m)):
        mine[n] = p
        n += np.uint32(z[p] <= floor[slot[p]])
    for a in range(n):
        p = mine[a]
        t = slot[p]
        w = weight[p]
        sums[t, WEIGHT] += w
        sums[t, DEPTH] += w * (z[p] - sums[t, TOP])
        sums[t, POINTS] += np.float32(1.0)
        sums[t, SHARED] += shared[p]
    kept = np.int64(0)
    for t in range(rows):
        if handed[t] != 2:
            if kept < t:
                which[kept] = which[t]
                _copy_row(sums, t, kept)
            kept += 1
    return kept


@borrows
def _copy_row(sums, of, to):  # pragma: no cover
    """One row of 8 onto another: as one piece, which a loop over the columns is not."""
    a, b, c, d = sums[of, 0], sums[of, 1], sums[of, 2], sums[of, 3]
    e, f, g, h = sums[of, 4], sums[of, 5], sums[of, 6], sums[of, 7]
    sums[to, 0], sums[to, 1], sums[to, 2], sums[to, 3] = a, b, c, d
    sums[to, 4], sums[to, 5], sums[to, 6], sums[to, 7] = e, f, g, h


@borrows
def _lattice(index, tiles, shift):  # pragma: no cover
    """Row and column of pool cell `index`."""
    tile, mask = index >> (2 * shift), (np.int64(1) << shift) - 1
    i = (np.int64(tiles[tile, 0]) << shift) + ((index >> shift) & mask)
    return i, (np.int64(tiles[tile, 1]) << shift) + (index & mask)


@borrows
def _beside(directory, first, shift, index, i, j, di, dj):  # pragma: no cover
    """Pool index of the cell `di` rows and `dj` columns from cell `index` at (i, j), -1 if its tile is absent."""
    size = np.int64(1) << shift
    r, c = (i & (size - 1)) + di, (j & (size - 1)) + dj
    if 0 <= r < size and 0 <= c < size:
        return index + di * size + dj
    i, j = i + di, j + dj
    base = base_of(directory, first, shift, i >> shift, j >> shift)
    return base + ((i & (size - 1)) << shift) + (j & (size - 1)) if base >= 0 else np.int64(-1)
