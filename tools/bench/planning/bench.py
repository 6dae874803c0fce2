"""Planning: graph builds and updates here, queries in `query`, the path's watch in `watch`, ways near the step limit in
`crossings`.

    python -m tools.bench planning [--only watch|crossings] [--json]

The large build is the graph and its risk table with every edge evaluated, which then serves all queries on that map;
its two parts have rows of their own, and `large.query_cold_s` is a query that finds neither table nor evaluation.

Values are the least of several repeats of this thread's CPU time, after the kernels were compiled. Baselines, from the
same run: the native builds' is the same graph grown in plain numpy (`_planning_oracle`, whole problem); the update's is
a full rebuild of the same map; the large build's is that numpy build of 400 m^2, scaled by area to 10,000 m^2.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from tools.baselines.native import native_graph
from tools.bench.planning import crossings, query, watch
from tools.bench.planning.oracle import NativeOracle
from tools.bench.planning.worlds import dense_map, mountain_map, rough_terrain
from tools.bench.report import Report

ROOT = Path(__file__).resolve().parents[3]
LARGE_SIDE = 100.0
"""Side of the large map [m]."""


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
    for _ in range(query.UPDATE_COUNT):
        r, c = (int(v) for v in rng.integers(0, grid.shape[0] - side, 2))
        height = height.copy()
        height[r : r + side, c : c + side] = grid.height[r : r + side, c : c + side] + rng.uniform(-0.3, 0.3)
        now = ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)
        before = time.thread_time()
        graph.update(now, [(r, c, r + side, c + side)])
        times.append(time.thread_time() - before)
    full = cpu_seconds(lambda: TraversalGraph.build(grid, start, params, seed), 5)
    report.add("build_ms.corrected_8m", 1e3 * full, "ms")
    report.add("update_ms", 1e3 * float(np.median(times)), "ms", limit=10.0, baseline=1e3 * full)


_MEMORY = """
import sys
from pathlib import Path
import numpy as np
from mapping.grid import ElevationGrid
from planning.risk import BodyModel
from planning.graph import TraversalGraph
from planning.risk.table import RiskTable
z = np.load(sys.argv[1])
small = ElevationGrid(z[:80, :80].copy(), np.ones((80, 80), bool), (0.025, 0.025), 0.05)
RiskTable(TraversalGraph.build(small, (1.0, 1.0)), small, BodyModel()).evaluate_edges()
grid = ElevationGrid(z, np.ones(z.shape, bool), (0.025, 0.025), 0.05)
def kilobytes(key):
    return int(Path("/proc/self/status").read_text().split(key + ":")[1].split()[0])
before = kilobytes("VmRSS")
graph = TraversalGraph.build(grid, (1.0, 1.0))
table = RiskTable(graph, grid, BodyModel())
table.evaluate_edges()
print((kilobytes("VmHWM") - before) * 1024 / 1e6)
"""


def _large(report: Report, baseline: float) -> RiskTable:
    grid = rough_terrain(LARGE_SIDE, 0.05, 3)
    small = rough_terrain(5.0, 0.05, 3)
    RiskTable(TraversalGraph.build(small, (1.0, 1.0)), small, BodyModel()).evaluate_edges()
    start = time.thread_time()
    graph = TraversalGraph.build(grid, (1.0, 1.0))
    built = time.thread_time()
    table = RiskTable(graph, grid, BodyModel())
    table.evaluate_edges()
    end = time.thread_time()
    report.add("large.build_s", end - start, "s", limit=6.0, baseline=baseline)
    report.add("large.graph_s", built - start, "s")
    report.add("large.table_s", end - built, "s")
    report.add("large.nodes", len(graph.nodes), "nodes")
    report.add("large.edges", len(graph.indices) // 2, "edges")
    # Peak of a process of its own that does nothing else; the map itself is counted before the build.
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "z.npy", grid.height)
        command = [sys.executable, "-c", _MEMORY, str(Path(folder) / "z.npy")]
        output = subprocess.run(
            command, check=True, capture_output=True, text=True, timeout=120, cwd=ROOT
        ).stdout
    report.add("large.memory_mb", float(output), "MB", limit=300.0)
    return table


def run(args: list[str]) -> Report:
    """Rows of the path's watch and of the crossings; without `--only` also those of the graph and of the queries."""
    parser = argparse.ArgumentParser(prog="planning", description=__doc__)
    parser.add_argument("--only", choices=("watch", "crossings"))
    options = parser.parse_args(args)
    report = Report("planning")
    for name, part in (("watch", watch), ("crossings", crossings)):
        if options.only in (None, name):
            part.rows(report)
    if options.only:
        return report
    area_s = 0.0
    for key, problem, limit in (("native_20m", mountain_map(), 40.0), ("native_8m", dense_map(), 120.0)):
        native_graph(*problem)
        value = cpu_seconds(partial(native_graph, *problem), 7)
        baseline = cpu_seconds(partial(NativeOracle, *problem), 1)
        report.add(f"build_ms.{key}", 1e3 * value, "ms", limit=limit, baseline=1e3 * baseline)
        if key == "native_20m":
            area_s = baseline * 10_000.0 / 400.0
    _update_ms(report)
    query.rows(report, _large(report, area_s))
    return report
