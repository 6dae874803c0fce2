"""Maps on disk: saved, loaded, imported, and refused with a reason."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mapping.elevation import files
from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import MapError
from mapping.elevation.files import load_into
from mapping.elevation.map import ElevationMap
from mapping.elevation.mirror import MapMirror
from mapping.elevation.sensor import XT16
from mapping.elevation.tiles import LIDAR, TileStore
from tests.places import TERRAIN, needs_shared

LEVEL = (0.0, 0.0, 0.0, 1.0)


def seen_map(**params) -> ElevationMap:
    """A map of a 4 x 2 m bump, each cell hit three times."""
    elevation = ElevationMap(ElevationConfig(**params))
    x, y = np.meshgrid(np.arange(-2.0, 2.0, 0.02), np.arange(-1.0, 1.0, 0.02))
    z = 0.3 * np.exp(-(x**2 + y**2))
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel() - 1.6]).astype(np.float32)
    for k in range(3):
        elevation.fuse(
            points, (3.0, -5.0, 1.6), LEVEL, 10**9 + k * 10**8, replace(XT16, origin=(0.0, 0.0, 0.3))
        )
    return elevation


def test_a_saved_map_loads_exactly(tmp_path: Path) -> None:
    elevation = seen_map()
    elevation.save(tmp_path / "map.npz")
    again = ElevationMap()
    known = again.load_prior(tmp_path / "map.npz")
    want, got = elevation.full(), again.full()
    assert known == elevation.store.counts()[1] > 4000
    for name, layer in want.layers.items():
        np.testing.assert_array_equal(got.layers[name], layer)
    assert got.origin == want.origin
    assert again.epoch == 1
    mirror = MapMirror()
    for patch in again.take_patches():
        mirror.apply(patch)
    assert np.isfinite(mirror.patch().layers["elevation"]).sum() == np.isfinite(got.layers["elevation"]).sum()


def test_the_cloud_is_saved_and_a_map_without_one_loads(tmp_path: Path) -> None:
    elevation = seen_map()
    assert len(elevation.cloud) > 100
    elevation.save(tmp_path / "map.npz")
    again = ElevationMap()
    again.load_prior(tmp_path / "map.npz")
    np.testing.assert_array_equal(again.cloud.points, elevation.cloud.points)
    with np.load(tmp_path / "map.npz") as file:
        old = {name: file[name] for name in file.files if name != "cloud"}
    np.savez_compressed(tmp_path / "old.npz", **old)
    again.load_prior(tmp_path / "old.npz")
    assert len(again.cloud) == 0
    np.savez_compressed(tmp_path / "bad.npz", **old, cloud=np.full((3, 3), np.nan))
    with pytest.raises(MapError, match="damaged cloud"):
        again.load_prior(tmp_path / "bad.npz")


def test_the_same_map_saves_to_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        seen_map().save(tmp_path / f"{name}.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_a_map_loads_at_another_resolution(tmp_path: Path) -> None:
    seen_map().save(tmp_path / "map.npz")
    for resolution in (0.02, 0.05, 0.1):
        again = ElevationMap(ElevationConfig(resolution=resolution))
        again.load_prior(tmp_path / "map.npz")
        patch = again.window(3.0, -5.0, 0.5)
        x = patch.origin[0] + patch.resolution * np.arange(patch.shape[1]) - 3.0
        y = patch.origin[1] + patch.resolution * np.arange(patch.shape[0]) + 5.0
        truth = 0.3 * np.exp(-(x[None, :] ** 2 + y[:, None] ** 2))
        # the highest of the cells that fall together: at most one cell of slope above
        assert np.abs(patch.layers["elevation"] - truth).max() < 0.3 * (resolution + 0.06)
        assert (patch.layers["trusted"] == 1).all()


def test_driving_on_goes_on_from_a_loaded_map(tmp_path: Path) -> None:
    seen_map().save(tmp_path / "map.npz")
    again = ElevationMap()
    again.load_prior(tmp_path / "map.npz")
    higher = np.array([[2.0, 0.0, 0.2]] * 5, dtype=np.float32)
    for k in range(4):
        again.fuse(higher, (1.0, -5.0, 0.6), LEVEL, k * 10**8, replace(XT16, origin=(0.0, 0.0, 0.3)))
    assert again.window(3.0, -5.0, 0.0).layers["elevation"][0, 0] == pytest.approx(0.8, abs=0.01)


def test_a_plain_grid_is_a_prior_map(tmp_path: Path) -> None:
    height = np.full((20, 30), 0.25, np.float32)
    height[5, 5] = np.nan
    np.savez(tmp_path / "grid.npz", height=height, resolution=0.1, origin=np.array([1.0, 2.0]))
    elevation = ElevationMap()
    elevation.load_prior(tmp_path / "grid.npz")
    patch = elevation.window(2.5, 3.0, 0.3)
    np.testing.assert_allclose(patch.layers["elevation"], 0.25)
    assert (patch.layers["source"] == LIDAR).all()
    assert elevation.window(1.5, 2.5, 0.0).layers["source"][0, 0] != LIDAR


@pytest.mark.parametrize("origin", [0.0, -1.0, -0.33, -5.26])
def test_a_wall_of_one_column_of_a_grid_of_half_the_resolution_stays_a_wall(
    tmp_path: Path, origin: float
) -> None:
    for wall in range(20, 32):
        height = np.zeros((20, 60), np.float32)
        height[:, wall] = 0.5
        np.savez(tmp_path / "grid.npz", height=height, resolution=0.02, origin=np.array([origin, 0.0]))
        elevation = ElevationMap(ElevationConfig(resolution=0.04))
        elevation.load_prior(tmp_path / "grid.npz")
        across = elevation.window(origin + 0.6, 0.2, 0.4).layers["elevation"][5]
        assert np.count_nonzero(across > 0.4) == 1, f"column {wall}"


def ply(points: np.ndarray) -> str:
    head = (
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float "
        "z\nend_header\n"
    )
    return head.format(len(points)) + "\n".join(f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in points) + "\n"


def pcd(points: np.ndarray) -> str:
    n = len(points)
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {}\nHEIGHT 1\nPOINTS {}\nDATA ascii\n"
    return head.format(n, n) + "\n".join(f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in points) + "\n"


@pytest.mark.parametrize(("name", "text"), [("cloud.ply", ply), ("cloud.pcd", pcd)])
def test_a_cloud_is_a_prior_map(tmp_path: Path, name: str, text) -> None:
    points = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.3], [0.4, 0.2, -0.2]])
    (tmp_path / name).write_text(text(points))
    elevation = ElevationMap()
    assert elevation.load_prior(tmp_path / name) == 2
    assert elevation.window(0.0, 0.0, 0.0).layers["elevation"][0, 0] == pytest.approx(0.3)
    assert elevation.window(0.4, 0.2, 0.0).layers["elevation"][0, 0] == pytest.approx(-0.2)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.npz", None, "no such"),
        ("text.npz", b"not a zip", "broken"),
        ("map.ply", b"ply\nrubbish", "ply"),
        ("map.docx", b"x", "docx"),
        ("empty.pcd", pcd(np.zeros((0, 3))).encode(), "empty.pcd"),
        ("far.ply", ply(np.array([[4e6, 5e6, 0.0]])).encode(), "metres"),
    ],
)
def test_a_bad_file_is_refused_in_words_and_changes_nothing(tmp_path: Path, name, content, words) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    elevation = seen_map()
    before = elevation.full()
    with pytest.raises(MapError, match=f"(?i){words}"):
        elevation.load_prior(tmp_path / name)
    assert elevation.epoch == 0
    np.testing.assert_array_equal(elevation.full().layers["elevation"], before.layers["elevation"])


def test_truncated_incomplete_and_newer_maps_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    seen_map().save(path)
    data = path.read_bytes()
    arrays = dict(np.load(path))
    for cut in (10, len(data) // 2, len(data) - 5):
        path.write_bytes(data[:cut])
        with pytest.raises(MapError):
            ElevationMap().load_prior(path)
    for change, words in (
        ({"version": np.array(99)}, "version 99"),
        ({"tiles": np.zeros((1, 2), np.int32)}, "damaged"),
        ({"format": np.array("other")}, "not an elevation map"),
    ):
        np.savez(path, **(arrays | change))
        with pytest.raises(MapError, match=words):
            ElevationMap().load_prior(path)
    np.savez(path, height=np.zeros((3, 3)))
    with pytest.raises(MapError, match="missing"):
        ElevationMap().load_prior(path)


def test_saving_where_nothing_can_be_written_raises_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(OSError):  # noqa: PT011 - FileNotFoundError or NotADirectoryError
        seen_map().save(tmp_path / "absent" / "map.npz")
    assert list(tmp_path.iterdir()) == []


@needs_shared
def test_the_maze_sample_covers_its_floor_at_five_centimetres() -> None:
    elevation = ElevationMap(ElevationConfig(resolution=0.05))
    assert elevation.load_prior(TERRAIN / "maze.ply") > 8000
    layers = elevation.full().layers
    # inside the hall's western part nothing is missing but what the blocks hide
    floor = layers["elevation"][42:80, 25:55]
    assert np.isfinite(floor).mean() > 0.98
    assert np.median(floor) == pytest.approx(0.01, abs=0.02)
    assert 0.4 < np.nanmax(layers["elevation"]) < 1.3


def own_arrays(tmp_path: Path) -> dict[str, np.ndarray]:
    """The arrays of a saved map."""
    seen_map().save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as saved:
        return dict(saved)


CRAFTED = {
    "version": np.array("x"),
    "resolution": np.array(-0.04),
    "tile_cells": np.array(np.inf),
    "tiles": np.array([[np.nan, 0.0]]),
    "source": 9,
    "variance": -1.0,
    "height": np.nan,
}


@pytest.mark.parametrize("name", CRAFTED)
def test_a_crafted_map_of_ours_is_refused_in_words(tmp_path: Path, name: str) -> None:
    arrays, wrong = own_arrays(tmp_path), CRAFTED[name]
    if isinstance(wrong, np.ndarray):
        arrays[name] = wrong
    else:
        arrays[name][:] = wrong
    np.savez(tmp_path / "crafted.npz", **arrays)
    with pytest.raises(MapError, match="crafted"):
        ElevationMap().load_prior(tmp_path / "crafted.npz")


@pytest.mark.parametrize("change", ["far", "twice", "strings"])
def test_tiles_beyond_all_distances_or_of_another_type_are_refused(tmp_path: Path, change: str) -> None:
    arrays = own_arrays(tmp_path)
    if change == "far":
        arrays["tiles"][0] = 2**31 - 1
    elif change == "twice":
        arrays["tiles"][1] = arrays["tiles"][0]
    else:
        arrays["height"] = np.full(arrays["height"].shape, "x")
    np.savez(tmp_path / "crafted.npz", **arrays)
    with pytest.raises(MapError, match="damaged map"):
        ElevationMap().load_prior(tmp_path / "crafted.npz")


def test_a_bit_that_flipped_anywhere_in_a_map_is_no_crash(tmp_path: Path) -> None:
    own_arrays(tmp_path)
    whole = (tmp_path / "map.npz").read_bytes()
    rng = np.random.default_rng(7)
    refused = 0
    for place in rng.integers(len(whole), size=60):
        broken = bytearray(whole)
        broken[place] ^= 1 << rng.integers(8)
        (tmp_path / "broken.npz").write_bytes(broken)
        try:
            load_into(TileStore(64), tmp_path / "broken.npz", 0.04, 3)
        except MapError:
            refused += 1
    assert refused > 30


def test_an_archive_that_claims_more_than_a_map_has_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "MAX_BYTES", 1_000_000)
    np.savez_compressed(tmp_path / "bomb.npz", height=np.zeros((1000, 1000)), resolution=0.04, origin=[0, 0])
    with pytest.raises(MapError, match="GB of arrays"):
        load_into(TileStore(64), tmp_path / "bomb.npz", 0.04, 3)


def test_one_cell_as_wide_as_a_town_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "wide.npz", height=np.zeros((1, 1)), resolution=1e4, origin=[0, 0])
    with pytest.raises(MapError, match="cut it"):
        load_into(TileStore(64), tmp_path / "wide.npz", 0.04, 3)
