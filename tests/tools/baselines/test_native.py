"""The native graph against the released planner's own graphs and against plain-numpy readings of its kernels."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning import NoRoute
from planning.graph.edge_risk import edge_risk, top_two_z
from tests.places import GOLDEN, needs_shared
from tools.baselines.native import NativeParams, _draw, disc_blocked, native_graph, window_minmax
from tools.bench.planning.oracle import NativeOracle


def _terrain(seed: int, n: int = 120, res: float = 0.05) -> ElevationGrid:
    """Rolling ground with a wall and rocks: enough to block some draws and wires."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:n, 0:n] * res
    z = (
        0.08 * np.sin(1.3 * x + rng.uniform(0, 6))
        + 0.06 * np.cos(1.7 * y)
        + 0.01 * rng.standard_normal((n, n))
    )
    z[n // 2 : n // 2 + 6, : n // 2] += 1.0
    for _ in range(12):
        r, c = rng.integers(0, n, 2)
        z[r : r + 5, c : c + 5] += rng.uniform(0.1, 0.5)
    return ElevationGrid(z.astype(np.float32), np.ones((n, n), bool), (0.5 * res, 0.5 * res), res)


@needs_shared
@pytest.mark.parametrize("name", ["20m_mountain", "8m_dense"])
def test_graph_equals_the_released_planner(name: str) -> None:
    with np.load(GOLDEN / f"trg_native_{name}.npz") as z:
        data = {k: z[k] for k in z.files}
    shape = data["height"].shape
    grid = ElevationGrid(
        data["height"], np.ones(shape, bool), tuple(data["origin"]), float(data["resolution"])
    )
    keys = ("expand_dist", "robot_size", "height_threshold", "collision_threshold")
    params = NativeParams(sample_num=int(data["sample_num"]), **{k: float(data[k]) for k in keys})
    graph = native_graph(grid, tuple(data["start"]), params, int(data["seed"]))

    want = data["nodes"].astype(np.float64)
    assert graph.nodes.shape == want.shape
    distance = np.hypot(*(graph.nodes[:, None, :2] - want[None, :, :2]).transpose(2, 0, 1))
    match = distance.argmin(axis=1)
    assert len(set(match)) == len(want)
    assert distance.min(axis=1).max() < 1e-6
    assert np.abs(graph.nodes[:, 2] - want[match, 2]).max() < 2e-3
    source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
    got = {(match[a], match[b]): r for a, b, r in zip(source, graph.indices, graph.risk, strict=True)}
    wanted = {}
    for (a, b), r in zip(data["edges"].tolist(), data["risk"].tolist(), strict=True):
        wanted[a, b] = wanted[b, a] = r
    assert got.keys() == wanted.keys()
    assert max(abs(got[k] - wanted[k]) for k in got) < 1e-3


def test_random_stream_is_mt19937() -> None:
    state = np.random.RandomState(11)
    key = state.get_state(legacy=True)[1].astype(np.uint32)
    pos = np.array([624])
    want = state.randint(0, 2**32, size=1500, dtype=np.uint32).astype(np.float32) / np.float32(2.0**32)
    assert [_draw(key, pos) for _ in range(1500)] == want.tolist()


def test_disc_test_equals_its_definition() -> None:
    grid = _terrain(3)
    z = grid.height.copy()
    z[20:26, 30:50] = np.nan
    xs = (0.025 + np.arange(120) * 0.05).astype(np.float32)
    k = 7
    low, high = window_minmax(z, k)
    rng = np.random.default_rng(0)
    seen = [0, 0]
    for x, y in rng.uniform(-0.4, 6.4, (600, 2)).astype(np.float32):
        radius, limit, share = np.float32(0.3), np.float32(0.12), np.float32(0.1)
        inside = (xs[None, :] - x) ** 2 + (xs[:, None] - y) ** 2 <= radius * radius
        points = np.sort(z[inside & ~np.isnan(z)])
        want = True
        if len(points):
            want = np.mean(np.abs(points - points[len(points) // 2]) > limit) > share
        got = disc_blocked(
            z, xs, xs, 0.025, 0.025, 0.05, low, high, k, x, y, radius, limit, share, np.empty(300, np.float32)
        )
        assert got == want
        seen[int(want)] += 1
    assert min(seen) > 50


@pytest.mark.parametrize("native", [True, False])
def test_edge_risk_equals_numpy_pca(native: bool) -> None:
    grid = _terrain(4)
    xs = (0.025 + np.arange(120) * 0.05).astype(np.float32)
    rng = np.random.default_rng(1)
    risky = 0
    for _ in range(200):
        a = rng.uniform(0.5, 5.5, 2).astype(np.float32)
        angle, d = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 0.9)
        b = (a + d * np.array([np.cos(angle), np.sin(angle)])).astype(np.float32)
        got = edge_risk(grid.height, xs, xs, 0.025, 0.025, 0.05, *a, *b, np.float32(0.3), native)
        u = (b - a) / np.hypot(*(b - a))
        half = np.hypot(*(b - a)) / 2
        major = 0.3 if half < 0.3 else np.hypot(half, 0.3)
        px, py = np.meshgrid(xs - (a[0] + b[0]) / 2, xs - (a[1] + b[1]) / 2)
        sign = 1.0 if native else -1.0
        lx, ly = u[0] * px - sign * u[1] * py, sign * u[1] * px + u[0] * py
        inside = (lx / major) ** 2 + (ly / 0.3) ** 2 <= 1.0
        points = np.stack([px[inside], py[inside], grid.height[inside]])
        _, vectors = np.linalg.eigh(np.cov(points.astype(np.float64)))
        want = 0.8 * abs(vectors[2, 2]) + 0.2 * abs(vectors[2, 1])
        want /= np.sqrt(3.0) if native else 1.0
        assert got == pytest.approx(0.0 if want < 0.1 else want, abs=5e-3)
        risky += got > 0
    assert risky > 20


def test_eigenvectors_equal_lapack() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        points = rng.standard_normal((3, 8)) * rng.uniform(0.01, 1.0, (3, 1))
        c = np.cov(points)
        _, v = np.linalg.eigh(c)
        got = top_two_z(c[0, 0], c[0, 1], c[0, 2], c[1, 1], c[1, 2], c[2, 2])
        assert got == pytest.approx((abs(v[2, 2]), abs(v[2, 1])), abs=1e-9)


@pytest.mark.parametrize(
    "params",
    [
        NativeParams(expand_dist=0.6, sample_num=7, height_threshold=0.16, collision_threshold=0.1),
        NativeParams(expand_dist=0.38, sample_num=12, height_threshold=0.2, collision_threshold=0.1),
    ],
)
def test_graph_equals_the_plain_python_reading(params: NativeParams) -> None:
    grid = _terrain(7, n=80)
    graph = native_graph(grid, (1.0, 1.0), params, seed=9)
    oracle = NativeOracle(grid, (1.0, 1.0), params, seed=9)
    assert len(graph.nodes) > 40
    np.testing.assert_allclose(graph.nodes, oracle.nodes, atol=1e-6)
    assert {tuple(e) for e in graph.edges.tolist()} == {tuple(e) for e in oracle.edges.tolist()}
    source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
    want = dict(zip(map(tuple, oracle.edges.tolist()), oracle.risk.tolist(), strict=True))
    for a, b, r in zip(source.tolist(), graph.indices.tolist(), graph.risk.tolist(), strict=True):
        assert r == pytest.approx(want[min(a, b), max(a, b)], abs=1e-3)


def test_same_seed_same_graph_other_seed_another() -> None:
    grid = _terrain(5)
    params = NativeParams(height_threshold=0.15, collision_threshold=0.1, sample_num=12)
    a = native_graph(grid, (1.0, 1.0), params, seed=3)
    b = native_graph(grid, (1.0, 1.0), params, seed=3)
    c = native_graph(grid, (1.0, 1.0), params, seed=4)
    assert len(a.nodes) > 100
    assert a.nodes.tobytes() == b.nodes.tobytes()
    assert a.indices.tobytes() == b.indices.tobytes()
    assert a.nodes.tobytes() != c.nodes.tobytes()


def test_no_free_root_is_a_typed_error() -> None:
    z = np.random.default_rng(0).uniform(0.0, 5.0, (60, 60)).astype(np.float32)
    grid = ElevationGrid(z, np.ones_like(z, bool), (0.0, 0.0), 0.05)
    with pytest.raises(NoRoute) as caught:
        native_graph(grid, (1.0, 1.0), NativeParams(), 0)
    assert caught.value.reason == "start_not_on_graph"
