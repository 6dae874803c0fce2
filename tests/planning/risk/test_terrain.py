"""The terrain that follows a grid is that made of the grid."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.risk.terrain import Terrain

MARGIN, LENGTH, WIDTH = 0.41, 0.7, 0.43
WINDOW = 3
"""Cells at the border of the padding, where no tile of samples lies."""


def changed_grid(rng: np.random.Generator, grid: ElevationGrid, unknown: bool) -> ElevationGrid:
    """With a patch or two of other heights, of other trust, or not known any more."""
    height, trusted, (rows, cols) = grid.height.copy(), grid.trusted.copy(), grid.shape
    for _ in range(int(rng.integers(0, 3))):
        r, c = int(rng.integers(-4, rows)), int(rng.integers(-4, cols))
        part = np.s_[max(r, 0) : r + int(rng.integers(5, 12)), max(c, 0) : c + int(rng.integers(5, 12))]
        kind = rng.integers(0, 3 + unknown)
        if kind < 2:
            height[part] += rng.normal(0.0, 0.3, height[part].shape)
        if kind > 0:
            trusted[part] = rng.random(trusted[part].shape) < 0.7
        if kind == 3:
            height[part] = np.nan
    return ElevationGrid(height, trusted, grid.origin, grid.resolution)


@pytest.mark.parametrize("seed", range(12))
def test_what_is_brought_up_to_date_is_what_is_made_anew(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(20, 60, 2))
    grid = ElevationGrid(
        rng.normal(size=shape).astype(np.float32), rng.random(shape) < 0.9, (1.0, -2.0), 0.05
    )
    terrain = Terrain.from_grid(grid, MARGIN)
    sampler = terrain.sampler(LENGTH, WIDTH)
    for _ in range(8):
        before = terrain.height.copy(), terrain.trusted.copy()
        grid = changed_grid(rng, grid, unknown=seed % 2 > 0)
        changed = terrain.follow(grid)
        assert changed is not None
        fresh = Terrain.from_grid(grid, MARGIN)
        for name in ("height", "trusted", "seen"):
            np.testing.assert_array_equal(getattr(terrain, name), getattr(fresh, name))
        assert terrain.sampler(LENGTH, WIDTH) is sampler
        inner = np.s_[WINDOW:-WINDOW, WINDOW:-WINDOW]
        for name, got, want in zip(sampler._fields, sampler, fresh.sampler(LENGTH, WIDTH), strict=True):
            if name in ("ceiling", "known"):
                got, want = (a.reshape(terrain.height.shape)[inner] for a in (got, want))
            np.testing.assert_array_equal(got, want, err_msg=name)
        differs = (before[0] != fresh.height) | (before[1] != fresh.trusted)
        told = np.zeros(differs.shape, bool)
        told[
            changed.row : changed.row + changed.cells.shape[0],
            changed.col : changed.col + changed.cells.shape[1],
        ] = changed.cells
        inside = np.s_[terrain.pad : -terrain.pad, terrain.pad : -terrain.pad]
        np.testing.assert_array_equal(told[inside], differs[inside])


def test_a_grid_of_other_cells_is_not_followed() -> None:
    z, known = np.zeros((20, 30), np.float32), np.ones((20, 30), bool)
    grid = ElevationGrid(z, known, (0.0, 0.0), 0.05)
    terrain = Terrain.from_grid(grid, MARGIN)
    for other in (
        ElevationGrid(z[1:], known[1:], (0.0, 0.0), 0.05),
        ElevationGrid(z, known, (0.05, 0.0), 0.05),
        ElevationGrid(z, known, (0.0, 0.0), 0.04),
    ):
        assert terrain.follow(other) is None
        assert terrain.grid is grid
