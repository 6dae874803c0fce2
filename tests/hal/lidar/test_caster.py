"""The ray casters against plain geometry and against each other."""

import sys

import numpy as np
import pytest

from hal.lidar.caster import (
    CasterError,
    MeshCaster,
    NumbaCaster,
    OrientedBox,
    Surface,
    cast_onto_boxes,
    pack_boxes,
)
from hal.optional import open3d_hint
from tests.places import needs_open3d


def rough(seed: int, rows: int = 61, cols: int = 83) -> Surface:
    """Noise with walls: the worst case for a marcher."""
    random = np.random.default_rng(seed)
    height = random.normal(0.0, 0.05, (rows, cols)).astype(np.float32)
    height[:, 20:22] += 0.8
    height[40:42, 30:60] += 1.2
    return Surface(height, 0.05, (-1.0, -2.0))


def rays(seed: int, n: int, z: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    directions = random.normal(size=(n, 3)) * [1.0, 1.0, 0.3]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    origins = random.uniform([0.3, -1.5, z], [2.5, 0.5, z + 0.4], (n, 3))
    return origins.astype(np.float32), directions.astype(np.float32)


def brute_force(surface: Surface, origin: np.ndarray, direction: np.ndarray) -> float:
    """Moeller-Trumbore over every triangle, float64."""
    h = surface.height.astype(float)
    rows, cols = h.shape
    x, y = np.meshgrid(
        surface.origin[0] + surface.resolution * np.arange(cols),
        surface.origin[1] + surface.resolution * np.arange(rows),
    )
    v = np.stack([x, y, h], axis=-1)
    a, b, c, d = v[:-1, :-1], v[:-1, 1:], v[1:, 1:], v[1:, :-1]
    p = np.concatenate([a.reshape(-1, 3), a.reshape(-1, 3)])
    e1 = np.concatenate([b.reshape(-1, 3), c.reshape(-1, 3)]) - p
    e2 = np.concatenate([c.reshape(-1, 3), d.reshape(-1, 3)]) - p
    o, w = origin.astype(float), direction.astype(float)
    q = np.cross(w, e2)
    det = np.einsum("ij,ij->i", e1, q)
    det = np.where(np.abs(det) < 1e-15, np.nan, det)
    s = o - p
    u = np.einsum("ij,ij->i", s, q) / det
    k = np.cross(s, e1)
    t2 = k @ w / det
    t = np.einsum("ij,ij->i", e2, k) / det
    eps = 1e-9
    hit = (u >= -eps) & (t2 >= -eps) & (u + t2 <= 1 + eps) & (t >= 0)
    return float(t[hit].min()) if hit.any() else np.inf


def test_numba_agrees_with_every_triangle_tested_one_by_one() -> None:
    surface = rough(1)
    origins, directions = rays(2, 400)
    got = NumbaCaster(surface).cast(origins, directions)
    want = np.array([brute_force(surface, o, d) for o, d in zip(origins, directions, strict=True)])
    assert np.array_equal(np.isinf(got), np.isinf(want))
    hit = np.isfinite(want)
    assert hit.sum() > 150
    assert np.abs(got[hit] - want[hit]).max() < 1e-4


def test_flat_ground_is_met_where_geometry_says() -> None:
    surface = Surface(np.full((101, 101), 0.25, np.float32), 0.1, (-5.0, -5.0))
    caster = NumbaCaster(surface)
    origins = np.array([[0, 0, 1.25]] * 4, np.float32)
    directions = np.array([[0, 0, -1], [0.6, 0, -0.8], [1, 0, 0], [0, 0, 1]], np.float32)
    assert caster.cast(origins, directions) == pytest.approx([1.0, 1.25, np.inf, np.inf], abs=1e-5)
    assert caster.returns(origins, directions)[1] == pytest.approx([1.0, 0.8, 0.0, 0.0], abs=1e-5)


def test_the_angle_of_incidence_is_that_of_the_triangle_met() -> None:
    surface = rough(7)
    origins, directions = rays(8, 2000)
    ranges, cosine = NumbaCaster(surface).returns(origins, directions)
    hit = np.isfinite(ranges)
    want = surface.cos_incidence(origins, directions, ranges)
    assert hit.sum() > 700
    assert np.ptp(want[hit]) > 0.9
    assert np.mean(np.abs(cosine - want) > 1e-3) < 0.01  # on an edge either triangle may count


def test_rays_along_cell_borders_and_diagonals_do_not_slip_through() -> None:
    height = np.zeros((65, 65), np.float32)
    height[:, 40:] = 1.0
    caster = NumbaCaster(Surface(height, 0.1, (0.0, 0.0)))
    y = np.arange(1, 63, dtype=np.float32) * np.float32(0.1)
    origins = np.stack([np.full_like(y, 0.5), y, np.full_like(y, 0.5)], axis=1)
    directions = np.tile(np.array([[1, 0, 0]], np.float32), (len(y), 1))
    assert caster.cast(origins, directions) == pytest.approx(np.full(len(y), 3.45), abs=1e-4)
    s = np.float32(np.sqrt(0.5))
    diagonal = caster.cast(np.array([[0.5, 0.5, 0.5]], np.float32), np.array([[s, s, 0.0]], np.float32))
    assert diagonal[0] == pytest.approx(3.45 * np.sqrt(2), abs=1e-3)


def test_a_ray_that_starts_outside_the_terrain_enters_it() -> None:
    caster = NumbaCaster(Surface(np.zeros((11, 11), np.float32), 1.0, (0.0, 0.0)))
    got = caster.cast(np.array([[-4, 5, 4]], np.float32), np.array([[0.8, 0, -0.6]], np.float32))
    assert got[0] == pytest.approx(4 / 0.6, abs=1e-4)


def test_boxes_shorten_rays() -> None:
    boxes = pack_boxes(
        [
            OrientedBox((2.0, 0.0, 0.5), (1.0, 1.0, 1.0)),
            OrientedBox((0.0, 3.0, 0.5), (2.0, 2.0, 1.0), np.pi / 4),
        ]
    )
    origins = np.array([[0, 0, 0.5]] * 4, np.float32)
    directions = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.float32)
    ranges = np.full(4, 9.0, np.float32)
    cast_onto_boxes(boxes, origins, directions, ranges)
    assert ranges == pytest.approx([1.5, 3.0 - np.sqrt(2), 9.0, 9.0], abs=1e-5)


def test_unknown_cells_are_refused() -> None:
    height = np.zeros((5, 5), np.float32)
    height[2, 2] = np.nan
    with pytest.raises(CasterError, match="finite"):
        Surface(height, 0.1, (0.0, 0.0))


def triangles_of(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """The height surface as vertices (n, 3) and triangles (m, 3)."""
    rows, cols = surface.height.shape
    x = surface.origin[0] + surface.resolution * np.arange(cols)
    y = surface.origin[1] + surface.resolution * np.arange(rows)
    vertices = np.stack([*np.meshgrid(x, y), surface.height], axis=-1).reshape(-1, 3)
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).reshape(-1)
    lower = np.stack([corner, corner + 1, corner + cols + 1], axis=1)
    upper = np.stack([corner, corner + cols + 1, corner + cols], axis=1)
    return vertices, np.concatenate([lower, upper])


def nearest_triangle(
    vertices: np.ndarray, triangles: np.ndarray, origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Range and |cos| of the nearest hit of each ray, in plain numpy (Möller and Trumbore 1997)."""
    a, b, c = vertices[triangles].astype(float).transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    ranges, cosine = np.full(len(origins), np.inf), np.zeros(len(origins))
    for k, (o, d) in enumerate(zip(origins.astype(float), directions.astype(float), strict=True)):
        p = np.cross(d, c - a)
        det = (p * (b - a)).sum(axis=1)
        u = ((o - a) * p).sum(axis=1) / det
        q = np.cross(o - a, b - a)
        v, t = q @ d / det, (q * (c - a)).sum(axis=1) / det
        t = np.where((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0), t, np.inf)
        if np.isfinite(t.min()):
            ranges[k], cosine[k] = t.min(), abs(normal[t.argmin()] @ d)
    return ranges, cosine


def test_a_mesh_is_cast_as_plain_numpy_does() -> None:
    needs_open3d()
    random = np.random.default_rng(7)
    corner = random.uniform(-4.0, 4.0, (60, 1, 3))
    vertices = (corner + random.uniform(-1.5, 1.5, (60, 3, 3))).reshape(-1, 3)
    triangles = np.arange(180).reshape(-1, 3)
    origins = random.uniform(-5.0, 5.0, (500, 3)).astype(np.float32)
    directions = random.normal(size=(500, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    ranges, cosine = MeshCaster(vertices, triangles).returns(origins, directions)
    expected, angle = nearest_triangle(vertices, triangles, origins, directions)
    assert ranges.dtype == np.float32
    agree = np.isclose(ranges, expected, atol=1e-3)  # a ray over an edge may go either way in float32
    assert np.isfinite(expected).sum() > 50
    assert (~agree).sum() <= 2
    np.testing.assert_allclose(cosine[agree], angle[agree], atol=1e-3)


def test_the_surface_and_its_mesh_are_cast_alike() -> None:
    needs_open3d()
    surface = rough(3, 200, 240)
    origins, directions = rays(4, 20_000)
    mesh = MeshCaster(*triangles_of(surface))
    (a, cos_a), (b, cos_b) = (caster.returns(origins, directions) for caster in (mesh, NumbaCaster(surface)))
    # A ray that leaves exactly over the rim or grazes an edge may go either way in float32.
    assert np.mean(np.isinf(a) != np.isinf(b)) < 1e-3
    hit = np.isfinite(a) & np.isfinite(b)
    assert np.percentile(np.abs(a[hit] - b[hit]), 99.9) < 1e-3
    assert np.percentile(np.abs(cos_a[hit] - cos_b[hit]), 99.0) < 1e-2
    assert mesh.cast(origins[:0], directions[:0]).shape == (0,)


def test_without_open3d_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(CasterError, match=r"surfaces above one another.*rbtrg-robot\[mesh\]") as caught:
        MeshCaster(np.eye(3), np.array([[0, 1, 2]]))
    assert "\n" not in str(caught.value)
    assert "libusb-1.0-0 libgl1 libx11-6 libgomp1" in open3d_hint(ImportError("libusb-1.0.so.0: cannot open"))


def test_the_lidar_sees_the_same_triangles_as_the_physics() -> None:
    mujoco = pytest.importorskip("mujoco")
    random = np.random.default_rng(0)
    height = random.uniform(0.05, 0.4, (6, 7)).astype(np.float32)
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><hfield name="h" nrow="6" ncol="7" size="0.6 0.5 1 0.1"/></asset>'
        '<worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>'
    )
    model.hfield_data[:] = height.ravel()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    directions = random.normal(size=(200, 3)) * 0.2 - [0.0, 0.0, 1.0]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    origins = random.uniform([-0.5, -0.4, 1.0], [0.5, 0.4, 1.0], (200, 3))
    got = NumbaCaster(Surface(height, 0.2, (-0.6, -0.5))).cast(
        origins.astype(np.float32), directions.astype(np.float32)
    )
    geom = np.zeros(1, np.int32)
    want = np.array(
        [
            mujoco.mj_ray(model, data, o, d, None, 1, -1, geom, None)
            for o, d in zip(origins, directions, strict=True)
        ]
    )
    hit = np.isfinite(got) & (want > 0)
    assert hit.sum() > 150
    assert got[hit] == pytest.approx(want[hit], abs=1e-5)
