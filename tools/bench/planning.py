"""Planning times: graph builds and updates here, queries in `planning_query`.

Values are the least of several repeats of this thread's CPU time, after the kernels were compiled. Baselines, from the
same run: the native builds' is the same graph grown in plain numpy (`planning_oracle`, whole problem); the update's is a full
rebuild of the same map; the large build's is that numpy build of 400 m^2, scaled by area to 10,000 m^2.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from mapping.grid import ElevationGrid
from planning.graph import GraphParams, TraversalGraph
from tools.bench.planning_oracle import NativeOracle
from tools.bench.report import Report

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT.parent / "shared" / "golden"
MOUNTAIN = GraphParams(
    mode="native",
    expand_dist=0.6,
    robot_size=0.3,
    sample_num=7,
    height_threshold=0.16,
    collision_threshold=0.1,
)
DENSE = GraphParams(mode="native")
Problem = tuple[ElevationGrid, tuple[float, float], GraphParams, int]


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


def cpu_seconds(work: Callable[[], object], repeats: int) -> float:
    """Least CPU time of this thread over `repeats` calls."""
    best = np.inf
    for _ in range(repeats):
        start = time.thread_time()
        work()
        best = min(best, time.thread_time() - start)
    return float(best)


def _update_ms(report: Report) -> None:
    """2 % of the cells in one square window somewhere, heights changed so that obstacles come and go."""
    grid, start, _, seed = dense_map()
    params = GraphParams()
    rng = np.random.default_rng(0)
    graph = TraversalGraph.build(grid, start, params, seed)
    side = round(np.sqrt(0.02) * grid.shape[0])
    height = grid.height.copy()
    times = []
    for _ in range(60):
        r, c = (int(v) for v in rng.integers(0, grid.shape[0] - side, 2))
        height = height.copy()
        height[r : r + side, c : c + side] = grid.height[r : r + side, c : c + side] + rng.uniform(-0.3, 0.3)
        changed = np.zeros(grid.shape, bool)
        changed[r : r + side, c : c + side] = True
        now = ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)
        before = time.thread_time()
        graph.update(now, changed)
        times.append(time.thread_time() - before)
    full = cpu_seconds(lambda: TraversalGraph.build(grid, start, params, seed), 5)
    report.add("build_ms.corrected_8m", 1e3 * full, "ms")
    report.add("update_ms", 1e3 * float(np.median(times)), "ms", limit=10.0, baseline=1e3 * full)


_MEMORY = """
import sys
from pathlib import Path
import numpy as np
from mapping.grid import ElevationGrid
from planning.graph import TraversalGraph
z = np.load(sys.argv[1])
TraversalGraph.build(ElevationGrid(z[:80, :80].copy(), np.ones((80, 80), bool), (0.025, 0.025), 0.05), (1.0, 1.0))
grid = ElevationGrid(z, np.ones(z.shape, bool), (0.025, 0.025), 0.05)
def kilobytes(key):
    return int(Path("/proc/self/status").read_text().split(key + ":")[1].split()[0])
before = kilobytes("VmRSS")
graph = TraversalGraph.build(grid, (1.0, 1.0))
print((kilobytes("VmHWM") - before) * 1024 / 1e6)
"""


def _large(report: Report, baseline: float) -> tuple[TraversalGraph, ElevationGrid]:
    grid = rough_terrain(100.0, 0.05, 3)
    start = time.thread_time()
    graph = TraversalGraph.build(grid, (1.0, 1.0))
    report.add("large.build_s", time.thread_time() - start, "s", limit=6.0, baseline=baseline)
    report.add("large.nodes", len(graph.nodes), "nodes")
    # Peak of a process of its own that does nothing else; the map itself is counted before the build.
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "z.npy", grid.height)
        command = [sys.executable, "-c", _MEMORY, str(Path(folder) / "z.npy")]
        output = subprocess.run(
            command, check=True, capture_output=True, text=True, timeout=120, cwd=ROOT
        ).stdout
    report.add("large.memory_mb", float(output), "MB", limit=300.0)
    return graph, grid


def run(args: list[str]) -> Report:
    """Rows of the graph, then those of the queries."""
    report = Report("planning")
    area_s = 0.0
    for key, problem, limit in (("native_20m", mountain_map(), 40.0), ("native_8m", dense_map(), 120.0)):
        TraversalGraph.build(*problem)
        value = cpu_seconds(partial(TraversalGraph.build, *problem), 7)
        baseline = cpu_seconds(partial(NativeOracle, *problem), 1)
        report.add(f"build_ms.{key}", 1e3 * value, "ms", limit=limit, baseline=1e3 * baseline)
        if key == "native_20m":
            area_s = baseline * 10_000.0 / 400.0
    _update_ms(report)
    graph, grid = _large(report, area_s)
    if importlib.util.find_spec("tools.bench.planning_query"):
        importlib.import_module("tools.bench.planning_query").rows(report, graph, grid)
    return report
