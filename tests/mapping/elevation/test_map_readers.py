"""Where the rays of a map begin, how time passes in it, what a restart and a change leave to its readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mapping.elevation.map import ElevationMap
from mapping.elevation.mirror import MapMirror
from tests.mapping.elevation.test_map import HEIGHT, LEVEL, SENSOR, WHEELS, flat_scan

RES = 0.04


def block(x0: int, x1: int, y0: int = 0, y1: int = 20) -> np.ndarray:
    """Nine points in each cell of columns x0 to x1 and rows y0 to y1 of level ground, base_link at HEIGHT over the
    origin."""
    step = RES / 3.0
    x, y = np.meshgrid(np.arange(RES * x0 - step, RES * x1, step), np.arange(RES * y0 - step, RES * y1, step))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -HEIGHT)]).astype(np.float32)


def bound(elevation: ElevationMap, x: float) -> float:
    return float(elevation.window(x, 0.0, 0.0).layers["upper_bound"][0, 0])


def test_rays_begin_at_the_lidar() -> None:
    elevation = ElevationMap()
    end = np.add(SENSOR, (2.0, 0.0, -1.0))
    elevation.store.locate(np.zeros(1, np.int64), np.array([30]))
    elevation.fuse(end[None].astype(np.float32), (0.0, 0.0, 0.0), LEVEL, 1)
    elevation.clean()
    assert bound(elevation, 1.2) == pytest.approx(SENSOR[2] - 0.5 * (1.2 - SENSOR[0]), abs=0.01)


def test_of_a_dense_scan_one_half_of_the_rays_is_looked_along_after_the_other() -> None:
    elevation = ElevationMap()
    ahead, behind = np.add(SENSOR, (2.0, 0.0, -0.9)), np.subtract(SENSOR, (2.0, 0.0, 0.9))
    points = np.tile([ahead, behind], (5000, 1)).astype(np.float32)
    elevation.fuse(points, (0.0, 0.0, HEIGHT), LEVEL, 1)
    seen = []
    for _ in range(2):
        elevation.clean()
        seen.append(sum(np.isfinite(bound(elevation, x)) for x in (1.2, -1.2)))
    assert seen == [1, 2]


def test_one_scan_takes_out_five_centimetres_of_drift_at_most() -> None:
    elevation, p = ElevationMap(), ElevationMap().params
    for k, off in enumerate((0.0, 0.15)):
        elevation.fuse(block(20, 45), (0.0, 0.0, HEIGHT + off), LEVEL, 1 + k * 10**8, height_sigma=0.1)
    assert elevation.alignment.height == pytest.approx(-p.drift_gain * (0.05 - p.drift_free), abs=1e-6)


@pytest.mark.parametrize("later", [10**18, -(10**18)])
def test_a_source_clock_that_is_set_lets_no_time_pass(later: int) -> None:
    """From its start in 1970 to now, or back."""
    elevation = ElevationMap()
    begin = 2 * 10**18
    elevation.fuse(block(40, 50), (0.0, 0.0, HEIGHT), LEVEL, begin)
    for k in range(3):
        elevation.fuse(block(60, 70), (0.0, 0.0, HEIGHT), LEVEL, begin + later + k * 10**8)
    patch = elevation.complete(elevation.boxes()[0])
    row, col = patch.cell
    assert patch.layers["age"][10 - row, 45 - col] == pytest.approx(0.2)


def test_a_map_that_came_back_from_a_reader_grants_no_start() -> None:
    first, again = ElevationMap(), ElevationMap()
    first.fuse(block(40, 50), (0.0, 0.0, HEIGHT), LEVEL, 1)
    again.restore(first.full())
    assert 0 < again.fuse_ground(WHEELS, (5.0, 0.0, HEIGHT), LEVEL, 2) < 150


def test_readers_hear_of_bridges_that_are_granted_no_longer() -> None:
    elevation, mirror, rng = ElevationMap(), MapMirror(), np.random.default_rng(6)
    for k in range(3):
        elevation.fuse(flat_scan(rng), (0.0, 0.0, HEIGHT), LEVEL, k + 1)
    elevation.fuse_ground(WHEELS, (0.9, 0.0, HEIGHT), LEVEL, 4, start=False)
    for granted in (True, False, True):
        elevation.grant(granted)
        for patch in elevation.take_patches():
            mirror.apply(patch)
        grid = mirror.patch().grid()
        row, col = (round((v - o) / RES) for v, o in zip((0.0, 1.5), grid.origin[::-1], strict=True))
        assert grid.trusted[row, col] == granted


def test_a_bridge_into_a_tile_that_did_not_change_is_sent() -> None:
    """Columns 64 and more are the next tile."""
    elevation, mirror = ElevationMap(), MapMirror()
    for k, (a, b) in enumerate(((65, 80), (50, 62))):
        elevation.fuse(block(a, b), (0.0, 0.0, HEIGHT), LEVEL, 1 + k)
        for patch in elevation.take_patches():
            mirror.apply(patch)
    whole = elevation.full()
    row, col = whole.cell
    assert whole.layers["trusted"][10 - row, 64 - col] == 1.0
    grid = mirror.patch().grid()
    assert grid.trusted[10 - round(grid.origin[1] / RES), 64 - round(grid.origin[0] / RES)]


def test_a_map_on_the_disk_that_is_read_block_by_block_does_not_come_back_as_a_whole(tmp_path: Path) -> None:
    elevation = ElevationMap()
    elevation.put_on(tmp_path)
    x, y = np.meshgrid(np.arange(-6.0, 6.1, 2.4), np.arange(-6.0, 6.1, 2.4))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -HEIGHT)]).astype(np.float32)
    for k in range(60):
        elevation.fuse(points, (3.0 * k, 0.0, HEIGHT), LEVEL, 1 + k)
        elevation.take_patches()
    used = elevation.store.used
    for box in elevation.boxes():
        elevation.read(box)
    assert elevation.store.used <= used
