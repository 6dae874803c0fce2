"""The footprint on the terrain: corner means and the four pose features of the oriented body.

Numba kernels on plain arrays; `planning.risk.body` is their face. Paper: Guo, Zhang, Schwertfeger 2026, eq. 2.
No NaN comes in: `planning.risk.terrain` has filled every height, and trust is an array of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.risk.terrain import ALL, NONE, SOME, Sampler

MOST_POSES = 64
"""Poses of a set for which a buffer is kept; longer ones get their own."""


class Scratch(NamedTuple):
    """Buffers, made once per call: a kernel that allocates per pose or set spends much of its time there."""

    cell: NDArray[np.int32]
    col: NDArray[np.float32]
    row: NDArray[np.float32]
    low: NDArray[np.uint64]
    high: NDArray[np.uint64]
    """(n,) pairs of neighbouring heights around each sample, in its row and the next."""
    z: NDArray[np.float32]
    """(n,) heights of the corner samples."""
    spot: NDArray[np.int32]
    """(tiles,) cell under each tile's centre."""
    mean: NDArray[np.float64]
    """(4,) mean heights of the corners."""
    poses: NDArray[np.float64]
    """(MOST_POSES, 3), for who makes a pose set."""
    values: NDArray[np.float64]
    """(MOST_POSES, 4), for its features."""
    moments: NDArray[np.float64]
    """(3, 4), for its moments."""


@njit(cache=True)
def scratch(sampler: Sampler) -> Scratch:
    """Buffers for `features_of`."""
    n, tiles = 4 * sampler.corner, sampler.tile_u.size
    most = max(n, tiles)
    return Scratch(
        np.empty(most, np.int32),
        np.empty(most, np.float32),
        np.empty(most, np.float32),
        np.empty(n, np.uint64),
        np.empty(n, np.uint64),
        np.empty(n, np.float32),
        np.empty(tiles, np.int32),
        np.empty(4),
        np.empty((MOST_POSES, 3)),
        np.empty((MOST_POSES, 4)),
        np.empty((3, 4)),
    )


# Bilinear heights in three kernels: place, load, interpolate. The first and the last run in vector registers, because
# each loop touches few enough arrays for LLVM to prove that they do not overlap; in one kernel they were slower.


@njit(cache=True, error_model="numpy")
def _place(stride, u, v, n, c, s, col0, row0, cell, col, row):
    """Cells of the first `n` samples and where in them they lie: `col` and `row` become fractions.

    Cells count from an anchor cell (`col0`, `row0` is the pose from there), so single precision resolves a
    millionth of a cell.
    """
    for i in range(n):
        col[i] = col0 + (u[i] * c - v[i] * s)
    for i in range(n):
        row[i] = row0 + (u[i] * s + v[i] * c)
    for i in range(n):
        cell[i] = np.int32(np.int32(row[i]) * stride + np.int32(col[i]))
    for i in range(n):
        col[i] -= np.float32(np.int32(col[i]))
    for i in range(n):
        row[i] -= np.float32(np.int32(row[i]))


@njit(cache=True, error_model="numpy")
def _load(pair, anchor, stride, n, cell, low, high):
    """The two pairs of neighbours around each sample."""
    up = np.uint64(stride)
    for i in range(n):
        k = np.uint64(anchor + cell[i])  # unsigned: no wrap-around test for negative indices
        low[i] = pair[k]
        high[i] = pair[k + up]


@njit(cache=True, error_model="numpy")
def _interpolate(low, high, n, col, row, z):
    for i in range(n):
        a = low[2 * i] + (low[2 * i + 1] - low[2 * i]) * col[i]
        b = high[2 * i] + (high[2 * i + 1] - high[2 * i]) * col[i]
        z[i] = a + (b - a) * row[i]


@njit(cache=True, error_model="numpy")
def _spots(stride, u, v, c, s, col0, row0, col, row, spot):
    """Cell under each tile's centre, counted from the anchor."""
    half = np.float32(0.5)
    for i in range(u.size):
        col[i] = col0 + (u[i] * c - v[i] * s) + half
    for i in range(u.size):
        row[i] = row0 + (u[i] * s + v[i] * c) + half
    for i in range(u.size):
        spot[i] = np.int32(np.int32(row[i]) * stride + np.int32(col[i]))


# The few samples of a tile are looked at in one pass without stores, which is faster than vectors.


@njit(cache=True, error_model="numpy")
def _tile_top(height, anchor, stride, u, v, first, last, c, s, col0, row0):
    """Highest of the samples first..last - 1 [m]."""
    one, up = np.uint64(1), np.uint64(stride)
    top = np.float32(-np.inf)
    for i in range(first, last):
        k = np.uint64(i)
        col = col0 + (u[k] * c - v[k] * s)
        row = row0 + (u[k] * s + v[k] * c)
        ci, ri = np.int32(col), np.int32(row)
        fc, fr = col - np.float32(ci), row - np.float32(ri)
        k = np.uint64(anchor + np.int32(ri * stride + ci))
        low = height[k] + (height[k + one] - height[k]) * fc
        high = height[k + up] + (height[k + up + one] - height[k + up]) * fc
        z = low + (high - low) * fr
        top = z if z > top else top
    return top


@njit(cache=True, error_model="numpy")
def _trusted_tile(height, trusted, anchor, stride, u, v, first, last, c, s, col0, row0):
    """The same of those whose nearest cell (halves round up) is trusted, -inf for none; and how many are."""
    one, up = np.uint64(1), np.uint64(stride)
    half = np.float32(0.5)
    top = np.float32(-np.inf)
    count = 0
    for i in range(first, last):
        k = np.uint64(i)
        col = col0 + (u[k] * c - v[k] * s)
        row = row0 + (u[k] * s + v[k] * c)
        if trusted[np.uint64(anchor + np.int32(np.int32(row + half) * stride + np.int32(col + half)))]:
            count += 1
            ci, ri = np.int32(col), np.int32(row)
            fc, fr = col - np.float32(ci), row - np.float32(ri)
            k = np.uint64(anchor + np.int32(ri * stride + ci))
            low = height[k] + (height[k + one] - height[k]) * fc
            high = height[k + up] + (height[k + up + one] - height[k + up]) * fc
            z = low + (high - low) * fr
            top = z if z > top else top
    return top, count


@njit(cache=True, error_model="numpy")
def _count(trusted, anchor, stride, u, v, first, last, c, s, col0, row0) -> int:
    """How many of the samples first..last - 1 have a trusted nearest cell."""
    half = np.float32(0.5)
    total = 0
    for i in range(first, last):
        k = np.uint64(i)
        col = col0 + (u[k] * c - v[k] * s)
        row = row0 + (u[k] * s + v[k] * c)
        total += trusted[np.uint64(anchor + np.int32(np.int32(row + half) * stride + np.int32(col + half)))]
    return total


@njit(cache=True, error_model="numpy")
def _trusted_corner(trusted, anchor, stride, u, v, first, n, c, s, col0, row0, z) -> tuple[float, int]:
    """Sum and number of the trusted samples of a corner whose heights stand in `z`; the others become -inf there."""
    half = np.float32(0.5)
    total = 0.0
    count = 0
    for i in range(first, first + n):
        k = np.uint64(i)
        col = col0 + (u[k] * c - v[k] * s)
        row = row0 + (u[k] * s + v[k] * c)
        if trusted[np.uint64(anchor + np.int32(np.int32(row + half) * stride + np.int32(col + half)))]:
            count += 1
            total += z[k]
        else:
            z[k] = np.float32(-np.inf)
    return total, count


@njit(cache=True, error_model="numpy")
def _largest(z, n: int) -> float:
    """Maximum of the first `n`, folding the array onto itself: vector code whatever NaN means. Overwrites `z`."""
    while n > 1:
        half = (n + 1) // 2
        for i in range(n - half):
            z[i] = z[i] if z[i] > z[i + half] else z[i + half]
        n = half
    return z[0]


@njit(cache=True, error_model="numpy")
def features_of(sampler: Sampler, work: Scratch, poses: np.ndarray, out: np.ndarray) -> None:
    """Features of the first n poses x, y [m], yaw [rad] (>= n, 3) into `out` (n, 4) (paper eq. 2).

    Support difference [m], side tilt [deg], interference [m], unknown share [-]. Only the highest trusted point and
    the trusted count matter between the corners: the samples of a tile are looked at only where one of its cells is
    higher than what was found, or only some of its cells are trusted.
    """
    # Everything is taken out of the tuples once: each access in the loop would count references.
    height, pair, trusted, seen, ceiling, known, stride, ox, oy, inv, u, v, k = sampler[:13]
    corner_u, corner_v, corner_window, tile, tile_u, tile_v, reach, width = sampler[13:]
    cell, cols_at, rows_at, low2, high2, z, spot, mean = work[:8]
    low, high = low2.view(np.float32), high2.view(np.float32)
    rows = seen.shape[0] - 1
    n = u.size
    side = 2 * reach + 2
    box = (2 * corner_window + 1) ** 2
    step = np.int32(stride)
    half = np.float32(0.5)
    for p in range(out.shape[0]):
        # Where nothing under the body is trusted.
        out[p, 0] = out[p, 1] = out[p, 2] = 0.0
        out[p, 3] = 1.0
        col0, row0 = (poses[p, 0] - ox) * inv, (poses[p, 1] - oy) * inv
        if not (reach < col0 < stride - reach - 2 and reach < row0 < rows - reach - 2):
            continue  # beyond the padding
        c0, r0 = int(col0) - reach, int(row0) - reach
        window = seen[r0 + side, c0 + side] - seen[r0, c0 + side] - seen[r0 + side, c0] + seen[r0, c0]
        if window == 0:
            continue
        anchor = r0 * stride + c0
        c, s = np.float32(np.cos(poses[p, 2])), np.float32(np.sin(poses[p, 2]))
        col, row = np.float32(col0 - c0), np.float32(row0 - r0)
        _place(step, u, v, 4 * k, c, s, col, row, cell, cols_at, rows_at)
        _load(pair, anchor, step, 4 * k, cell, low2, high2)
        _interpolate(low, high, 4 * k, cols_at, rows_at, z)
        for m in range(4):
            total = 0.0
            for i in range(k // 2):  # two at a time: half the additions that wait for each other
                total += np.float64(z[np.uint64(m * k + i)]) + np.float64(z[np.uint64(m * k + k // 2 + i)])
            if k % 2:
                total += z[m * k + k - 1]
            mean[m] = total / k
        count = n
        if window < side * side:
            count = 0
            for m in range(4):
                west = c0 + int(col + (corner_u[m] * c - corner_v[m] * s) + half) - corner_window
                south = r0 + int(row + (corner_u[m] * s + corner_v[m] * c) + half) - corner_window
                east, north = west + 2 * corner_window + 1, south + 2 * corner_window + 1
                inside = seen[north, east] - seen[south, east] - seen[north, west] + seen[south, west]
                if inside == box:
                    count += k
                elif inside == 0:
                    z[m * k : m * k + k] = np.float32(-np.inf)
                else:
                    total, here = _trusted_corner(trusted, anchor, step, u, v, m * k, k, c, s, col, row, z)
                    count += here
                    # A corner without a trusted sample keeps the mean of all its heights.
                    mean[m] = total / here if here > 0 else mean[m]
        top = max(max(mean[0], mean[1]), max(mean[2], mean[3]))
        highest = max(top, _largest(z, 4 * k))
        _spots(step, tile_u, tile_v, c, s, col, row, cols_at, rows_at, spot)
        if window == side * side:
            for t in range(tile_u.size):
                if ceiling[np.uint64(anchor + spot[t])] > highest:
                    peak = _tile_top(height, anchor, step, u, v, tile[t], tile[t + 1], c, s, col, row)
                    highest = max(highest, peak)
        else:
            for t in range(tile_u.size):
                at = np.uint64(anchor + spot[t])
                kind, first, last = known[at], tile[t], tile[t + 1]
                if kind == NONE:
                    continue
                if ceiling[at] <= highest:
                    here = last - first
                    if kind == SOME:
                        here = _count(trusted, anchor, step, u, v, first, last, c, s, col, row)
                elif kind == ALL:
                    peak = _tile_top(height, anchor, step, u, v, first, last, c, s, col, row)
                    here = last - first
                    highest = max(highest, peak)
                else:
                    peak, here = _trusted_tile(
                        height, trusted, anchor, step, u, v, first, last, c, s, col, row
                    )
                    highest = max(highest, peak)
                count += here
            if count == 0:
                continue
        out[p, 0] = abs((mean[0] + mean[1]) - (mean[2] + mean[3])) * 0.5
        side_drop = abs((mean[0] + mean[2]) - (mean[1] + mean[3])) * 0.5
        out[p, 1] = np.degrees(np.arctan2(side_drop, width))
        out[p, 2] = highest - top
        out[p, 3] = 1.0 - count / n


@njit(cache=True)
def poses_features(sampler: Sampler, poses: np.ndarray) -> np.ndarray:
    """`features_of` with its own buffers; returns (n, 4)."""
    out = np.empty((poses.shape[0], 4))
    features_of(sampler, scratch(sampler), poses, out)
    return out
