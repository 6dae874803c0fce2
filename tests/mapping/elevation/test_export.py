"""Maps for other programs: what is written reads as the same ground, in the same place."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from hal.scenes import load_scene
from hal.scenes.readers import read_geometry
from mapping.elevation import ElevationConfig, ElevationMap, MapError
from mapping.elevation.export import Limits, traversal_cost, whole, write
from mapping.grid import ElevationGrid

LIMITS = Limits(max_step=0.2, max_slope=math.radians(30.0))


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> ElevationMap:
    """4 x 3 m from (1.0, -2.0) on: a ramp along x, a wall, a hole that nobody saw."""
    height = np.tile(0.1 * np.arange(100, dtype=np.float32) * 0.04, (75, 1))
    height[60:64, 20:60] = 1.0
    height[10:20, 70:90] = np.nan
    elevation = ElevationMap(ElevationConfig())
    file = tmp_path_factory.mktemp("ground") / "g.npz"
    np.savez(file, height=height, resolution=0.04, origin=(1.0, -2.0))
    elevation.load_prior(file)
    return elevation


def test_heights_come_back_from_each_file_in_their_place(ground: ElevationMap, tmp_path: Path) -> None:
    grid = whole(ground)
    known = int(np.isfinite(grid.height).sum())
    assert grid.origin == pytest.approx((1.0, -2.0), abs=1e-6)
    for name in ("a.npz", "a.tif", "a.pcd"):
        assert write(ground, tmp_path / name, LIMITS) == known
    again = ElevationMap(ElevationConfig())
    again.load_prior(tmp_path / "a.npz")
    np.testing.assert_array_equal(whole(again).height, grid.height)
    scene = load_scene(tmp_path / "a.tif", start=(2.0, -1.0, 0.0))
    assert (scene.origin, scene.resolution) == (pytest.approx(grid.origin, abs=1e-6), pytest.approx(0.04))
    np.testing.assert_allclose(scene.survey, grid.height, atol=1e-6)
    row, col = np.nonzero(np.isfinite(grid.height))
    places = np.column_stack([1.0 + 0.04 * col, -2.0 + 0.04 * row, grid.height[row, col]])
    np.testing.assert_allclose(read_geometry(tmp_path / "a.pcd").vertices, places, atol=1e-5)


def test_an_occupancy_grid_is_as_map_server_reads_it(ground: ElevationMap, tmp_path: Path) -> None:
    write(ground, tmp_path / "m.png", LIMITS)
    told = yaml.safe_load((tmp_path / "m.yaml").read_text())
    pixels = np.asarray(Image.open(tmp_path / told["image"]))

    def at(x: float, y: float) -> int:
        col, row = ((v - o) / told["resolution"] for v, o in zip((x, y), told["origin"], strict=False))
        return int(pixels[pixels.shape[0] - 1 - int(row), int(col)])

    assert at(2.0, -1.0) == 254
    assert at(1.0 + 0.04 * 20, -2.0 + 0.04 * 62) == 0, "the edge of the wall"
    assert at(1.0 + 0.04 * 80, -2.0 + 0.04 * 15) == 205, "nobody saw it"


def test_the_cost_is_the_share_of_what_the_robot_drives_over() -> None:
    x = np.arange(30) * 0.05
    height = np.tile(np.tan(math.radians(15.0)) * x, (20, 1)).astype(np.float32)
    height[:, 20:] += 0.1
    trusted = np.ones(height.shape, np.bool_)
    trusted[5, 5] = False
    cost = traversal_cost(ElevationGrid(height, trusted, (0.0, 0.0), 0.05), LIMITS)
    assert cost.dtype == np.int8
    assert cost[10, 10] == 50, "15 of 30 deg"
    assert cost[10, 20] > 50, "and a step of 0.11 of 0.2 m, over which the slope is steeper"
    assert cost[5, 5] == -1


def test_a_name_that_tells_no_format_is_refused(ground: ElevationMap, tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"must end in \.npz, \.png, \.tif, \.pcd"):
        write(ground, tmp_path / "a.jpg", LIMITS)
    with pytest.raises(MapError, match="empty"):
        write(ElevationMap(ElevationConfig()), tmp_path / "a.tif", LIMITS)
