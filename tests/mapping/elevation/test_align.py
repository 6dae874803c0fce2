"""Poses that are tilted against a prior map are laid onto it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hal.rotation import quaternion, rotation_rpy
from mapping.elevation.align import (
    FLAT_RISE,
    HEIGHT_GATE,
    HEIGHT_SCALE,
    Alignment,
    _normal_equations,
    _over_ground,
)
from mapping.elevation.fusion import TOP, WEIGHT
from mapping.elevation.map import ElevationMap
from mapping.elevation.tiles import LIDAR, TileStore
from tests.mapping.elevation.test_map import HEIGHT, flat_scan

RES = 0.04


def test_the_normal_equations_equal_numpy() -> None:
    rng = np.random.default_rng(0)
    store = TileStore(16)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(-32, 32), np.arange(-32, 32), indexing="ij"))
    index = store.locate(i, j)
    store.cells["source"][index] = LIDAR
    store.cells["height"][index] = np.where(rng.random(i.size) < 0.01, 0.5, 0.1 * j * RES)
    store.cells["height"][index[i == 5]] = np.nan
    alignment = Alignment()
    alignment.to(store)
    pick = rng.permutation(i.size)[:1500]
    sums = np.zeros((pick.size, 8), np.float32)
    sums[:, WEIGHT] = 1.0
    sums[:, TOP] = 0.1 * j[pick] * RES + rng.normal(0.02, 0.05, pick.size)
    at = np.array([0.3, -0.2])
    over = _over_ground(index[pick], sums, store.level, store.shift)
    n, total, a, b = _normal_equations(over, index[pick], store.tiles, store.shift, at, RES)

    height = np.full((66, 66), np.nan, np.float32)
    height[i + 33, j + 33] = store.cells["height"][index]
    rows = []
    for k, s in enumerate(pick):
        around = height[i[s] + 32 : i[s] + 35, j[s] + 32 : j[s] + 35]
        off = float(sums[k, TOP] - height[i[s] + 33, j[s] + 33])
        edge = {int(v) % 16 for v in (i[s], j[s])} & {0, 15}  # neighbours in another tile are not looked up
        if not edge and np.ptp(around) <= FLAT_RISE and abs(off) <= HEIGHT_GATE:
            rows.append((1.0, j[s] * RES - at[0], i[s] * RES - at[1], off))
    jac, off = np.array(rows)[:, :3], np.array(rows)[:, 3]
    w = (1.0 / (1.0 + (off / HEIGHT_SCALE) ** 2)) ** 2
    assert n == len(rows) > 300
    assert total == pytest.approx(w.sum(), rel=1e-5)
    np.testing.assert_allclose(a, (jac * w[:, None]).T @ jac, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(b, (jac * w[:, None]).T @ off, rtol=1e-4, atol=1e-4)


def test_tilted_poses_leave_a_prior_map_at_its_height(tmp_path: Path) -> None:
    path = tmp_path / "flat.npz"
    np.savez(path, height=np.zeros((300, 500), np.float32), resolution=RES, origin=(-6.0, -6.0))
    elevation, rng = ElevationMap(), np.random.default_rng(1)
    elevation.load_prior(path)
    tilt = rotation_rpy(np.radians(0.2), np.radians(-0.45), 0.0)  # as an accelerometer's bias tilts `odom`
    for k in range(60):
        place = tilt @ np.array([0.1 * k, 0.0, HEIGHT])
        elevation.fuse(flat_scan(rng), place, quaternion(tilt), 10**9 + k * 10**8)
    patch = elevation.full()
    cells = patch.layers["elevation"]
    assert place[2] - HEIGHT == pytest.approx(0.046, abs=0.001)
    assert elevation.alignment.height == pytest.approx(-0.046, abs=0.002)
    assert elevation.alignment.slopes == pytest.approx([-np.radians(0.45), -np.radians(0.2)], abs=5e-4)
    assert np.quantile(np.abs(cells[np.isfinite(cells)]), 0.99) < 0.012


def test_without_a_prior_map_slopes_stay_zero() -> None:
    elevation, rng = ElevationMap(), np.random.default_rng(2)
    tilt = rotation_rpy(0.0, np.radians(-0.45), 0.0)
    for k in range(5):
        elevation.fuse(flat_scan(rng), tilt @ (0.1 * k, 0.0, HEIGHT), quaternion(tilt), 10**9 + k * 10**8)
    assert not elevation.alignment.active
    assert not elevation.alignment.slopes.any()


@pytest.mark.parametrize("off", [0.0, 0.012, 0.3])
def test_walls_do_not_tell_the_level_of_a_prior_map(tmp_path: Path, off: float) -> None:
    """In a lane a scan meets little ground, and walls everywhere below their tops."""
    path = tmp_path / "lane.npz"
    height = np.zeros((100, 300), np.float32)
    height[33:36], height[64:67] = 0.5, 0.5
    np.savez(path, height=height, resolution=RES, origin=(0.0, 0.0))
    elevation, rng = ElevationMap(), np.random.default_rng(3)
    elevation.load_prior(path)
    ground = np.column_stack([rng.uniform(3.9, 4.1, 600), rng.uniform(1.6, 2.4, 600), np.zeros(600)])
    # faces of the walls, 6 to 8 cm below their tops
    rows = RES * np.repeat([35.0, 64.0], 2500)
    walls = np.column_stack([rng.uniform(2.5, 11.5, 5000), rows, rng.uniform(0.42, 0.44, 5000)])
    place = np.array([2.0, 2.0, HEIGHT])
    points = (np.concatenate([ground, walls]) - place + rng.normal(0.0, 0.002, (5600, 3))).astype(np.float32)
    for k in range(3):
        elevation.fuse(points, (2.0, 2.0, HEIGHT + off), (0.0, 0.0, 0.0, 1.0), 10**9 + k * 10**8)
    assert elevation.alignment.height == pytest.approx(-off, abs=0.004)
