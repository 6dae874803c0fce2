"""Grass and bushes: boxes that a ray may pass through. It stops inside with the same probability on every metre.

The distance to the first leaf is exponential (Beer-Lambert law): a share exp(-density * way) of the rays comes out at
the far side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Clump:
    """An upright box of leaves. The LiDAR sees it, wheels and body do not feel it."""

    centre: tuple[float, float, float]
    """[m], world."""
    size: tuple[float, float, float]
    """Full lengths along x, y, z [m]."""
    density: float
    """Leaves met per metre of way: 3 lets 22 % of the rays through half a metre."""


def pack_clumps(clumps: Sequence[Clump]) -> NDArray[np.float64]:
    """Rows (m, 7) for `cast_clumps`: lowest corner, highest corner, density."""
    out = np.zeros((len(clumps), 7))
    for row, clump in zip(out, clumps, strict=True):
        half = 0.5 * np.asarray(clump.size)
        row[:3], row[3:6], row[6] = clump.centre - half, clump.centre + half, clump.density
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def cast_clumps(
    clumps: NDArray[np.float64],
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    draw: NDArray[np.float32],
    ranges: NDArray[np.float32],
    hit: NDArray[np.bool_],
) -> None:
    """Lower `ranges` (n,) [m] to the first leaf on each ray, and set `hit` (n,) there.

    Rows of `clumps` (m, 7): see `pack_clumps`; they must not overlap. `draw` (m, n): uniform in [0, 1), one for each
    clump and ray."""
    for k in range(clumps.shape[0]):
        c = clumps[k]
        for i in range(origins.shape[0]):
            near, far = 0.0, float(ranges[i])
            for a in range(3):
                d = float(directions[i, a])
                d = d if abs(d) > 1e-12 else 1e-12
                p, q = (c[a] - origins[i, a]) / d, (c[3 + a] - origins[i, a]) / d
                near, far = max(near, min(p, q)), min(far, max(p, q))
            if near < far:
                at = near - np.log(1.0 - draw[k, i]) / c[6]
                if at < far:
                    ranges[i] = at
                    hit[i] = True
