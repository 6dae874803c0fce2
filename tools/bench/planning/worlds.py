"""Maps of the planning benchmarks: the reference terrains where they are beside the project, else made-up ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapping.grid import ElevationGrid
from tools.baselines.native import NativeParams

ROOT = Path(__file__).resolve().parents[3]
GOLDEN = ROOT.parent / "shared" / "golden"
MOUNTAIN = NativeParams(
    expand_dist=0.6,
    robot_size=0.3,
    sample_num=7,
    height_threshold=0.16,
    collision_threshold=0.1,
)
DENSE = NativeParams()
Problem = tuple[ElevationGrid, tuple[float, float], NativeParams, int]


def rough_terrain(size: float, res: float, seed: int, rocks_per_m2: float = 0.1) -> ElevationGrid:
    """Rolling ground with boxes and pits and 5 mm noise; flat around (1, 1) m. All trusted."""
    rng = np.random.default_rng(seed)
    n = round(size / res)
    y, x = (np.mgrid[0:n, 0:n] * res).astype(np.float32)
    z = 0.15 * np.sin(0.9 * x + 0.2 * y) + 0.12 * np.cos(1.1 * y) + 0.02 * np.sin(4.0 * x) * np.cos(3.0 * y)
    for _ in range(round(rocks_per_m2 * size * size)):
        r, c = rng.integers(0, n, 2)
        h, w = (rng.uniform(0.2, 1.2, 2) / res).astype(int) + 1
        z[r : r + h, c : c + w] += rng.uniform(-0.4, 0.8)
    near = np.hypot(x - 1.0, y - 1.0) < 1.0
    z[near] = 0.0
    z += rng.normal(0.0, 0.005, z.shape)
    return ElevationGrid(z.astype(np.float32), np.ones((n, n), bool), (0.5 * res, 0.5 * res), res)


def _golden(name: str) -> Problem | None:
    path = GOLDEN / f"trg_native_{name}.npz"
    if not path.exists():
        return None
    with np.load(path) as z:
        grid = ElevationGrid(
            z["height"], np.ones(z["height"].shape, bool), tuple(z["origin"]), float(z["resolution"])
        )
        return grid, tuple(z["start"].tolist()), MOUNTAIN if "mountain" in name else DENSE, int(z["seed"])


def mountain_map() -> Problem:
    """20 x 20 m at 0.1 m: grid, start, parameters, seed; the reference terrain where it is beside the project."""
    return _golden("20m_mountain") or (rough_terrain(20.0, 0.1, 1), (1.0, 1.0), MOUNTAIN, 1)


def dense_map() -> Problem:
    """8 x 8 m at 0.02 m, the dense setting: grid, start, parameters, seed."""
    return _golden("8m_dense") or (rough_terrain(8.0, 0.02, 1), (1.0, 1.0), DENSE, 7)
