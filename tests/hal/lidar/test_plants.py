"""Leaves stop rays as often as the law says, and hide nothing for good."""

from __future__ import annotations

import numpy as np
import pytest

from hal.lidar import LIDARS, LidarSimulator
from hal.lidar.caster import NumbaCaster, Surface
from hal.lidar.plants import Clump, cast_clumps, pack_clumps
from hal.types import LidarScan

CLUMP = Clump((2.0, 0.0, 0.25), (0.5, 1.0, 0.5), 3.0)


def plain(clump: Clump, origin: np.ndarray, way: np.ndarray, draw: float, reach: float) -> tuple[float, bool]:
    """One ray in plain numpy: where it meets the first leaf."""
    half = 0.5 * np.array(clump.size)
    with np.errstate(divide="ignore"):
        sides = (np.array([clump.centre - half, clump.centre + half]) - origin) / way
    near, far = max(0.0, sides.min(axis=0).max()), min(reach, sides.max(axis=0).min())
    at = near - np.log(1.0 - draw) / clump.density
    return (at, True) if near < far and at < far else (reach, False)


def test_rays_agree_with_plain_numpy() -> None:
    random = np.random.default_rng(3)
    n = 500
    origins = random.uniform([0.0, -1.0, 0.0], [2.2, 1.0, 0.6], (n, 3)).astype(np.float32)
    way = random.normal(size=(n, 3)) * [1.0, 0.3, 0.3] + [1.0, 0.0, 0.0]
    ways = (way / np.linalg.norm(way, axis=1, keepdims=True)).astype(np.float32)
    draw = random.random((2, n), dtype=np.float32)
    reach = random.uniform(0.5, 6.0, n).astype(np.float32)
    clumps = (CLUMP, Clump((3.0, 0.3, 0.2), (0.6, 0.4, 0.4), 1.0))
    ranges, hit = reach.copy(), np.zeros(n, np.bool_)
    cast_clumps(pack_clumps(clumps), origins, ways, draw, ranges, hit)
    for i in range(n):
        expected, met = float(reach[i]), False
        for k, clump in enumerate(clumps):
            expected, stopped = plain(
                clump, origins[i].astype(float), ways[i].astype(float), float(draw[k, i]), expected
            )
            met = met or stopped
        assert ranges[i] == pytest.approx(expected, abs=1e-5)
        assert hit[i] == met
    assert 50 < hit.sum() < n - 50


def test_the_share_that_comes_through_is_that_of_the_law() -> None:
    n = 20_000
    origins = np.tile(np.float32([0.0, 0.0, 0.25]), (n, 1))
    ways = np.tile(np.float32([1.0, 0.0, 0.0]), (n, 1))
    ranges, hit = np.full(n, 5.0, np.float32), np.zeros(n, np.bool_)
    draw = np.random.default_rng(1).random((1, n), dtype=np.float32)
    cast_clumps(pack_clumps([CLUMP]), origins, ways, draw, ranges, hit)
    assert 1.0 - hit.mean() == pytest.approx(np.exp(-1.5), abs=0.01)
    assert set(ranges[~hit]) == {np.float32(5.0)}
    assert 1.75 <= ranges[hit].min() <= ranges[hit].max() <= 2.25


def scans(plants: tuple[Clump, ...]) -> list[LidarScan]:
    height = np.zeros((201, 301), np.float32)
    height[95:106, 250:] = 1.0  # a box behind the clump, from x = 3 m on
    caster = NumbaCaster(Surface(height, 0.02, (-2.0, -2.0)))
    lidar = LidarSimulator(LIDARS["xt16"], LIDARS["xt16"].mount, caster, seed=5, plants=plants)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    stamps = [k * 50_000_000 for k in range(5)]
    return [
        s for stamp in stamps if (s := lidar.advance(stamp, np.array([0.0, 0.0, 0.4]), level)) is not None
    ]


def test_a_clump_is_seen_and_what_stands_behind_it_too() -> None:
    def spots(scan: LidarScan) -> tuple[int, int]:
        p, (mx, _, mz) = scan.points, LIDARS["xt16"].mount.translation
        far = np.hypot(p["x"], p["y"]) + mx  # ahead of the body, whichever way its x points
        ahead = (np.abs(far - 2.0) < 0.22) & (p["z"] + mz + 0.4 > 0.05)
        return int(ahead.sum()), len(p)

    with_plants, without, again = scans((CLUMP,)), scans(()), scans((CLUMP,))
    assert len(with_plants) == 2
    assert spots(without[0])[0] == 0
    assert spots(with_plants[0])[0] > 100
    assert with_plants[0].points.tobytes() == again[0].points.tobytes(), "same seed, same bytes"
    assert with_plants[0].points.tobytes() != with_plants[1].points.tobytes()
