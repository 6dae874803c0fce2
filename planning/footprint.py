"""The robot's oriented footprint laid on the elevation grid: samples, corner means and the four pose features.

Numba kernels on plain arrays; `planning.body_risk` is their face. Paper: Guo, Zhang, Schwertfeger 2026, eq. 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.fill import fill_unknown


class Laid(NamedTuple):
    """Terrain and footprint samples as the kernels take them."""

    height: NDArray[np.float32]
    """(rows * stride,) [m], padded."""
    trusted: NDArray[np.uint8]
    """(rows * stride,) 1 = trusted; 0 in the padding."""
    seen: NDArray[np.int32]
    """(rows + 1, stride + 1) trusted cells above and left of a cell corner (summed-area table)."""
    stride: int
    """Columns of the padded grid."""
    ox: float
    oy: float
    inv: float
    """1 / resolution [1/m]."""
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    """(n,) samples along and across the body [cells]: corners FL, FR, BL, BR, then the rest tile by tile."""
    corner: int
    """Samples per corner."""
    tile: NDArray[np.int32]
    """(t + 1,) where each tile's samples begin."""
    tile_u: NDArray[np.float32]
    tile_v: NDArray[np.float32]
    """(t,) tile centres [cells]."""
    ceiling: NDArray[np.float32]
    """(rows * stride,) no sample of a tile centred in a cell is higher [m]."""
    reach: int
    """Cells from the centre that no sample leaves."""
    width: float
    """Body width [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """An elevation grid made ready for footprint samples: filled, padded with untrusted edge values."""

    height: NDArray[np.float32]
    """(rows, cols) [m], no NaN."""
    trusted: NDArray[np.uint8]
    """(rows, cols) 1 = trusted; 0 in the padding."""
    seen: NDArray[np.int32]
    """(rows + 1, cols + 1) summed-area table of `trusted`."""
    origin: tuple[float, float]
    """x, y [m] of the centre of padded cell [0, 0]."""
    resolution: float
    """Cell size [m]."""
    pad: int
    """Cells of padding on each side."""

    @classmethod
    def from_grid(cls, grid: ElevationGrid, margin: float) -> Terrain:
        """Pad by a little more than twice `margin` [m], the footprint's circumradius.

        A body within `margin` of the grid then lies inside the padding whole, and one farther out touches no
        trusted cell: no sample ever needs a bounds check.
        """
        pad = 2 * int(np.ceil(margin / grid.resolution)) + 3
        trusted = grid.trusted & np.isfinite(grid.height)
        height, padded, seen = _pad(fill_unknown(grid.height), trusted, pad)
        step = pad * grid.resolution
        x, y = grid.origin
        return cls(height, padded, seen, (x - step, y - step), grid.resolution, pad)

    def laid(self, length: float, width: float) -> Laid:
        """Kernel arguments for a body of this length and width [m]."""
        along = offsets(length, self.resolution) / self.resolution
        across = offsets(width, self.resolution) / self.resolution
        u, v = (a.ravel() for a in np.meshgrid(along, across, indexing="ij"))
        limit_u, limit_v = along[-1] / 2 - 1e-6, across[-1] / 2 - 1e-6
        band = (np.abs(u) >= limit_u) & (np.abs(v) >= limit_v)
        # Tiles of 4 x 4 cells outside the corners; numbers below 4 are the corners.
        tile = 4 + np.floor((u - along[0]) / 4).astype(int) * 1000 + np.floor((v - across[0]) / 4).astype(int)
        kind = np.where(band, 2 * (u < 0) + (v < 0), tile)
        order = np.argsort(kind, kind="stable")
        u, v, kind = u[order], v[order], kind[order]
        corner = int((kind == 0).sum())
        starts = np.append(np.flatnonzero((np.diff(kind, prepend=-1) != 0) & (kind > 3)), len(kind))
        size = np.diff(starts)
        centre_u, centre_v = (np.add.reduceat(a, starts[:-1]) / size for a in (u, v))
        away = np.hypot(
            u[4 * corner :] - np.repeat(centre_u, size), v[4 * corner :] - np.repeat(centre_v, size)
        )
        # A sample reads cells less than one cell away, its tile's centre lies within half a cell of a cell centre.
        window = int(np.floor(away.max(initial=0.0) + 1.5))
        return Laid(
            self.height.reshape(-1),
            self.trusted.reshape(-1),
            self.seen,
            self.height.shape[1],
            self.origin[0],
            self.origin[1],
            1.0 / self.resolution,
            u.astype(np.float32),
            v.astype(np.float32),
            corner,
            starts.astype(np.int32),
            centre_u.astype(np.float32),
            centre_v.astype(np.float32),
            _dilate(self.height, window).reshape(-1),
            int(np.ceil(0.5 * np.hypot(length, width) / self.resolution)) + 1,
            width,
        )


@njit(cache=True)
def _dilate(height: np.ndarray, window: int) -> np.ndarray:
    """Largest value within `window` cells in both directions, away from a border of that width."""
    rows, cols = height.shape
    out = height.copy()
    width = 2 * window + 1
    line = np.empty(max(rows, cols), np.float32)
    for r in range(rows):
        line[:cols] = out[r]
        # line[c] becomes the maximum of `have` cells from c on; the last shift brings it to `width`.
        have = 1
        while have < width:
            shift = min(have, width - have)
            for c in range(cols - shift):
                line[c] = line[c] if line[c] > line[c + shift] else line[c + shift]
            have += shift
        out[r, window : cols - window] = line[: cols - 2 * window]
    have = 1
    while have < width:
        shift = min(have, width - have)
        for r in range(rows - shift):
            for c in range(cols):
                out[r, c] = out[r, c] if out[r, c] > out[r + shift, c] else out[r + shift, c]
        have += shift
    for r in range(rows - window - 1, window - 1, -1):
        out[r] = out[r - window]
    return out


@njit(cache=True)
def _pad(height: np.ndarray, trusted: np.ndarray, pad: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows, cols = height.shape
    n, m = rows + 2 * pad, cols + 2 * pad
    out = np.empty((n, m), np.float32)
    ok = np.zeros((n, m), np.uint8)
    seen = np.zeros((n + 1, m + 1), np.int32)
    for r in range(n):
        src = min(max(r - pad, 0), rows - 1)
        out[r, :pad] = height[src, 0]
        out[r, pad : pad + cols] = height[src]
        out[r, pad + cols :] = height[src, cols - 1]
        if r == src + pad:
            for c in range(cols):
                ok[r, pad + c] = trusted[src, c]
        total = 0
        for c in range(m):
            total += ok[r, c]
            seen[r + 1, c + 1] = seen[r, c + 1] + total
    return out, ok, seen


def offsets(side: float, resolution: float) -> NDArray[np.float64]:
    """Evenly spaced sample offsets over one side of the body, both ends in: ceil(side / resolution) + 1 of them."""
    # The small slack keeps a side that is a whole number of cells from gaining a sample by float rounding.
    return np.linspace(-side / 2, side / 2, int(np.ceil(side / resolution - 1e-9)) + 1)


class Scratch(NamedTuple):
    """Buffers of one pose, made once per call: a kernel that allocates per pose spends its time there."""

    cell: NDArray[np.int32]
    fc: NDArray[np.float32]
    fr: NDArray[np.float32]
    corners: NDArray[np.float32]
    """(4, n) heights of the four cells around each sample."""
    z: NDArray[np.float32]
    ok: NDArray[np.uint8]


@njit(cache=True)
def scratch(laid: Laid) -> Scratch:
    """Buffers for `features_of`."""
    n = laid.u.size
    return Scratch(
        np.empty(n, np.int32),
        np.empty(n, np.float32),
        np.empty(n, np.float32),
        np.empty((4, n), np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.uint8),
    )


@njit(cache=True, error_model="numpy")
def _heights_under(
    height, anchor, stride, u, v, c, s, col0, row0, first, last, cell, fc, fr, q0, q1, q2, q3, z
) -> None:
    """Bilinear heights of samples first..last - 1 into `z`: place, gather, interpolate.

    Three passes, because the first and the last then run in vector registers and the middle one is only loads.
    Cells count from an anchor cell (`col0`, `row0` is the pose from there), so single precision resolves a
    millionth of a cell.
    """
    for i in range(first, last):
        col = col0 + (u[i] * c - v[i] * s)
        row = row0 + (u[i] * s + v[i] * c)
        ci = np.int32(col)
        ri = np.int32(row)
        fc[i] = col - np.float32(ci)
        fr[i] = row - np.float32(ri)
        cell[i] = np.int32(ri * stride + ci)
    one, up = np.uint64(1), np.uint64(stride)
    for i in range(first, last):
        k = np.uint64(anchor + cell[i])  # unsigned: no wrap-around test for negative indices
        q0[i] = height[k]
        q1[i] = height[k + one]
        q2[i] = height[k + up]
        q3[i] = height[k + up + one]
    for i in range(first, last):
        low = q0[i] + (q1[i] - q0[i]) * fc[i]
        high = q2[i] + (q3[i] - q2[i]) * fc[i]
        z[i] = low + (high - low) * fr[i]


@njit(cache=True, error_model="numpy")
def _trust_under(trusted, anchor, stride, u, v, c, s, col0, row0, cell, ok) -> int:
    """Trust of the cell nearest to each sample (halves round up) into `ok`; returns how many are trusted."""
    half = np.float32(0.5)
    for i in range(u.size):
        col = col0 + (u[i] * c - v[i] * s)
        row = row0 + (u[i] * s + v[i] * c)
        cell[i] = np.int32(np.int32(row + half) * stride + np.int32(col + half))
    total = 0
    for i in range(u.size):
        ok[i] = trusted[np.uint64(anchor + cell[i])]
        total += ok[i]
    return total


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
def features_of(laid: Laid, work: Scratch, poses: np.ndarray, out: np.ndarray) -> None:
    """Features of poses x, y [m], yaw [rad] (n, 3) into `out` (n, 4) (paper eq. 2).

    Support difference [m], side tilt [deg], interference [m], unknown share [-]. Only the highest point under the
    body matters between the corners, so a tile of samples whose cells are all lower than what was found is skipped.
    """
    # Everything is taken out of the tuples once: each access in the loop would count references.
    height, trusted, seen, stride, ox, oy, inv, u, v, k, tile, tile_u, tile_v, ceiling, reach, width = laid
    cell, fc, fr, corners, z, ok = work
    q0, q1, q2, q3 = corners[0], corners[1], corners[2], corners[3]
    rows = seen.shape[0] - 1
    n = u.size
    side = 2 * reach + 2
    step = np.int32(stride)
    half = np.float32(0.5)
    for p in range(poses.shape[0]):
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
        known = n
        if window < side * side:
            known = _trust_under(trusted, anchor, step, u, v, c, s, col, row, cell, ok)
            if known == 0:
                continue
        _heights_under(height, anchor, step, u, v, c, s, col, row, 0, 4 * k, cell, fc, fr, q0, q1, q2, q3, z)
        s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
        for i in range(k):
            s0 += z[i]
            s1 += z[k + i]
            s2 += z[2 * k + i]
            s3 += z[3 * k + i]
        n0 = n1 = n2 = n3 = k
        if known < n:
            m0 = m1 = m2 = m3 = 0
            t0, t1, t2, t3 = 0.0, 0.0, 0.0, 0.0
            for i in range(k):
                t0 += z[i] * ok[i]
                t1 += z[k + i] * ok[k + i]
                t2 += z[2 * k + i] * ok[2 * k + i]
                t3 += z[3 * k + i] * ok[3 * k + i]
                m0 += ok[i]
                m1 += ok[k + i]
                m2 += ok[2 * k + i]
                m3 += ok[3 * k + i]
            # A corner without a trusted sample keeps the mean of all its heights.
            s0, n0 = (t0, m0) if m0 > 0 else (s0, k)
            s1, n1 = (t1, m1) if m1 > 0 else (s1, k)
            s2, n2 = (t2, m2) if m2 > 0 else (s2, k)
            s3, n3 = (t3, m3) if m3 > 0 else (s3, k)
            for i in range(4 * k):
                z[i] = z[i] if ok[i] else np.float32(-np.inf)
        front_left, front_right, back_left, back_right = s0 / n0, s1 / n1, s2 / n2, s3 / n3
        top = max(max(front_left, front_right), max(back_left, back_right))
        highest = max(top, _largest(z, 4 * k))
        for t in range(tile_u.size):
            at_c = np.int32(col + (tile_u[t] * c - tile_v[t] * s) + half)
            at_r = np.int32(row + (tile_u[t] * s + tile_v[t] * c) + half)
            if ceiling[np.uint64(anchor + at_r * stride + at_c)] <= highest:
                continue
            a, b = tile[t], tile[t + 1]
            _heights_under(height, anchor, step, u, v, c, s, col, row, a, b, cell, fc, fr, q0, q1, q2, q3, z)
            for i in range(a, b):
                if z[i] > highest and (known == n or ok[i]):
                    highest = z[i]
        out[p, 0] = abs((front_left + front_right) - (back_left + back_right)) * 0.5
        side_drop = abs((front_left + back_left) - (front_right + back_right)) * 0.5
        out[p, 1] = np.degrees(np.arctan2(side_drop, width))
        out[p, 2] = highest - top
        out[p, 3] = 1.0 - known / n


@njit(cache=True)
def poses_features(laid: Laid, poses: np.ndarray) -> np.ndarray:
    """`features_of` with its own buffers; returns (n, 4)."""
    out = np.empty((poses.shape[0], 4))
    features_of(laid, scratch(laid), poses, out)
    return out


@njit(cache=True)
def _heights(height: np.ndarray, ox: float, oy: float, inv: float, xy: np.ndarray) -> np.ndarray:
    rows, cols = height.shape
    out = np.empty(xy.shape[0])
    for i in range(xy.shape[0]):
        col = min(max((xy[i, 0] - ox) * inv, 0.0), cols - 1.0)
        row = min(max((xy[i, 1] - oy) * inv, 0.0), rows - 1.0)
        c, r = min(int(col), cols - 2), min(int(row), rows - 2)
        fc, fr = col - c, row - r
        low = height[r, c] * (1.0 - fc) + height[r, c + 1] * fc
        high = height[r + 1, c] * (1.0 - fc) + height[r + 1, c + 1] * fc
        out[i] = low * (1.0 - fr) + high * fr
    return out


def heights_at(terrain: Terrain, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) bilinear ground height [m] at x, y (n, 2)."""
    return _heights(
        terrain.height,
        terrain.origin[0],
        terrain.origin[1],
        1.0 / terrain.resolution,
        np.ascontiguousarray(xy),
    )


@njit(cache=True)
def steps_beneath(laid: Laid, poses: np.ndarray) -> np.ndarray:
    """(n,) largest height difference [m] between trusted neighbour cells under the body, per pose (n, 3)."""
    height, trusted, stride = laid.height, laid.trusted, laid.stride
    rows = height.size // stride
    out = np.zeros(poses.shape[0])
    for i in range(poses.shape[0]):
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        col0, row0 = (poses[i, 0] - laid.ox) * laid.inv, (poses[i, 1] - laid.oy) * laid.inv
        for k in range(laid.u.size):
            col = int(col0 + laid.u[k] * c - laid.v[k] * s + 0.5)
            row = int(row0 + laid.u[k] * s + laid.v[k] * c + 0.5)
            at = row * stride + col
            if col < 0 or row < 0 or col > stride - 2 or row > rows - 2 or not trusted[at]:
                continue
            if trusted[at + 1]:
                out[i] = max(out[i], abs(height[at + 1] - height[at]))
            if trusted[at + stride]:
                out[i] = max(out[i], abs(height[at + stride] - height[at]))
    return out


def steps_under(
    terrain: Terrain, poses: NDArray[np.float64], length: float, width: float
) -> NDArray[np.float64]:
    """(n,) largest height difference [m] between trusted neighbour cells under the body, per pose (n, 3)."""
    return steps_beneath(terrain.laid(length, width), np.ascontiguousarray(poses, dtype=np.float64))
