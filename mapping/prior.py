"""Does a prior map fit? Told by the first scans: what stands where the map says ground, and how high the map lies.

A prior map of another place, or a start pose that is not the robot's, looks right on level ground and fails at walls. The
evidence is one-sided: a scan may see less of a wall than the map has, but never something where the map knows ground.
In an arena a map that fits has 0.6 to 1.6 % of such cells among the first 3000, one that lies 0.05 m off 4.6 %, a wrong one 5 to 20 %.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.elevation_kernels import DEPTH, TOP, WEIGHT
from mapping.tiles import LIDAR, PRIOR

ENOUGH = 3000
"""Cells of the prior map that are compared before the verdict is final: later on the world may have changed."""
FEW = 1000
"""Cells below which there is no verdict."""
STANDS = 0.1
"""What is this much higher than the prior map [m] contradicts it."""
MISFIT = 0.03
"""Share of such cells of a map that does not fit."""
LEVEL_OFF = 0.05
"""A map that lies higher or lower than this on the whole [m] is taken at its level: it counts from another start."""


class PriorCheck:
    """Compares the first scans with a prior map, cell by cell, each cell once."""

    def __init__(self) -> None:
        self.tested = 0
        self.higher = 0
        self._levelled = False

    @property
    def done(self) -> bool:
        """The verdict is final."""
        return self.tested >= ENOUGH

    @property
    def warning(self) -> str:
        """Words for the operator; empty while nothing speaks against the map."""
        if self.tested < FEW or self.higher <= MISFIT * self.tested:
            return ""
        return (
            f"the prior map does not fit: things stand on {self.higher / self.tested:.0%} of the ground it knows; "
            "wrong file or start pose: start again with the right one, or without a prior map"
        )

    def level(self, cells: NDArray[np.void], which: NDArray[np.int64], sums: NDArray[np.float32]) -> float:
        """How much higher the first scan that meets the prior map lies on the whole [m]; 0 from then on, and within noise.

        cells: of the store; which (k,) and sums (k, 8): the scan, see `elevation_kernels.reduce_cells`.
        """
        if self._levelled:
            return 0.0
        off = _differences(cells, which, sums)[1]
        if len(off) < FEW // 2:
            return 0.0
        self._levelled = True
        middle = float(np.median(off))
        one_level = float(np.median(np.abs(off - middle))) < LEVEL_OFF
        return middle if one_level and abs(middle) > LEVEL_OFF else 0.0

    def take(self, cells: NDArray[np.void], which: NDArray[np.int64], sums: NDArray[np.float32]) -> None:
        """Compare one scan; see `level`. The cells it met no longer count as those of a prior map."""
        met, off = _differences(cells, which, sums)
        self.tested += len(off)
        self.higher += int(np.count_nonzero(off > STANDS))
        cells["seen"][met] = 0


def _differences(
    cells: NDArray[np.void], which: NDArray[np.int64], sums: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Cells (n,) of the prior map not met before, and how much higher the scan lies there (n,) [m]."""
    met = cells[which]
    new = (met["source"] == LIDAR) & (met["seen"] == PRIOR)
    rows = sums[new]
    return which[new], rows[:, TOP] + rows[:, DEPTH] / rows[:, WEIGHT] - met["height"][new]
