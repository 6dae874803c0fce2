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


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """An elevation grid made ready for footprint samples: filled, padded with untrusted edge values."""

    height: NDArray[np.float32]
    """(rows, cols) [m], no NaN."""
    trusted: NDArray[np.uint8]
    """(rows, cols) 1 = trusted; 0 in the padding."""
    origin: tuple[float, float]
    """x, y [m] of the centre of padded cell [0, 0]."""
    resolution: float
    """Cell size [m]."""

    @classmethod
    def from_grid(cls, grid: ElevationGrid, margin: float) -> Terrain:
        """Pad by `margin` [m] and two cells, so that a pose on the grid's edge never needs a bounds check."""
        pad = int(np.ceil(margin / grid.resolution)) + 2
        height = np.pad(fill_unknown(grid.height), pad, mode="edge")
        trusted = np.pad((grid.trusted & np.isfinite(grid.height)).astype(np.uint8), pad)
        x, y = grid.origin
        step = pad * grid.resolution
        return cls(height, trusted, (x - step, y - step), grid.resolution)

    def laid(self, length: float, width: float) -> Laid:
        """Kernel arguments for a body of this length and width [m]."""
        return Laid(
            self.height,
            self.trusted,
            self.origin[0],
            self.origin[1],
            1.0 / self.resolution,
            offsets(length, self.resolution),
            offsets(width, self.resolution),
        )


def offsets(side: float, resolution: float) -> NDArray[np.float64]:
    """Evenly spaced sample offsets over one side of the body, both ends in: ceil(side / resolution) + 1 of them."""
    # The small slack keeps a side that is a whole number of cells from gaining a sample by float rounding.
    return np.linspace(-side / 2, side / 2, int(np.ceil(side / resolution - 1e-9)) + 1)


class Laid(NamedTuple):
    """Terrain and footprint samples as the kernels take them."""

    height: NDArray[np.float32]
    trusted: NDArray[np.uint8]
    ox: float
    oy: float
    inv: float
    """1 / resolution [1/m]."""
    sx: NDArray[np.float64]
    sy: NDArray[np.float64]
    """Sample offsets along and across the body [m]."""


@njit(cache=True)
def pose_feature(laid: Laid, x: float, y: float, yaw: float) -> tuple[float, float, float, float]:
    """Support difference [m], side tilt [deg], interference [m], unknown share [-] of one pose (paper eq. 2)."""
    height, trusted, ox, oy, inv, sx, sy = laid
    width = sy[sy.size - 1] - sy[0]
    band_x = (sx[sx.size - 1] - sx[0]) / 4 - 1e-9
    band_y = width / 4 - 1e-9
    rows, cols = height.shape
    c = np.cos(yaw) * inv
    s = np.sin(yaw) * inv
    col0 = (x - ox) * inv
    row0 = (y - oy) * inv
    known_sum = np.zeros(4)
    known_n = np.zeros(4, np.int64)
    any_sum = np.zeros(4)
    any_n = np.zeros(4, np.int64)
    total_known = 0
    z_max = -np.inf
    for a in range(sx.size):
        for b in range(sy.size):
            col = col0 + sx[a] * c - sy[b] * s
            row = row0 + sx[a] * s + sy[b] * c
            col = min(max(col, 0.0), cols - 1.0)
            row = min(max(row, 0.0), rows - 1.0)
            ci = min(int(col), cols - 2)
            ri = min(int(row), rows - 2)
            fc = col - ci
            fr = row - ri
            low = height[ri, ci] * (1.0 - fc) + height[ri, ci + 1] * fc
            high = height[ri + 1, ci] * (1.0 - fc) + height[ri + 1, ci + 1] * fc
            z = low * (1.0 - fr) + high * fr
            ok = trusted[int(row + 0.5), int(col + 0.5)] != 0
            if ok:
                total_known += 1
                z_max = max(z_max, z)
            if abs(sx[a]) >= band_x and abs(sy[b]) >= band_y:
                corner = (0 if sx[a] > 0.0 else 2) + (0 if sy[b] > 0.0 else 1)
                any_sum[corner] += z
                any_n[corner] += 1
                if ok:
                    known_sum[corner] += z
                    known_n[corner] += 1
    if total_known == 0:
        return 0.0, 0.0, 0.0, 1.0
    mean = np.empty(4)
    for k in range(4):
        mean[k] = known_sum[k] / known_n[k] if known_n[k] > 0 else any_sum[k] / any_n[k]
    fl, fr_, bl, br = mean[0], mean[1], mean[2], mean[3]
    d_fb = abs((fl + fr_) - (bl + br)) * 0.5
    a_lr = np.degrees(np.arctan2(abs((fl + bl) - (fr_ + br)) * 0.5, width))
    p_int = max(0.0, z_max - max(max(fl, fr_), max(bl, br)))
    return d_fb, a_lr, p_int, 1.0 - total_known / (sx.size * sy.size)


@njit(cache=True)
def poses_features(laid: Laid, poses: np.ndarray) -> np.ndarray:
    """`pose_feature` for every row x, y, yaw of `poses` (n, 3); returns (n, 4)."""
    out = np.empty((poses.shape[0], 4))
    for i in range(poses.shape[0]):
        f = pose_feature(laid, poses[i, 0], poses[i, 1], poses[i, 2])
        for k in range(4):
            out[i, k] = f[k]
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
def _steps(laid: Laid, poses: np.ndarray) -> np.ndarray:
    height, trusted, ox, oy, inv, sx, sy = laid
    rows, cols = height.shape
    out = np.zeros(poses.shape[0])
    for i in range(poses.shape[0]):
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        for a in range(sx.size):
            for b in range(sy.size):
                col = int((poses[i, 0] + sx[a] * c - sy[b] * s - ox) * inv + 0.5)
                row = int((poses[i, 1] + sx[a] * s + sy[b] * c - oy) * inv + 0.5)
                if col < 0 or row < 0 or col > cols - 2 or row > rows - 2 or not trusted[row, col]:
                    continue
                z = height[row, col]
                if trusted[row, col + 1]:
                    out[i] = max(out[i], abs(height[row, col + 1] - z))
                if trusted[row + 1, col]:
                    out[i] = max(out[i], abs(height[row + 1, col] - z))
    return out


def steps_under(
    terrain: Terrain, poses: NDArray[np.float64], length: float, width: float
) -> NDArray[np.float64]:
    """(n,) largest height difference [m] between trusted neighbour cells under the body, per pose (n, 3)."""
    return _steps(terrain.laid(length, width), np.ascontiguousarray(poses, dtype=np.float64))
