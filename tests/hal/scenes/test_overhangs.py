"""Meshes with surfaces above one another: where the ground is, and what the LiDAR sees of the rest."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hal.errors import OperatorError
from hal.scenes import load_scene
from hal.scenes.gridding import grid
from hal.scenes.readers import read_geometry
from hal.scenes.scene import Geometry
from tests.places import ROOT, needs_open3d

QUADS = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
"""The sides of a box with outward faces: bottom, top, and four walls."""


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Geometry:
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    vertices = np.array([(x, y, z) for z in (z0, z1) for x, y in ring], float)
    return Geometry(vertices, np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]]))


def together(*parts: Geometry) -> Geometry:
    shift = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Geometry(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + k for part, k in zip(parts, shift, strict=True)]),
    )


SLAB = box((0.0, 0.0, -0.2), (6.0, 4.0, 0.0))
"""The floor: 6 x 4 m, its top at 0."""


@pytest.mark.parametrize(
    ("part", "inside", "overhangs"),
    [
        (box((2.0, 1.0, 2.2), (4.0, 3.0, 2.4)), 0.0, True),
        (box((2.0, 1.0, 0.5), (4.0, 3.0, 0.6)), 0.6, False),
        (box((2.0, 1.0, 0.0), (4.0, 3.0, 1.5)), 1.5, False),
        (box((2.0, 1.0, -0.1), (4.0, 3.0, 1.5)), 1.5, False),
        (box((2.0, 1.0, -0.2), (4.0, 3.0, 1.5)), 1.5, False),
    ],
    ids=["ceiling", "table too low to pass under", "box on the floor", "sunk box", "box through the floor"],
)
def test_the_ground_is_the_lowest_floor_with_headroom(part: Geometry, inside: float, overhangs: bool) -> None:
    height, origin, found = grid(together(SLAB, part), 0.1, "scene")
    assert found == overhangs
    assert origin == pytest.approx((0.0, 0.0))
    assert height[20, 30] == pytest.approx(inside)
    assert height[5, 5] == pytest.approx(0.0)


def test_faces_that_do_not_say_which_side_is_free_leave_the_highest_surface() -> None:
    upside_down = Geometry(SLAB.vertices, SLAB.triangles[:, ::-1])
    sheet = Geometry(
        np.array([[2, 1, 2.0], [4, 1, 2.0], [4, 3, 2.0], [2, 3, 2.0]], float),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    assert grid(upside_down, 0.1, "scene")[0][20, 30] == pytest.approx(0.0)
    assert grid(together(SLAB, sheet), 0.1, "scene")[0][20, 30] == pytest.approx(2.0)


def hall(folder: Path) -> Path:
    """A floor under a ceiling at 2.2 m over its middle, as an OBJ file."""
    mesh = together(SLAB, box((2.0, 1.0, 2.2), (4.0, 3.0, 2.4)))
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.triangles]
    (folder / "hall.obj").write_text("\n".join(lines) + "\n")
    return folder / "hall.obj"


def test_the_lidar_sees_the_ceiling_and_the_robot_stands_below_it(tmp_path: Path) -> None:
    needs_open3d()
    scene = load_scene(hall(tmp_path), start=(3.0, 2.0, 0.0))
    assert scene.z(3.0, 2.0) == pytest.approx(0.0, abs=1e-6)
    up, down, ahead = np.eye(3, dtype=np.float32)[2], -np.eye(3, dtype=np.float32)[2], np.eye(3)[0]
    origins = np.array([[3, 2, 0.5], [3, 2, 0.5], [0.5, 2, 2.3], [0.5, 2, 0.5]], np.float32)
    directions = np.array([up, down, ahead, ahead], np.float32)
    ranges, cosine = scene.caster().returns(origins, directions)
    assert ranges == pytest.approx([1.7, 0.5, 1.5, np.inf], abs=1e-5)
    assert cosine == pytest.approx([1.0, 1.0, 1.0, 0.0], abs=1e-5)


def test_without_open3d_such_a_scene_is_refused_before_a_robot_stands_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    scene = load_scene(hall(tmp_path), start=(3.0, 2.0, 0.0))
    with pytest.raises(OperatorError, match="open3d"):
        scene.caster()


@pytest.mark.parametrize(
    ("ending", "ascii_"), [("ply", True), ("ply", False), ("stl", False), ("obj", True)], ids=str
)
def test_meshes_that_open3d_wrote_are_read_as_it_reads_them(
    ending: str, ascii_: bool, tmp_path: Path
) -> None:
    needs_open3d()
    import open3d

    mesh = together(SLAB, box((2.0, 1.0, 2.2), (4.0, 3.0, 2.4)))
    written = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.triangles)
    )
    written.compute_vertex_normals()
    path = tmp_path / f"mesh.{ending}"
    assert open3d.io.write_triangle_mesh(str(path), written, write_ascii=ascii_)
    theirs, ours = open3d.io.read_triangle_mesh(str(path)), read_geometry(path)
    corners = np.asarray(theirs.vertices)[np.asarray(theirs.triangles)]
    assert len(ours.triangles) == len(mesh.triangles)
    np.testing.assert_allclose(ours.vertices[ours.triangles], corners, atol=1e-6)


@pytest.mark.parametrize("ending", ["ply", "pcd"])
@pytest.mark.parametrize("ascii_", [True, False], ids=["ascii", "binary"])
def test_clouds_that_open3d_wrote_are_read_as_it_reads_them(
    ending: str, ascii_: bool, tmp_path: Path
) -> None:
    needs_open3d()
    import open3d

    random = np.random.default_rng(2)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(random.normal(size=(400, 3))))
    cloud.colors = open3d.utility.Vector3dVector(random.uniform(size=(400, 3)))
    path = tmp_path / f"cloud.{ending}"
    assert open3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_)
    theirs = np.asarray(open3d.io.read_point_cloud(str(path)).points)
    assert len(theirs) == 400
    np.testing.assert_allclose(read_geometry(path).vertices, theirs, atol=1e-6)


def test_the_simulator_and_the_scene_files_need_no_open3d(tmp_path: Path) -> None:
    (tmp_path / "floor.obj").write_text("v 0 0 0\nv 6 0 0\nv 6 6 0\nv 0 6 0\nf 1 2 3 4\n")
    code = """
import sys
sys.modules["open3d"] = None
from hal.mujoco.backend import MujocoBackend
from hal.scenes import load_scene
from hal.types import LidarScan
scene = load_scene(sys.argv[1])
backend = MujocoBackend(scene, lidar_step=40)
backend.connect()
samples = [s for k in range(1, 31) for s in backend.read(k * 10_000_000)]
scans = [s for s in samples if isinstance(s, LidarScan) and s.name == "main"]
assert len(scans) == 3 and len(scans[0].points) > 50, [len(s.points) for s in scans]
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "floor.obj")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
    )
    assert done.returncode == 0, done.stderr
