"""The mirror of the map and the tiles on the disk: windows, blocks, and that nothing differs by where a tile lies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import PATCH_LAYERS, MapError, MapPatch
from mapping.elevation.map import ElevationMap
from mapping.elevation.mirror import BLOCK_SIDE, TILE_SIDE, WHOLE_CELLS, CellWindow, MapMirror, blocks_of
from mapping.elevation.shelf import Shelf
from mapping.elevation.tiles import AT_ONCE, TileStore

RES = 0.04
SHORT = ElevationConfig(max_range=2.0)
"""A LiDAR that sees 2 m: tiles further than 5 m away are put on the disk."""


def patch_of(rng: np.random.Generator, row: int, col: int, rows: int, cols: int, stamp: int = 1) -> MapPatch:
    layers = {name: rng.random((rows, cols)).astype(np.float32) for name in PATCH_LAYERS}
    layers["elevation"][rng.random((rows, cols)) < 0.2] = np.nan
    return MapPatch((col * RES, row * RES), RES, stamp, 0, layers)


@pytest.mark.parametrize("on_disk", [False, True])
def test_a_window_reads_as_a_dense_array_would(tmp_path: Path, on_disk: bool) -> None:
    rng = np.random.default_rng(1)
    mirror = MapMirror(tmp_path if on_disk else None)
    dense = {
        name: np.full((400, 500), 0.0 if name in ("trusted", "source") else np.nan, np.float32)
        for name in PATCH_LAYERS
    }
    for k in range(40):
        rows, cols = rng.integers(1, 120, 2)
        row, col = rng.integers(0, 400 - rows), rng.integers(0, 500 - cols)
        patch = patch_of(rng, row - 200, col - 250, rows, cols)
        assert mirror.apply(patch) == CellWindow(row - 200, col - 250, rows, cols)
        for name, layer in dense.items():
            layer[row : row + rows, col : col + cols] = patch.layers[name]
        if k % 4 == 0:
            mirror.stay_within(CellWindow(*rng.integers(-200, 150, 2), 64, 64))
    if on_disk:
        assert mirror.nbytes < 0.7 * 4 * 5 * 400 * 500
    for _ in range(10):
        row, col = rng.integers(-250, 150, 2)
        got = mirror.read(CellWindow(int(row), int(col), 130, 90))
        assert got.cell == (row, col)
        for name, layer in got.layers.items():
            fresh = 0.0 if name in ("trusted", "source") else np.nan
            want = np.pad(dense[name], 100, constant_values=fresh)
            r, c = row + 300, col + 350
            np.testing.assert_array_equal(layer, want[r : r + 130, c : c + 90])


def test_a_view_is_the_whole_of_a_small_map_and_stays_small_on_a_large_one() -> None:
    rng = np.random.default_rng(2)
    mirror = MapMirror()
    mirror.apply(patch_of(rng, -30, -30, 200, 100))
    assert mirror.view((0.0, 0.0)) == mirror.bounds() == CellWindow(-64, -64, 256, 192)
    mirror.apply(patch_of(rng, 25_000, 25_000, 10, 10))
    assert mirror.view((0.5, 0.5)) == CellWindow(-64, -64, 256, 192)
    assert mirror.view((1000.1, 1000.1)) == CellWindow(24_960, 24_960, 64, 64)
    mirror.apply(patch_of(rng, 1500, 20, 500, 10))
    assert mirror.view((0.5, 0.5)) == CellWindow(-64, -64, 1536 + 64, 192)
    assert mirror.view((500.0, 500.0)).rows == 0
    assert mirror.view((-200.0, 0.0)).cols == 0
    assert mirror.view((float("nan"), 0.0)).rows == 0
    assert mirror.nbytes < 2_000_000


def test_a_view_of_a_street_is_as_wide_as_the_street_after_a_corner_too() -> None:
    """The box around a map with a corner is wide everywhere: grid and graph took half as long again there."""
    mirror, ground = MapMirror(), np.ones((64, 64), np.float32)
    for k in range(100):
        row, col = (0, 64 * k) if k < 50 else (64 * (k - 49), 64 * 49)
        layers = dict.fromkeys(PATCH_LAYERS, ground)
        mirror.apply(MapPatch((col * RES, row * RES), RES, k, 0, layers))
    before, after = mirror.view((60.0, 1.0)), mirror.view((126.0, 100.0))
    assert (before.rows, after.cols) == (64, 64)
    assert min(before.cols, after.rows) > 1000


def test_a_patch_over_a_grid_lies_on_top_of_the_map_and_changes_nothing_of_it() -> None:
    rng = np.random.default_rng(3)
    mirror = MapMirror()
    mirror.apply(patch_of(rng, 0, 0, 64, 64))
    over = patch_of(rng, 40, 50, 30, 30)
    window = mirror.view((0.0, 0.0), over)
    assert (window.rows, window.cols) == (128, 128)
    before = mirror.patch().layers["elevation"].copy()
    other = MapMirror()
    for patch in (mirror.patch(), over):
        other.apply(patch)
    np.testing.assert_array_equal(mirror.grid(window, over).height, other.grid().height)
    np.testing.assert_array_equal(mirror.patch().layers["elevation"], before)


def test_blocks_hold_every_tile_once() -> None:
    keys = np.array([(r, r // 3) for r in range(-30, 70)] + [(0, 500)])
    windows = list(blocks_of(keys, TILE_SIDE))
    assert len(windows) > 10
    assert all(w.rows <= BLOCK_SIDE * TILE_SIDE and w.cols <= BLOCK_SIDE * TILE_SIDE for w in windows)
    for row, col in keys:
        cell = CellWindow(row * TILE_SIDE, col * TILE_SIDE, TILE_SIDE, TILE_SIDE)
        assert (
            sum(cell.within(w).rows == TILE_SIDE and cell.within(w).cols == TILE_SIDE for w in windows) == 1
        )
    side = int(WHOLE_CELLS**0.5) // TILE_SIDE
    assert len(list(blocks_of(np.array([(0, 0), (side - 1, side - 1)]), TILE_SIDE, WHOLE_CELLS))) == 1


def scans(elevation: ElevationMap, mirror: MapMirror) -> list[bytes]:
    """20 m there and back over ground with steps; what was read out after each scan, as bytes."""
    rng = np.random.default_rng(4)
    out = []
    for k in range(80):
        x = 0.5 * (k if k < 40 else 80 - k)
        xy = rng.uniform(-1.9, 1.9, (3000, 2))
        z = 0.2 * (np.floor(xy[:, 0] + x) % 3.0) - 0.4 + 0.01 * rng.standard_normal(3000)
        elevation.fuse(
            np.column_stack([xy, z]).astype(np.float32), (x, 0.0, 0.4), (0, 0, 0, 1), 1 + k * 10**8
        )
        elevation.clean()
        patches = [*elevation.take_patches(), elevation.window(x, 0.0, 2.0)]
        for patch in patches[:-1]:
            mirror.apply(patch)
            mirror.stay_within(CellWindow(-64, int(x / RES) - 64, 128, 128))
        out += [layer.tobytes() for patch in patches for layer in patch.layers.values()]
    return out


def test_a_map_on_the_disk_reads_byte_for_byte_like_one_in_memory(tmp_path: Path) -> None:
    one, other = ElevationMap(SHORT), ElevationMap(SHORT)
    other.put_on(tmp_path)
    here, there = MapMirror(), MapMirror(tmp_path)
    assert scans(one, here) == scans(other, there)
    assert len(other.store.shelf) > 5
    assert other.store.used + len(other.store.shelf) == one.store.used
    assert there.nbytes < 0.6 * here.nbytes
    assert one.store.counts() == other.store.counts()
    for want, got in ((one.full(), other.full()), (here.patch(), there.patch())):
        for name, layer in want.layers.items():
            np.testing.assert_array_equal(got.layers[name], layer)
    box = one.boxes()[0]
    for name, layer in one.complete(box).layers.items():
        np.testing.assert_array_equal(other.complete(box).layers[name], layer)
    assert len(other.store.shelf) > 5  # what was read for that is back on the disk
    assert list(tmp_path.iterdir()) == []  # and leaves no file
    one.save(tmp_path / "one.npz")
    other.save(tmp_path / "other.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()


def test_many_far_tiles_are_put_away_a_few_at_a_time(tmp_path: Path) -> None:
    """A scan must not wait for the tiles of a whole prior map."""
    store = TileStore(8, tmp_path)
    for col in range(100):
        store.allocate(0, col)
    away, none = [], None
    while none != 0:
        before = len(store.shelf)
        store.stay_near(0, 0, 2, 4)
        none = len(store.shelf) - before
        away.append(none)
    assert sum(away) == 95
    assert max(away) == AT_ONCE
    store.stay_near(0, 99, 2, 4)
    assert all(store.slot(0, col) >= 0 for col in (97, 98, 99)), "what is near is brought back at once"


def test_a_disk_that_takes_nothing_leaves_the_map_in_memory_and_says_so(tmp_path: Path) -> None:
    elevation = ElevationMap(SHORT)
    elevation.put_on(tmp_path / "absent")
    scans(elevation, MapMirror())
    assert "cannot be put on the disk" in elevation.warning
    assert len(elevation.store.shelf) == 0
    with pytest.raises(MapError, match="no map yet"):
        MapMirror().bounds()


def test_tiles_taken_from_the_disk_make_room_for_others(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path)
    tiles = [np.full(100, k, np.float32) for k in range(4)]
    for k in (0, 1, 2):
        assert shelf.put((k, k), tiles[k])
    got = np.zeros(100, np.float32)
    shelf.take((1, 1), got)
    np.testing.assert_array_equal(got, tiles[1])
    assert shelf.put((3, 3), tiles[3])
    assert sorted(shelf.keys) == [(0, 0), (2, 2), (3, 3)]
    for k in (0, 2, 3):
        shelf.get((k, k), got)
        np.testing.assert_array_equal(got, tiles[k])
