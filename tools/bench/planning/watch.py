"""Rows of the path's watch: boxes dropped on random paths over rough ground, and the same ground measured again.

`watch.missed` counts paths of 150 on which a box of 0.45 m, 0.2 to 0.5 m wide and up to 0.2 m off the path's line, is
not
seen. `watch.false_alarms` is the share of 750 maps of unchanged ground, each with its own noise of 5 mm, on which a
path
is said to be blocked. `watch.passes_walls` is the share of the paths whose body's rim touches a face above the limit.
"""

from __future__ import annotations

import numpy as np

from mapping.grid import ElevationGrid
from planning.errors import NoRoute
from planning.graph.graph import TraversalGraph
from planning.path import Path, face_in_the_way, make_path
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from planning.search.plan import PlanRequest, plan
from tools.bench.planning.worlds import rough_terrain
from tools.bench.report import Report

BODY = BodyModel()
WORLD_COUNT, PATH_COUNT, REPEAT_COUNT = 6, 25, 5
"""Maps, paths on each, maps of unchanged ground for each path."""
WORLD_SIDE, CELL_SIDE, HEIGHT_NOISE = 12.0, 0.05, 0.005
"""[m]"""
BOX_HEIGHT = 0.45
"""[m]"""


def _noisy(grid: ElevationGrid, rng: np.random.Generator) -> ElevationGrid:
    height = (grid.height + rng.normal(0.0, HEIGHT_NOISE, grid.shape)).astype(np.float32)
    return ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)


def _paths(grid: ElevationGrid, rng: np.random.Generator) -> list[Path]:
    """Random paths of at least 3 m between their ends."""
    graph = TraversalGraph.build(grid, (1.0, 1.0))
    table = RiskTable(graph, grid, BODY)
    found: list[Path] = []
    while len(found) < PATH_COUNT:
        a, b = rng.uniform(0.5, WORLD_SIDE - 0.5, (2, 2))
        if np.hypot(*(a - b)) < 3.0:
            continue
        try:
            route = plan(graph, grid, PlanRequest((a[0], a[1]), (b[0], b[1])), BODY, table)
        except NoRoute:
            continue
        found.append(make_path(route, grid, BODY))
    return found


def _boxed(grid: ElevationGrid, path: Path, rng: np.random.Generator) -> ElevationGrid:
    """A box somewhere on the path, half a metre or more from its ends."""
    i = int(rng.integers(25, len(path.s) - 25))
    side, (w, h) = rng.uniform(-0.2, 0.2), rng.uniform(0.1, 0.25, 2)
    x = path.points[i, 0] - side * np.sin(path.yaw[i])
    y = path.points[i, 1] + side * np.cos(path.yaw[i])
    rows, cols = grid.shape
    on = np.abs(grid.origin[0] + np.arange(cols) * CELL_SIDE - x) < w
    on = on & (np.abs(grid.origin[1] + np.arange(rows) * CELL_SIDE - y) < h)[:, None]
    height = np.where(on, grid.height[on].max() + BOX_HEIGHT, grid.height)
    return ElevationGrid(height, grid.trusted, grid.origin, grid.resolution)


def rows(report: Report) -> None:
    """Add the rows."""
    missed = alarms = walls = 0
    for world in range(WORLD_COUNT):
        ground = rough_terrain(WORLD_SIDE, CELL_SIDE, 100 + world, rocks_per_m2=0.3)
        rng = np.random.default_rng(world)
        seen = _noisy(ground, rng)
        for path in _paths(seen, rng):
            walls += bool(path.faces.max() > path.limits.max_step)
            missed += not face_in_the_way(path, _noisy(_boxed(seen, path, rng), rng), BODY)
            alarms += sum(bool(face_in_the_way(path, _noisy(ground, rng), BODY)) for _ in range(REPEAT_COUNT))
    count = WORLD_COUNT * PATH_COUNT
    report.add("watch.missed", missed, f"of {count} boxes", limit=0.0)
    report.add("watch.false_alarms", alarms / (count * REPEAT_COUNT), "of maps", limit=0.01)
    report.add("watch.passes_walls", walls / count, "of paths")
