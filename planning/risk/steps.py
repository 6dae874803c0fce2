"""The highest step under the oriented body: what its wheels have to climb, whatever the mean of the ground says."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.risk.terrain import Terrain


@njit(cache=True)
def _steps(
    height: np.ndarray,
    trusted: np.ndarray,
    stride: int,
    u: np.ndarray,
    v: np.ndarray,
    ox: float,
    oy: float,
    inv: float,
    poses: np.ndarray,
) -> np.ndarray:
    rows = height.size // stride
    one, up = np.uint64(1), np.uint64(stride)
    out = np.zeros(poses.shape[0])
    for i in range(poses.shape[0]):
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        col0, row0 = (poses[i, 0] - ox) * inv, (poses[i, 1] - oy) * inv
        best = np.float32(0.0)
        for k in range(u.size):
            col = int(np.floor(col0 + u[k] * c - v[k] * s + 0.5))
            row = int(np.floor(row0 + u[k] * s + v[k] * c + 0.5))
            if col < 1 or row < 1 or col > stride - 2 or row > rows - 2:
                continue
            at = np.uint64(row * stride + col)  # unsigned: no wrap-around test for negative indices
            if not trusted[at]:
                continue
            here = height[at]
            for other in (at - one, at + one, at - up, at + up):
                if trusted[other]:
                    step = abs(height[other] - here)
                    best = step if step > best else best
        out[i] = best
    return out


def steps_under(
    terrain: Terrain, poses: NDArray[np.float64], length: float, width: float
) -> NDArray[np.float64]:
    """(n,) largest height difference [m] between trusted neighbour cells, one or both under the body, per pose (n,
    3)."""
    height, trusted = terrain.height.reshape(-1), terrain.trusted.reshape(-1)
    at = *terrain.places(length, width), *terrain.origin, 1.0 / terrain.resolution
    out: NDArray[np.float64] = _steps(
        height, trusted, terrain.height.shape[1], *at, np.ascontiguousarray(poses, np.float64)
    )
    return out
