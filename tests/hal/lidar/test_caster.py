"""The ray casters against plain geometry and against each other."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from hal.lidar.caster import (
    CasterError,
    EmbreeCaster,
    NumbaCaster,
    OrientedBox,
    Surface,
    cast_onto_boxes,
    make_caster,
    pack_boxes,
)


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
        make_caster(height, 0.1, (0.0, 0.0))


def test_without_open3d_the_message_names_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "open3d", None)
    caster, message = make_caster(np.zeros((5, 5), np.float32), 0.1, (0.0, 0.0))
    assert isinstance(caster, NumbaCaster)
    assert "libusb-1.0-0 libgl1 libgomp1" in message
    assert "\n" not in message


def test_embree_and_numba_agree_within_a_millimetre() -> None:
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError):
        pytest.skip("open3d does not load on this machine")
    surface = rough(3, 200, 240)
    origins, directions = rays(4, 20_000)
    embree, message = make_caster(surface.height, surface.resolution, surface.origin)
    assert "open3d" in message
    a, b = embree.cast(origins, directions), NumbaCaster(surface).cast(origins, directions)
    # A ray that leaves exactly over the rim or grazes an edge may go either way in float32.
    assert np.mean(np.isinf(a) != np.isinf(b)) < 1e-3
    hit = np.isfinite(a) & np.isfinite(b)
    error = np.abs(a[hit] - b[hit])
    assert np.percentile(error, 99.9) < 1e-3


class FakeTensor:
    """`open3d.core.Tensor` as the caster uses it."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = np.asarray(array)

    def numpy(self) -> np.ndarray:
        return self.array


class FakeScene:
    """`open3d.t.geometry.RaycastingScene` of open3d 0.20 in plain numpy (Möller and Trumbore)."""

    def __init__(self, nthreads: int = 0, device: object = None) -> None:
        assert nthreads == 1

    def add_triangles(self, vertex_positions: FakeTensor, triangle_indices: FakeTensor) -> int:
        assert vertex_positions.array.dtype == np.float32
        assert triangle_indices.array.dtype == np.uint32
        self.corners = vertex_positions.array[triangle_indices.array].astype(float)  # (m, 3, 3)
        return 0

    def cast_rays(self, rays: FakeTensor, nthreads: int = 0) -> dict[str, FakeTensor]:
        assert nthreads == 1
        assert rays.array.dtype == np.float32
        a, b, c = self.corners.transpose(1, 0, 2)
        hit = []
        for ray in rays.array.astype(float):
            o, d = ray[:3], ray[3:]
            p = np.cross(d, c - a)
            det = (p * (b - a)).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                u = ((o - a) * p).sum(axis=1) / det
                q = np.cross(o - a, b - a)
                v, t = q @ d / det, (q * (c - a)).sum(axis=1) / det
            inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
            hit.append(t[inside].min(initial=np.inf))
        return {"t_hit": FakeTensor(np.array(hit, np.float32))}


def test_with_open3d_its_caster_gets_the_triangles_that_numba_sees(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = SimpleNamespace(
        core=SimpleNamespace(Tensor=FakeTensor),
        t=SimpleNamespace(geometry=SimpleNamespace(RaycastingScene=FakeScene)),
    )
    monkeypatch.setitem(sys.modules, "open3d", fake)
    surface = rough(5)
    caster, message = make_caster(surface.height, surface.resolution, surface.origin)
    assert isinstance(caster, EmbreeCaster)
    assert message == "LiDAR uses open3d's ray caster"
    assert isinstance(
        make_caster(surface.height, surface.resolution, surface.origin, prefer="numba")[0], NumbaCaster
    )
    origins, directions = rays(6, 400)
    a, b = caster.cast(origins, directions), NumbaCaster(surface).cast(origins, directions)
    assert a.dtype == np.float32
    both = np.isfinite(a) & np.isfinite(b)
    assert both.sum() > 50
    assert (np.isfinite(a) != np.isfinite(b)).sum() <= 2  # a ray exactly over an edge may go either way
    np.testing.assert_allclose(a[both], b[both], atol=1e-3)
    with_angles = caster.returns(origins, directions)
    assert np.array_equal(with_angles[0], a)
    assert with_angles[1][np.isfinite(a)].min() > 0.0
    assert caster.cast(origins[:0], directions[:0]).shape == (0,)


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
