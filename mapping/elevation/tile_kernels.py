"""Compiled access to the cells of a tile store: where a cell lies in the pool, read-outs, what differs from what was
sent."""

from __future__ import annotations

import numpy as np
from numba import njit

from hal.kernels import borrows
from mapping.elevation.exchange import PLANTS


@njit(cache=True)
def locate(i, j, directory, first, shift, out, begin):  # pragma: no cover - compiled
    """Fill `out` with pool indices from `begin` on; returns the first cell whose tile is absent, or their number."""
    mask = (1 << shift) - 1
    area = 2 * shift
    for k in range(begin, i.size):
        row, col = i[k] >> shift, j[k] >> shift
        slot = directory[row - first[0], col - first[1]]
        if slot < 0:
            return k
        out[k] = (np.int64(slot) << area) + ((i[k] & mask) << shift) + (j[k] & mask)
    return i.size


@borrows
def base_of(directory, first, shift, row, col):  # pragma: no cover - compiled
    """Pool index of the first cell of a tile, -1 when it is absent."""
    r, c = row - first[0], col - first[1]
    if 0 <= r < directory.shape[0] and 0 <= c < directory.shape[1] and directory[r, c] >= 0:
        return np.int64(directory[r, c]) << (2 * shift)
    return np.int64(-1)


@njit(cache=True)
def gather(
    cells, directory, first, shift, i0, j0, height, variance, upper, count, source
):  # pragma: no cover - compiled
    """See `TileStore.read`."""
    rows, cols = height.shape
    mask = (1 << shift) - 1
    for r in range(rows):
        i = i0 + r
        c = 0
        while c < cols:
            j = j0 + c
            end = min(cols, c + mask + 1 - (j & mask))
            base = base_of(directory, first, shift, i >> shift, j >> shift)
            if base < 0:
                for k in range(c, end):
                    height[r, k] = variance[r, k] = np.nan
                    upper[r, k] = np.inf
                    count[r, k] = source[r, k] = 0
            else:
                at = base + ((i & mask) << shift) + (j & mask) - c
                for k in range(c, end):
                    cell = cells[at + k]
                    height[r, k] = cell.height
                    variance[r, k] = cell.variance
                    upper[r, k] = cell.upper
                    count[r, k] = cell.count
                    source[r, k] = cell.source
            c = end


@njit(cache=True)
def take_back(
    cells,
    touched,
    directory,
    first,
    shift,
    i0,
    j0,
    height,
    variance,
    upper,
    source,
    wanted,
    count,
    lidar,
    now,
):  # pragma: no cover - compiled
    """See `TileStore.take_back`; cells of absent tiles are left out."""
    rows, cols = height.shape
    mask = (1 << shift) - 1
    for r in range(rows):
        i = i0 + r
        c = 0
        while c < cols:
            j = j0 + c
            end = min(cols, c + mask + 1 - (j & mask))
            base = base_of(directory, first, shift, i >> shift, j >> shift)
            at = base + ((i & mask) << shift) + (j & mask) - c
            for k in range(c, end if base >= 0 else c):
                if not wanted[r, k]:
                    continue
                cell, known = cells[at + k], source[r, k] > 0
                cell.height = height[r, k] if known else np.nan
                cell.variance = variance[r, k] if known else np.nan
                # under leaves it is their top
                cell.upper = np.inf if known and source[r, k] != PLANTS else upper[r, k]
                cell.alt = cell.below = np.nan
                cell.seen, cell.alt_seen = now, 0
                cell.count = count if source[r, k] == lidar else 0
                cell.source = source[r, k]
                cell.streak = cell.passes = 0
                touched[base >> (2 * shift)] = 1
            c = end


@njit(cache=True)
def differences(
    sent, directory, first, shift, i0, j0, height, upper, state, step, boxes
):  # pragma: no cover - compiled
    """See `TileStore.differences`; an empty box has no rows."""
    rows, cols = height.shape
    size = 1 << shift
    mask = size - 1
    for band in range(boxes.shape[0]):
        top, bottom, left, right = rows, 0, cols, 0
        for write in range(2):  # find the rectangle, then keep it
            r0, r1 = (top, bottom) if write else (band * size, min((band + 1) * size, rows))
            for r in range(r0, r1):
                i = i0 + r
                c, stop = (left, right) if write else (0, cols)
                while c < stop:
                    j = j0 + c
                    end = min(stop, c + size - (j & mask))
                    base = base_of(directory, first, shift, i >> shift, j >> shift)
                    at = base + ((i & mask) << shift) + (j & mask) - c
                    if base >= 0:
                        for k in range(c, end):
                            old = sent[at + k]
                            h, u = height[r, k], upper[r, k]
                            if write:
                                old.height, old.upper, old.state = h, u, state[r, k]
                                continue
                            differs = state[r, k] != old.state or abs(h - old.height) > step
                            if not differs and h != h:
                                was = old.upper
                                differs = abs(u - was) > 10.0 * step or (u == u) != (was == was)
                            if differs:
                                top, bottom = min(top, r), max(bottom, r + 1)
                                left, right = min(left, k), max(right, k + 1)
                    c = end
        boxes[band, 0], boxes[band, 1], boxes[band, 2], boxes[band, 3] = top, bottom, left, right
