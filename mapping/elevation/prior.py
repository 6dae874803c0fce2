"""Does a prior map fit? The first scans tell: something stands where the map has ground.

A prior map of another place, or a wrong start pose, looks right on level ground and fails at walls. The evidence is
one-sided: a scan may see less of a wall than the map has, but nothing stands where the map knows ground all around.

Share of such cells among the first 3000 in the arena: none for a map that fits, 0.9 and 1.6 % for one that is 0.1 m
or 2 deg off, 1.6 to 8 % for one farther off. In lanes that fit it is up to 0.4 %. An offset of 0.05 m may go
unnoticed: it is hardly more than a cell."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.elevation.fusion import DEPTH, TOP, WEIGHT
from mapping.elevation.tile_kernels import base_of
from mapping.elevation.tiles import LIDAR, PRIOR, TileStore

ENOUGH_CELLS = 3000
"""Cells of the prior map that are compared before the verdict is final: later on the world may have changed."""
FEW_CELLS = 1000
"""Cells below which there is no verdict."""
STANDING_HEIGHT = 0.1
"""What is this much higher than a cell of the prior map and its neighbours [m] contradicts it."""
KNOWN_CELLS = 6
"""Cells of the 3 x 3 that must be known for a comparison: where a wall's foot was never seen it may stand."""
CELLS_BESIDE = 2
"""Cells within which the same scan must contradict once more. Behind the upper edge of a wall single points lie in
the air, where a beam meets both the edge and what is behind it: in lanes they were up to 1.3 % of the cells."""
MISFIT_SHARE = 0.006
"""Share of such cells of a map that does not fit."""


class PriorCheck:
    """Compares the first scans with a prior map, cell by cell, each cell once."""

    def __init__(self) -> None:
        self.tested = 0
        self.higher = 0

    @property
    def done(self) -> bool:
        """The verdict is final."""
        return self.tested >= ENOUGH_CELLS

    @property
    def warning(self) -> str:
        """Words for the operator; empty while nothing speaks against the map."""
        if self.tested < FEW_CELLS or self.higher <= MISFIT_SHARE * self.tested:
            return ""
        return (
            f"the prior map does not fit: things stand on {self.higher / self.tested:.0%} of the ground it knows; "
            "wrong file or start pose: start again with the right one, or without a prior map"
        )

    def take(self, store: TileStore, which: NDArray[np.int64], sums: NDArray[np.float32]) -> None:
        """Compare one scan: which (k,) and sums (k, 8), see `fusion.reduce_cells`. The cells it met no longer count
        as prior."""
        met, higher = _differences(store, which, sums)
        self.tested += len(met)
        self.higher += higher
        store.cells["seen"][met] = 0


def _differences(
    store: TileStore, which: NDArray[np.int64], sums: NDArray[np.float32]
) -> tuple[NDArray[np.int64], int]:
    """Cells (n,) of the prior map not met before, and how many contradict."""
    met = np.empty(len(which), np.int64)
    n, higher = _compare(
        which, sums, store.cells, store.tiles, store.directory, store.first, store.shift, met
    )
    return met[:n], higher


@njit(cache=True)
def _compare(which, sums, cells, tiles, directory, first, shift, met):  # pragma: no cover - compiled
    """See `_differences`; returns n and how many contradict."""
    n = 0
    higher = np.empty((len(which), 3), np.int64)
    high = 0
    mask = (1 << shift) - 1
    for s in range(len(which)):
        index = which[s]
        cell = cells[index]
        if cell.source != LIDAR or cell.seen != PRIOR:
            continue
        slot = index >> (2 * shift)
        i = (np.int64(tiles[slot, 0]) << shift) + ((index >> shift) & mask)
        j = (np.int64(tiles[slot, 1]) << shift) + (index & mask)
        known, top = 0, cell.height
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                base = base_of(directory, first, shift, a >> shift, b >> shift)
                if base >= 0:
                    h = cells[base + ((a & mask) << shift) + (b & mask)].height
                    known += h == h
                    top = h if h > top else top
        if known < KNOWN_CELLS:
            continue
        z = sums[s, TOP] + sums[s, DEPTH] / sums[s, WEIGHT]
        if z - top > STANDING_HEIGHT:
            higher[high, 0], higher[high, 1], higher[high, 2] = i, j, index
            high += 1
        else:
            met[n] = index
            n += 1
    standing = 0
    for s in range(high):
        for k in range(high):
            off = max(abs(higher[s, 0] - higher[k, 0]), abs(higher[s, 1] - higher[k, 1]))
            if 0 < off <= CELLS_BESIDE:
                met[n] = higher[s, 2]
                n += 1
                standing += 1
                break
    return n, standing
