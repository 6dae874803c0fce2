"""One point per voxel, as KISS-ICP's `VoxelDownsample` gives them, in the same order.

That one fills a table of some 50 bytes a slot. Here a slot takes 12.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.types import Array


def voxel_down_sample(points: NDArray[np.floating], size: float) -> Array:
    """The first of the points (n, 3) [m] in each cube of edge `size` [m], (m, 3)."""
    points = np.array(points, np.float64)
    out = np.empty_like(points)
    return out[: _thin(points, float(size), out)]


@njit(cache=True)
def _home(key, mask):  # pragma: no cover
    """Slot that KISS-ICP's hash gives a voxel."""
    x = np.uint32((key >> 42) - 1048576)
    y = np.uint32(((key >> 21) & 2097151) - 1048576)
    z = np.uint32((key & 2097151) - 1048576)
    mixed = (x * np.uint32(73856093)) ^ (y * np.uint32(19349669)) ^ (z * np.uint32(83492791))
    return np.int64(mixed) & mask


@njit(cache=True, error_model="numpy")
def _thin(points, size, out):  # pragma: no cover
    """Keep the first point of each voxel, in the order in which they lie in a Robin Hood table of at least 2 n slots.

    Whoever is further from its home takes the place of whoever is nearer, who then looks for another (tsl::robin_map).
    """
    slots = 1
    while slots < 2 * len(points):
        slots *= 2
    mask = slots - 1
    keys = np.full(slots, -1, np.int64)
    first = np.empty(slots, np.int32)
    for i in range(len(points)):
        kx = np.int64(np.floor(points[i, 0] / size)) + 1048576
        ky = np.int64(np.floor(points[i, 1] / size)) + 1048576
        kz = np.int64(np.floor(points[i, 2] / size)) + 1048576
        key = (kx << 42) | (ky << 21) | kz
        s = _home(key, mask)
        off = 0
        while keys[s] != key and keys[s] != -1 and off <= (s - _home(keys[s], mask)) & mask:
            s = (s + 1) & mask
            off += 1
        if keys[s] == key:
            continue
        who = i
        while keys[s] != -1:
            there = (s - _home(keys[s], mask)) & mask
            if off > there:
                keys[s], key = key, keys[s]
                first[s], who = who, first[s]
                off = there
            s = (s + 1) & mask
            off += 1
        keys[s] = key
        first[s] = who
    m = 0
    for s in range(slots):
        if keys[s] != -1:
            for k in range(3):
                out[m, k] = points[first[s], k]
            m += 1
    return m
