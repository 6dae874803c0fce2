"""Scenes from files of every kind, broken ones included."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hal.scenes import Scene, SceneError, load_scene
from hal.scenes.files import save_scene
from hal.scenes.gridding import fill, grid
from hal.scenes.readers import read_geometry
from hal.scenes.scene import Geometry
from tests.places import TERRAIN, needs_shared

CORNERS = np.array(
    [[0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0], [1, 1, 0.5], [2, 1, 0.5], [2, 2, 0.5], [1, 2, 0.5]], float
)
FACES = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
"""A floor of 4 x 3 m with a shelf of 1 x 1 m at 0.5 m."""


def cloud(step: float = 0.04) -> np.ndarray:
    x, y = np.meshgrid(np.arange(0, 4 + 1e-9, step), np.arange(0, 3 + 1e-9, step))
    inside = (x >= 1) & (x <= 2) & (y >= 1) & (y <= 2)
    return np.stack([x, y, np.where(inside, 0.5, 0.0)], axis=-1).reshape(-1, 3)


def ply(layout: str) -> bytes:
    head = (
        f"ply\nformat {layout} 1.0\ncomment x\nelement vertex 8\nproperty uchar red\nproperty float "
        "x\nproperty float y\n"
        "property double z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if layout == "ascii":
        body = "".join(f"7 {x} {y} {z}\n" for x, y, z in CORNERS) + "".join(
            f"3 {a} {b} {c}\n" for a, b, c in FACES
        )
        return head + body.encode()
    order = ">" if "big" in layout else "<"
    points = np.zeros(8, [("r", "u1"), ("x", order + "f4"), ("y", order + "f4"), ("z", order + "f8")])
    points["x"], points["y"], points["z"] = CORNERS.T
    faces = np.zeros(4, [("n", "u1"), ("v", order + "i4", (3,))])
    faces["n"], faces["v"] = 3, FACES
    return head + points.tobytes() + faces.tobytes()


def pcd(layout: str) -> bytes:
    points = cloud()
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS intensity x y z\nSIZE 2 4 4 8\nTYPE U F F F\nCOUNT 2 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA {layout}\n"
    ).encode()
    if layout == "ascii":
        return head + "".join(f"1 2 {x} {y} {z}\n" for x, y, z in points).encode()
    table = np.zeros(len(points), [("i", "<u2", (2,)), ("x", "<f4"), ("y", "<f4"), ("z", "<f8")])
    table["x"], table["y"], table["z"] = points.T
    return head + table.tobytes()


def stl(ascii_: bool) -> bytes:
    corners = CORNERS[FACES]
    if ascii_:
        facets = "".join(
            "facet normal 0 0 1\nouter loop\n"
            + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t)
            + "endloop\nendfacet\n"
            for t in corners
        )
        return f"solid box\n{facets}endsolid\n".encode()
    table = np.zeros(4, [("n", "<f4", (3,)), ("v", "<f4", (3, 3)), ("a", "<u2")])
    table["v"] = corners
    return b"solid but binary".ljust(80) + np.uint32(4).tobytes() + table.tobytes()


def obj() -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + ["vt 0 0", "f 1/1 2/1 3/1 4/1", "f -4 -3 -2 -1"]
    return "\n".join(lines).encode()


FILES = {
    "ascii.ply": ply("ascii"),
    "little.ply": ply("binary_little_endian"),
    "big.ply": ply("binary_big_endian"),
    "ascii.pcd": pcd("ascii"),
    "binary.pcd": pcd("binary"),
    "ascii.stl": stl(True),
    "binary.stl": stl(False),
    "mesh.obj": obj(),
}


@pytest.mark.parametrize("name", list(FILES))
def test_clouds_and_meshes_become_the_same_terrain(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(FILES[name])
    scene = load_scene(tmp_path / name, resolution=0.04, start=(3.0, 0.5, 0.0))
    assert scene.height.shape == (76, 101)
    assert scene.origin == pytest.approx((0.0, 0.0))
    assert scene.z(1.5, 1.5) == pytest.approx(0.5, abs=1e-6)
    assert [scene.z(x, y) for x, y in ((0.5, 0.5), (3.0, 2.5), (2.2, 1.5))] == pytest.approx(
        [0.0] * 3, abs=1e-6
    )
    assert scene.start == (3.0, 0.5, 0.0)


@pytest.mark.parametrize("name", list(FILES))
def test_truncated_files_say_so(name: str, tmp_path: Path) -> None:
    data = FILES[name]
    rejected = 0
    for share in (0.0, 0.03, 0.2, 0.5, 0.9):
        (tmp_path / name).write_bytes(data[: int(share * len(data))])
        try:
            load_scene(tmp_path / name, resolution=0.04, start=(1.0, 1.0, 0.0))
        except SceneError:
            rejected += 1
    assert rejected >= (2 if name.endswith("obj") or name == "ascii.stl" else 5)


def test_garbage_never_raises_anything_but_a_scene_error(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    for name, data in FILES.items():
        for _ in range(30):
            broken = bytearray(data)
            for at in random.integers(0, len(broken), 8):
                broken[at] = int(random.integers(256))
            (tmp_path / name).write_bytes(bytes(broken))
            try:
                load_scene(tmp_path / name, resolution=0.1, start=(1.0, 1.0, 0.0))
            except SceneError:
                continue


def test_npz_round_trip_keeps_poses_goals_and_unknown_cells(tmp_path: Path) -> None:
    height = np.zeros((60, 80), np.float32)
    height[20:25, 30:35] = 0.4
    survey = height.copy()
    survey[40:42, 10:14] = np.nan
    scene = Scene(
        "s",
        height,
        0.1,
        (-3.0, 2.0),
        (0.5, 4.0, 0.3),
        {"a": (1.0, 3.0, None), "b": (2.0, 3.0, 1.0)},
        survey=survey,
    )
    save_scene(scene, tmp_path / "s.npz")
    again = load_scene(tmp_path / "s.npz")
    assert again.start == scene.start
    assert dict(again.goals) == dict(scene.goals)
    assert again.origin == scene.origin
    assert again.height == pytest.approx(height)
    assert np.array_equal(again.trusted, scene.trusted)


def test_a_picture_is_read_north_up_between_its_heights(tmp_path: Path) -> None:
    pixels = np.zeros((50, 80), np.uint8)
    pixels[:10] = 255  # the northern rim
    Image.fromarray(pixels).save(tmp_path / "p.png")
    scene = load_scene(tmp_path / "p.png", resolution=0.1, height_range=(-0.2, 0.8))
    assert scene.height.shape == (50, 80)
    assert scene.height[-1, 0] == pytest.approx(0.8)
    assert scene.height[0, 0] == pytest.approx(-0.2)
    assert scene.extent == pytest.approx((-3.95, -2.45, 3.95, 2.45))
    assert scene.z(*scene.start[:2]) == pytest.approx(-0.2)
    Image.fromarray(np.full((40, 40), 32768, np.uint16)).save(tmp_path / "deep.png")
    deep = load_scene(tmp_path / "deep.png", resolution=0.1, height_range=(0.0, 1.0))
    assert deep.height[5, 5] == pytest.approx(0.5, abs=1e-4)


def test_the_chosen_start_is_level_and_the_far_goal_is_reachable(tmp_path: Path) -> None:
    height = np.zeros((100, 120), np.float32)
    height[:, 40:44] = 1.0  # a wall cuts off the smaller part
    height[60:75, 80:100] = 0.5
    np.savez(tmp_path / "t.npz", height=height, resolution=0.1, origin=np.zeros(2))
    scene = load_scene(tmp_path / "t.npz")
    assert scene.start[0] > 4.8
    fx, fy, _ = scene.goals["far"]
    assert fx > 4.8
    assert np.hypot(fx - scene.start[0], fy - scene.start[1]) > 3.0
    assert scene.z(*scene.start[:2]) == 0.0


def test_holes_are_filled_from_around_them() -> None:
    random = np.random.default_rng(0)
    height = np.full((40, 40), 0.3, np.float32)
    holes = random.random((40, 40)) < 0.4
    height[holes] = np.nan
    height[10:25, 10:25] = np.nan
    filled = fill(height)
    assert filled == pytest.approx(0.3, abs=1e-6)
    with pytest.raises(SceneError, match="no known cell"):
        fill(np.full((4, 4), np.nan, np.float32))


def test_rasterised_triangles_match_their_plane(tmp_path: Path) -> None:
    vertices = np.array([[0, 0, 0], [3, 0, 1.5], [0, 3, 3.0]])
    (tmp_path / "t.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in vertices) + "f 1 2 3\n")
    height, origin, overhangs = grid(read_geometry(tmp_path / "t.obj"), 0.1, "t")
    x, y = np.meshgrid(
        origin[0] + 0.1 * np.arange(height.shape[1]), origin[1] + 0.1 * np.arange(height.shape[0])
    )
    assert not overhangs
    known = np.isfinite(height)
    assert height[known] == pytest.approx((0.5 * x + y)[known], abs=1e-5)
    assert known.mean() == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("nowhere.ply", {}), "no such file"),
        (("nowhere", {}), "use one of flat, .*yard, .*or a file"),
        (("yard", {"resolution": 0.1}), "built in"),
        (("yard", {"seed": 3}), "no seed"),
        (("maze:x", {}), "whole number"),
        (("maze", {"seed": 1.5}), "whole number"),
        (("maze", {"seed": "x"}), "seed must be 1 finite number"),
        (("maze", {"sead": 1}), "no scene option sead"),
        (("p.png", {"resolution": 0.1, "height_range": [1.0]}), "height_range must be 2 finite numbers"),
        (("p.png", {"resolution": float("nan"), "height_range": (0.0, 1.0)}), "resolution must be"),
        (("p.png", {"resolution": 0.1}), "--height-range LOW HIGH"),
        (("p.png", {"resolution": 0.1, "height_range": (1.0, 0.0)}), "growing"),
        (("text.npz", {}), "not a readable"),
        (("text.png", {"resolution": 0.1, "height_range": (0.0, 1.0)}), "not a readable"),
        (("text.xyz", {}), "cannot read .xyz"),
        (("half.npz", {}), "lacks resolution, origin"),
        (("cliff.npz", {}), "no level place"),
        (("big.pcd", {"resolution": 0.0001}), "too many cells"),
    ],
)
def test_every_mistake_gets_one_line_that_says_what_to_do(
    options: tuple[str, dict], message: str, tmp_path: Path
) -> None:
    Image.fromarray(np.zeros((5, 5), np.uint8)).save(tmp_path / "p.png")
    for name in ("text.npz", "text.png", "text.xyz"):
        (tmp_path / name).write_text("hello")
    np.savez(tmp_path / "half.npz", height=np.zeros((5, 5)))
    steep = np.tile(np.arange(50, dtype=np.float32), (50, 1))
    np.savez(tmp_path / "cliff.npz", height=steep, resolution=0.1, origin=np.zeros(2))
    (tmp_path / "big.pcd").write_bytes(pcd("ascii"))
    name, more = options
    target = tmp_path / name if (tmp_path / name).exists() or name == "nowhere.ply" else name
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(target, **more)
    assert "\n" not in str(caught.value)


@needs_shared
def test_the_public_maze_imports_as_a_scene() -> None:
    scene = load_scene(TERRAIN / "maze.ply", resolution=0.05)
    x0, y0, x1, y1 = scene.extent
    assert (x1 - x0, y1 - y0) == pytest.approx((5.9, 5.1), abs=0.1)
    assert scene.trusted.mean() > 0.6
    assert abs(scene.z(*scene.start[:2])) < 0.05
    blocks = scene.height[scene.trusted]
    assert 0.1 < (blocks > 0.3).mean() < 0.4
    assert blocks.max() < 1.2
    assert abs(np.median(blocks)) < 0.05


PLY = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", PLY.format("binary_little_endian", -1).encode() + b"end_header\n" + bytes(24)),
        (
            "a.ply",
            PLY.format("binary_little_endian", 1).encode()
            + b"element face 1000000000\nproperty list char char v\nend_header\n"
            + bytes(12)
            + bytes([255] * 1000),
        ),
        ("a.pcd", b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS -1\nDATA binary\n" + bytes(24)),
        ("a.obj", b"v 1 2 3\nf 1 1 " + b"9" * 30),
    ],
    ids=["vertices", "corners", "points", "index"],
)
def test_counts_that_cannot_be_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match="broken"):
        read_geometry(tmp_path / name)


def test_faces_piled_up_without_end_are_refused() -> None:
    corners = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 0]], float)
    with pytest.raises(SceneError, match="many times"):
        grid(Geometry(corners, np.tile([[0, 1, 2]], (2000, 1))), 0.04, "pile")
