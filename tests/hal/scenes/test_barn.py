"""Worlds of the BARN challenge: by its published rules, and from its files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hal.scenes import SceneError, load_scene
from hal.scenes.barn import (
    CELL_SIZE,
    CYLINDER_HEIGHT,
    CYLINDER_RADIUS,
    FILL_SHARES,
    GOAL_POSE,
    GRID_CELLS,
    START_POSE,
    barn,
    grid_of,
    shortest_way,
)


def test_a_world_can_be_crossed_is_the_same_for_its_seed_and_another_for_another() -> None:
    worlds = [barn(seed) for seed in range(len(FILL_SHARES))]
    for scene in worlds:
        way = shortest_way(grid_of(scene))
        assert 10.0 <= way < 16.0
        assert scene.contains(*START_POSE[:2])
        assert scene.contains(*GOAL_POSE[:2])
    np.testing.assert_array_equal(load_scene("barn:2").height, worlds[2].height)
    assert not np.array_equal(worlds[0].height, worlds[1].height)


def test_the_shortest_way_goes_round_what_is_filled_and_there_is_none_through_a_wall() -> None:
    grid = np.zeros((GRID_CELLS, GRID_CELLS), bool)
    straight = shortest_way(grid)
    assert straight == pytest.approx(10.0, abs=0.01)
    grid[: GRID_CELLS - 6, 12] = True
    around = shortest_way(grid)
    assert around > math.hypot(2.0 + 12.5 * CELL_SIZE, 1.0) + math.hypot(8.0 - 12.5 * CELL_SIZE, 1.0)
    grid[:, 12] = True
    assert shortest_way(grid) == math.inf


def test_a_world_file_of_the_challenge_is_a_scene(tmp_path: Path) -> None:
    cylinder = "<model name='unit_cylinder_{0}'><pose frame=''>{1} {2} 0.5 0 -0 0</pose></model>"
    file = tmp_path / "world_0.world"
    models = cylinder.format(0, -2.25, 6.0) + cylinder.format(1, -0.9, 7.0)
    file.write_text(f"<sdf><world><model name='wall'><pose>0 0 0 0 0 0</pose></model>{models}</world></sdf>")
    scene = load_scene(file)
    x0, y0 = scene.origin

    def height(x: float, y: float) -> float:
        return float(scene.height[round((y - y0) / scene.resolution), round((x - x0) / scene.resolution)])

    assert height(1.0, 0.0) == height(2.0, -1.35) == CYLINDER_HEIGHT
    assert height(1.0 + 2 * CYLINDER_RADIUS, 0.0) == 0.0
    with pytest.raises(SceneError, match="needs no options"):
        load_scene(file, resolution=0.1)
    file.write_text("<sdf/>")
    with pytest.raises(SceneError, match="holds no cylinders"):
        load_scene(file)
    file.write_text("no world")
    with pytest.raises(SceneError, match="cannot read"):
        load_scene(file)
