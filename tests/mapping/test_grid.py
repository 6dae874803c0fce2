"""Parts of a grid are the grid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from mapping.grid import ElevationGrid, GridError
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.wire.convert import LayoutError, map_patch, patch_msg


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


@pytest.mark.parametrize("hole", [np.nan, np.inf, -np.inf])
def test_a_cell_without_a_height_is_not_trusted_whatever_its_flag_says(hole: float) -> None:
    height = np.zeros((3, 4), np.float32)
    height[1, 2] = hole
    grid = ElevationGrid(height, np.ones((3, 4), np.bool_), (0.0, 0.0), 0.1)
    assert not grid.trusted[1, 2]
    assert grid.trusted.sum() == 11


@pytest.mark.parametrize("origin", [(5e6, 0.0), (0.0, -5e6), (4.5e5, 5.4e6)])
def test_coordinates_of_utm_are_refused_with_what_to_do(origin: tuple[float, float]) -> None:
    """Heights and places of single precision would be half a metre off there, in silence."""
    flat = np.zeros((3, 3), np.float32)
    with pytest.raises(GridError, match="subtract"):
        ElevationGrid(flat, np.ones((3, 3), np.bool_), origin, 0.04)
    with pytest.raises(ConfigError, match="subtract"):
        load(None, [], origin=(*origin, 0.0))
    load(None, [], origin=(49_000.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="subtract"):
        load(None, [], origin=(51_000.0, 0.0, 0.0))
    ElevationGrid(flat, np.ones((3, 3), np.bool_), (99_000.0, 0.0), 0.04)
    with pytest.raises(GridError, match="subtract"):
        ElevationGrid(flat, np.ones((3, 3), np.bool_), (101_000.0, 0.0), 0.04)
    layers = dict.fromkeys(PATCH_LAYERS, flat)
    with pytest.raises(LayoutError):
        map_patch(patch_msg(MapPatch(origin, 0.04, 1, 0, layers)), 0)
