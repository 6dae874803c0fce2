"""Largest values of squares, closing and what squares of unknown cells cover, against loops over every square."""

from __future__ import annotations

import numpy as np
import pytest

from planning.graph.closing import closed, covered, largest


def by_loop(values: np.ndarray, m: int, back: bool) -> np.ndarray:
    """One axis after the other, as the kernel says it."""
    out = values.copy()
    for axis in (0, 1):
        before = out.copy()
        for index in np.ndindex(out.shape):
            low = index[axis] - (m - 1 if back else 0)
            line = np.take(before, range(max(0, low), min(out.shape[axis], low + m)), axis)
            across = line[:, index[1]] if axis == 0 else line[index[0]]
            out[index] = np.nan if np.isnan(values[index]) else np.nanmax(across)
    return out


@pytest.mark.parametrize("m", [1, 2, 4, 6, 7])
@pytest.mark.parametrize("shape", [(9, 11), (3, 12), (12, 2)])
@pytest.mark.parametrize("back", [False, True])
def test_the_largest_of_squares_is_that_of_a_loop(m: int, shape: tuple[int, int], back: bool) -> None:
    random = np.random.default_rng(m)
    values = random.standard_normal(shape).astype(np.float32)
    values[random.random(shape) < 0.15] = np.nan
    np.testing.assert_array_equal(largest(values, m, back), by_loop(values, m, back))


def test_closing_fills_what_is_narrower_and_keeps_what_is_as_wide() -> None:
    z = np.zeros((12, 20), np.float32)
    z[:, 4:7] = z[:, 12:16] = -1.0
    want = z.copy()
    want[:, 4:7] = 0.0
    np.testing.assert_array_equal(closed(z, 4), want)


def test_a_square_of_unknown_cells_covers_its_cells_and_nothing_else() -> None:
    trusted = np.random.default_rng(1).random((14, 17)) < 0.12
    want = np.zeros(trusted.shape, np.float32)
    for r in range(12):
        for c in range(15):
            if not trusted[r : r + 3, c : c + 3].any():
                want[r : r + 3, c : c + 3] = 1.0
    assert 0 < want.sum() < want.size
    np.testing.assert_array_equal(covered(trusted, 3), want)
