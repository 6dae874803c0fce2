"""Small seeded terrains and lattice graphs for the planning tests."""

from __future__ import annotations

import numpy as np

from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from tests.places import GOLDEN


def rough(seed: int, size: float = 3.0, resolution: float = 0.05, untrusted: float = 0.1) -> ElevationGrid:
    """Waves, a few boxes and patches of untrusted cells."""
    rng = np.random.default_rng(seed)
    n = round(size / resolution)
    y, x = np.mgrid[0:n, 0:n] * resolution
    z = np.zeros((n, n))
    for _ in range(4):
        k = rng.normal(size=2) * 2.0
        z += 0.08 * np.sin(k[0] * x + k[1] * y + rng.uniform(0, 6))
    for _ in range(4):
        r, c = rng.integers(0, n - 8, 2)
        z[r : r + rng.integers(2, 8), c : c + rng.integers(2, 8)] += rng.uniform(-0.3, 0.5)
    trusted = np.ones((n, n), bool)
    while trusted.mean() > 1 - untrusted:
        r, c = rng.integers(0, n - 3, 2)
        trusted[r : r + rng.integers(1, 12), c : c + rng.integers(1, 12)] = False
    return ElevationGrid(z.astype(np.float32), trusted, (-0.4, 0.7), resolution)


def flat(width: float, height: float, resolution: float = 0.05) -> ElevationGrid:
    """Level trusted ground, x 0..width, y 0..height."""
    shape = (round(height / resolution) + 1, round(width / resolution) + 1)
    return ElevationGrid(np.zeros(shape, np.float32), np.ones(shape, bool), (0.0, 0.0), resolution)


def lattice(grid: ElevationGrid, step: float, seed: int = 0, jitter: float = 0.1) -> TraversalGraph:
    """Eight-connected jittered lattice over the grid with random native risks."""
    rng = np.random.default_rng(seed)
    x0, y0, x1, y1 = grid.extent
    xs, ys = np.arange(x0 + 0.2, x1 - 0.1, step), np.arange(y0 + 0.2, y1 - 0.1, step)
    gx, gy = np.meshgrid(xs, ys)
    xy = np.column_stack([gx.ravel(), gy.ravel()]) + rng.uniform(-jitter, jitter, (gx.size, 2))
    col = np.clip(np.round((xy[:, 0] - x0) / grid.resolution).astype(int), 0, grid.shape[1] - 1)
    row = np.clip(np.round((xy[:, 1] - y0) / grid.resolution).astype(int), 0, grid.shape[0] - 1)
    nodes = np.column_stack([xy, np.nan_to_num(grid.height[row, col])])
    d = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    a, b = np.nonzero(np.triu(d < step * 1.6, 1))
    risk = np.where(rng.uniform(size=a.size) < 0.5, 0.0, rng.uniform(0.1, 0.4, a.size))
    return TraversalGraph.from_edges(nodes, np.column_stack([a, b]), risk)


def golden_world() -> tuple[ElevationGrid, TraversalGraph, dict[str, np.ndarray]]:
    """The reference terrain, graph and results."""
    with np.load(GOLDEN / "body_risk_8m.npz") as data:
        want = {k: data[k] for k in data.files if k != "graph"}
    with np.load(GOLDEN / "trg_native_8m_dense.npz") as data:
        g = {k: data[k] for k in data.files}
    count = int(np.prod(want["shape"]))
    trusted = np.unpackbits(want["trusted"])[:count].reshape(want["shape"]).astype(bool)
    grid = ElevationGrid(g["height"], trusted, tuple(g["origin"]), float(g["resolution"]))
    return grid, TraversalGraph.from_edges(g["nodes"], g["edges"], g["risk"]), want
