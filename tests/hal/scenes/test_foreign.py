"""Scene files of others: read as they are, or refused with what is wrong and what would help."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from hal.scenes import SceneError, load_scene
from hal.scenes.readers import lzf, read_geometry
from tests.places import SHARED, needs_shared

PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float X\nproperty float Y\nproperty float "
    "Z\nproperty list uchar int near\nend_header\n"
)


def bumps(count: int = 20_000) -> np.ndarray:
    """Points (n, 3) of 8 x 6 m of gentle ground [m]."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 8, count), rng.uniform(0, 6, count)
    return np.column_stack([x, y, 0.05 * np.sin(x)])


def pcd(path: Path, points: np.ndarray, compressed: bool) -> None:
    head = (
        f"VERSION .7\nFIELDS x y z i\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
        f"POINTS {len(points)}\nDATA {'binary_compressed' if compressed else 'binary'}\n"
    )
    columns = [points[:, k].astype("<f4") for k in range(3)]
    if compressed:  # literal runs of LZF
        body = b"".join(c.tobytes() for c in columns) + bytes(len(points))
        packed = b"".join(
            bytes([len(body[k : k + 32]) - 1]) + body[k : k + 32] for k in range(0, len(body), 32)
        )
        data = np.array([len(packed), len(body)], "<u4").tobytes() + packed
    else:
        records = np.zeros(len(points), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("i", "u1")])
        for k, name in enumerate("xyz"):
            records[name] = columns[k]
        data = records.tobytes()
    path.write_bytes(head.encode() + data)


def test_a_compressed_pcd_is_the_same_cloud(tmp_path: Path) -> None:
    points = bumps(500)
    for compressed in (False, True):
        pcd(tmp_path / f"{compressed}.pcd", points, compressed)
    a, b = (read_geometry(tmp_path / f"{c}.pcd").vertices for c in (False, True))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("packed", "plain"),
    [
        (b"\x02abc", b"abc"),
        (b"\x00a" + bytes([(2 - 1 + 0) << 5 | 0, 0]), b"aaaa"),  # a copy of three that overlaps what it makes
        (b"\x02abc" + bytes([7 << 5, 1, 2]), b"abcabcabcabca"),  # 10 from 3 before
    ],
)
def test_lzf_unpacks_runs_and_copies(packed: bytes, plain: bytes) -> None:
    assert lzf(packed, len(plain)) == plain


def test_lzf_refuses_what_is_broken() -> None:
    with pytest.raises(ValueError, match="before the beginning"):
        lzf(bytes([32, 5]), 3)
    with pytest.raises(ValueError, match="where 9 were packed"):
        lzf(b"\x02abc", 9)


def test_vertices_with_lists_and_capital_names_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(PLY + "0 0 0 2 7 8\n1 0 0 0\n0 1 0 1 3\n")
    binary = PLY.replace("ascii", "binary_little_endian").encode()
    for x, y, near in ((0, 0, (7, 8)), (1, 0, ()), (0, 1, (3,))):
        binary += np.array([x, y, 0], "<f4").tobytes() + bytes([len(near)]) + np.array(near, "<i4").tobytes()
    (tmp_path / "b.ply").write_bytes(binary)
    for name in "ab":
        assert read_geometry(tmp_path / f"{name}.ply").vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def test_a_cloud_of_a_countrys_grid_keeps_its_points_and_their_distances(tmp_path: Path) -> None:
    points = bumps()
    points[7] = np.nan
    for name, at in (("here", (0.0, 0.0, 0.0)), ("there", (3_500_000.0, 5_400_000.0, 0.0))):
        np.save(tmp_path / f"{name}.npy", points + np.array(at))
    here, there = (load_scene(tmp_path / f"{name}.npy") for name in ("here", "there"))
    assert "x, y count from (3500000, 5400000)" in there.taken
    np.testing.assert_allclose(there.height, here.height, atol=0.01)


def test_a_mesh_is_read_without_its_broken_vertices(tmp_path: Path) -> None:
    square = "v 0 0 0\nv 4 0 0\nv 4 3 0\nv 0 3 0\n"
    (tmp_path / "a.obj").write_text(f"v nan 1 1\n{square}f 2 3 4\nf 2 4 5\nf 1 2 3\n")
    scene = load_scene(tmp_path / "a.obj")
    assert scene.extent == pytest.approx((0.0, 0.0, 4.0, 3.0), abs=0.05)
    assert scene.survey is None, "the ground has no hole"


def test_a_line_of_an_obj_goes_on_after_a_backslash(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 \\\n0 0\nv 0 1 0\nf 1 2 \\\n 3\n")
    geometry = read_geometry(tmp_path / "a.obj")
    assert geometry.vertices[1].tolist() == [1, 0, 0]
    assert geometry.triangles.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("scale", "turned", "words"), [(1000.0, False, "millimetres"), (1.0, True, "y is up")]
)
def test_units_and_up_are_guessed_said_and_set(
    tmp_path: Path, scale: float, turned: bool, words: str
) -> None:
    points = bumps() * scale
    if turned:
        points = points[:, [0, 2, 1]] * (1, 1, -1)
    pcd(tmp_path / "a.pcd", points, False)
    scene = load_scene(tmp_path / "a.pcd")
    assert words in scene.taken
    x0, y0, x1, y1 = scene.extent
    assert (x1 - x0, y1 - y0) == pytest.approx((8.0, 6.0), abs=0.2)
    if turned:
        with pytest.raises(SceneError):
            load_scene(tmp_path / "a.pcd", up="z")
    with pytest.raises(SceneError, match="units are m, cm, mm, ft"):
        load_scene(tmp_path / "a.pcd", units="inch")


def test_a_sparse_cloud_gets_cells_that_it_fills(tmp_path: Path) -> None:
    pcd(tmp_path / "a.pcd", bumps(4000), False)
    assert load_scene(tmp_path / "a.pcd").resolution == pytest.approx(0.15, abs=0.06)


def test_las_and_geotiff_are_read_with_their_place_and_their_holes(tmp_path: Path) -> None:
    import laspy
    import tifffile

    points = bumps() + np.array([500_000.0, 5_400_000.0, 100.0])
    las = laspy.create(point_format=0, file_version="1.2")
    las.header.scales, las.header.offsets = np.array([0.001] * 3), points.min(axis=0)
    las.x, las.y, las.z = points.T
    for name in ("a.las", "a.laz"):
        las.write(tmp_path / name)
        scene = load_scene(tmp_path / name)
        assert scene.extent[2] < 10.0
        assert "x, y count from (500000, 5400000)" in scene.taken
    height = np.zeros((40, 60), np.float32)
    height[:5] = -9999.0
    tags = [
        (33550, "d", 3, (0.2, 0.2, 0.0)),
        (33922, "d", 6, (0, 0, 0, 100.0, 50.0, 0.0)),
        (42113, "s", 0, "-9999"),
    ]
    tifffile.imwrite(tmp_path / "a.tif", height, extratags=tags)
    scene = load_scene(tmp_path / "a.tif")
    assert scene.resolution == 0.2
    assert scene.origin == pytest.approx((100.1, 42.1))
    assert scene.survey is not None
    assert np.isnan(scene.survey[-5:]).all()  # the first row of a picture is its north
    assert np.isfinite(scene.survey[:-5]).all()
    assert scene.height.min() == 0.0


def test_each_refusal_says_what_would_help(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.ply").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    with pytest.raises(SceneError, match="git lfs pull"):
        load_scene(tmp_path / "a.ply")
    np.save(tmp_path / "a.npy", np.zeros((50, 60)))
    with pytest.raises(SceneError, match="--resolution METRES"):
        load_scene(tmp_path / "a.npy")
    heights = np.zeros((50, 60))
    heights[:9] = -9999.0
    np.save(tmp_path / "a.npy", heights)
    scene = load_scene(tmp_path / "a.npy", resolution=0.1)
    assert scene.survey is not None
    assert np.isnan(scene.survey).sum() == 9 * 60
    monkeypatch.setitem(sys.modules, "laspy", None)
    (tmp_path / "a.laz").write_bytes(b"LASF")
    with pytest.raises(SceneError, match="uv sync --extra files"):
        load_scene(tmp_path / "a.laz")
    wall = np.random.default_rng(0).uniform(0, 9, (100, 3))
    np.save(tmp_path / "b.npy", wall.astype(np.float32))
    with pytest.raises(SceneError, match=r"--start X Y YAW"):
        load_scene(tmp_path / "b.npy")


@needs_shared
def test_files_of_public_sets_are_read() -> None:
    """All six clouds of the PCL set; four of them are no ground that a robot could stand on, and say so."""
    files = SHARED / "data" / "files"
    for name in ("car6", "colored_cloud", "lamppost", "octants", "office1", "sac_plane_test"):
        assert len(read_geometry(files / f"pcl_{name}.pcd").vertices) > 5, name
    assert len(read_geometry(files / "rerun_example.obj").triangles) == 12
    assert load_scene(files / "pcl_office1.pcd").height.size > 1000
    assert load_scene(SHARED / "data" / "real" / "hdl64_scan.ply").resolution > 0.05
    assert load_scene(SHARED / "data" / "terrain" / "raw_cloud.pcd").resolution > 0.05
