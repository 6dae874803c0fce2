"""Parts of a grid are the grid."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.grid import ElevationGrid


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    points=st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=4),
    margin=st.floats(0.0, 2.0),
)
def test_what_lies_around_points_keeps_its_place(
    seed: int, points: list[tuple[float, float]], margin: float
) -> None:
    random = np.random.default_rng(seed)
    height = random.normal(size=(40, 60)).astype(np.float32)
    grid = ElevationGrid(height, random.random(height.shape) < 0.5, (-3.0, -2.0), 0.1)
    xy = np.array(points)
    part = grid.around(xy, margin)
    c0, r0 = (round(v) for v in (np.array(part.origin) - grid.origin) / 0.1)
    rows, cols = part.shape
    assert np.array_equal(part.height, height[r0 : r0 + rows, c0 : c0 + cols])
    assert np.array_equal(part.trusted, grid.trusted[r0 : r0 + rows, c0 : c0 + cols])
    # Every cell of the grid within the margin of the points' box is in it.
    for k, (first, count, whole) in enumerate(((c0, cols, 60), (r0, rows, 40))):
        centre = grid.origin[k] + 0.1 * np.arange(whole)
        near = np.flatnonzero((centre >= xy[:, k].min() - margin) & (centre <= xy[:, k].max() + margin))
        assert all(first <= cell < first + count for cell in near)
