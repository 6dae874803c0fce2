"""A cell is wall only if most of it is: in scans with noise, and in prior maps finer than the map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mapping.elevation.map import ElevationMap

LEVEL = (0.0, 0.0, 0.0, 1.0)
HEIGHT = 0.4
RES = 0.04


def lane(surface: float, top: float = 0.5) -> ElevationMap:
    """What a robot that stands at the origin of a floor knows of a wall whose surface lies at y = `surface` [m], its
    top at `top` [m]: 20
    scans with 1 cm of noise along the ray."""
    rng = np.random.default_rng(0)
    elevation = ElevationMap()
    a, b = np.meshgrid(np.arange(0.2, 1.4, 0.01), np.arange(-1.2, 1.2, 0.01))
    floor = np.column_stack([a.ravel(), b.ravel(), np.zeros(a.size)])
    floor = floor[floor[:, 1] < surface]
    a, c = np.meshgrid(np.arange(0.2, 1.4, 0.005), np.arange(0.0, top, 0.03))
    face = np.column_stack([a.ravel(), np.full(a.size, surface), c.ravel()])
    a, b = np.meshgrid(np.arange(0.2, 1.4, 0.01), np.arange(surface, 1.4, 0.01))
    lid = np.column_stack([a.ravel(), b.ravel(), np.full(a.size, top)])
    eye = np.array([0.1634, 0.0, 0.116 + HEIGHT])
    points = np.concatenate([floor, face, lid] if top < eye[2] else [floor, face])
    away = points - eye
    away /= np.linalg.norm(away, axis=1)[:, None]
    for k in range(20):
        seen = points + away * rng.normal(0.0, 0.01, (len(points), 1)) - (0.0, 0.0, HEIGHT)
        elevation.fuse(seen.astype(np.float32), (0.0, 0.0, HEIGHT), LEVEL, 10**9 + k * 10**8)
    return elevation


def first_wall(elevation: ElevationMap) -> np.ndarray:
    """Row of the first wall cell as seen from y = 0, for columns of the middle."""
    patch = elevation.full()
    rows = np.arange(patch.shape[0]) + patch.cell[0]
    columns = slice(round(0.4 / RES) - patch.cell[1], round(1.2 / RES) - patch.cell[1])
    wall = (patch.layers["elevation"][:, columns] > 0.1) & (rows[:, None] > 0)
    return rows[np.argmax(wall, axis=0)]


@pytest.mark.parametrize("place", [0.1, 0.3, 0.7, 0.9])
def test_a_wall_begins_in_the_first_cell_that_it_fills_by_half(place: float) -> None:
    # the surface lies `place` of the way through row 15
    row = first_wall(lane((15 - 0.5 + place) * RES))
    # a few columns may be one off by chance
    assert np.mean(row == (15 if place < 0.5 else 16)) > 0.9


@pytest.mark.parametrize("top", [0.15, 0.3])
def test_a_box_with_a_top_keeps_its_first_cell(top: float) -> None:
    row = first_wall(lane((15 - 0.5 + 0.2) * RES, top))
    assert np.mean(row == 15) > 0.9


def test_of_a_finer_prior_map_a_cell_is_wall_from_half_on(tmp_path: Path) -> None:
    height = np.zeros((40, 40), np.float32)
    height[21:, :] = 0.5  # cells of 0.02 m, rows 20 and 21 fall into row 10 of the map
    height[:, 11:] += 0.5
    height[31:, 31:] = 9.0  # a quarter of cell (15, 15)
    path = tmp_path / "prior.npz"
    np.savez(path, height=height, resolution=0.02, origin=(-0.01, -0.01))
    elevation = ElevationMap()
    elevation.load_prior(path)
    patch = elevation.full()
    known = patch.layers["elevation"]
    r, c = -patch.cell[0], -patch.cell[1]
    assert known[r + 9, c] == 0.0
    assert known[r + 10, c] == 0.5
    assert known[r, c + 4] == 0.0
    assert known[r, c + 5] == 0.5
    assert known[r + 15, c + 15] == 1.0
