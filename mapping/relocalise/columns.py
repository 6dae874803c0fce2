"""Columns of height slices as bits of one word: a map, pooled coarse to fine, and a submap laid onto it.

Bit k of a word stands for the slice that begins at `base + k SLICE_HEIGHT`. A window of cells is pooled by OR, so a
pooled cell holds the bits of every cell of its window. The score of a submap on it is never below the score on a
single cell of the window."""

from __future__ import annotations

import numpy as np
from numba import njit

SLICE_HEIGHT = 0.25
"""Height of a slice [m]; 64 of them are 16 m."""
SLICE_COUNT = 64


@njit(cache=True)
def ones(word):  # pragma: no cover - compiled
    """Number of bits set in a uint64."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True)
def occupy(points, x0, y0, base, cell, columns):  # pragma: no cover - compiled
    """Set the slices within half a slice of each point (n, 3) [m] in the cells around it: a voxel's mean lies up to
    half a voxel off.

    columns (rows, cols) uint64; cell [0, 0] is centred on x0, y0."""
    rows, cols = columns.shape
    for n in range(len(points)):
        c = np.int64(np.rint((points[n, 0] - x0) / cell))
        r = np.int64(np.rint((points[n, 1] - y0) / cell))
        low = np.int64(np.floor((points[n, 2] - base) / SLICE_HEIGHT - 0.5))
        word = np.uint64(0)
        for k in range(low, low + 2):
            if 0 <= k < SLICE_COUNT:
                word |= np.uint64(1) << np.uint64(k)
        for i in range(r - 1, r + 2):
            for j in range(c - 1, c + 2):
                if 0 <= i < rows and 0 <= j < cols:
                    columns[i, j] |= word


@njit(cache=True)
def settle(height, trusted, x, y, resolution, x0, y0, base, cell, levels):  # pragma: no cover - compiled
    """Set the slice nearest to the height of each trusted cell of a block of ground (rows, cols) [m], whose cell [0,
    0] is centred on x, y.

    levels (rows, cols) uint64; cell [0, 0] is centred on x0, y0."""
    for i in range(height.shape[0]):
        r = np.int64(np.rint((y + i * resolution - y0) / cell))
        for j in range(height.shape[1]):
            if trusted[i, j]:
                k = np.int64(np.rint((np.float64(height[i, j]) - base) / SLICE_HEIGHT))
                if 0 <= k < SLICE_COUNT:
                    levels[r, np.int64(np.rint((x + j * resolution - x0) / cell))] |= np.uint64(
                        1
                    ) << np.uint64(k)


@njit(cache=True)
def pool(fine, step):  # pragma: no cover - compiled
    """OR of each cell with those `step` further along rows, columns and both: windows of twice the width."""
    rows, cols = fine.shape
    out = fine.copy()
    for i in range(rows):
        for j in range(cols):
            if j + step < cols:
                out[i, j] |= fine[i, j + step]
            if i + step < rows:
                out[i, j] |= fine[i + step, j]
                if j + step < cols:
                    out[i, j] |= fine[i + step, j + step]
    return out


@njit(cache=True)
def matched(columns, width, row, col, shift, offsets, words):  # pragma: no cover - compiled
    """Number of the submap's bits that the map has, with the robot at [row, col] and its ground `shift` slices above
    the map's base.

    columns: pooled over windows of `width` cells. offsets (n, 2): rows and columns from the robot. words (n,) uint64:
    bit SLICE_COUNT // 2 is the slice on the robot's ground."""
    rows, cols = columns.shape
    found = 0
    lift = shift - SLICE_COUNT // 2
    for n in range(len(offsets)):
        i, j = row + offsets[n, 0], col + offsets[n, 1]
        if i + width <= 0 or j + width <= 0 or i >= rows or j >= cols:
            continue
        i, j = max(i, 0), max(j, 0)  # a window that begins outside the map may reach into it
        word = columns[i, j]
        if lift >= 0:
            word = word >> np.uint64(lift)
        else:
            word = word << np.uint64(-lift)
        found += ones(word & words[n])
    return found
