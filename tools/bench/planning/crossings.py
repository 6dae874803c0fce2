"""Ways over a face near the step limit: how many are still in the graph after the next map, whose errors are others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from rbtrg_robot.stage_config import GraphConfig
from tools.bench.report import Report

CELL_SIDE, FACE_X = 0.04, 2.0
"""Cell and place of the face along x [m]."""
ERROR_SIGMA, ERROR_LENGTH = 0.02, 0.3
"""Standard deviation of a map's error and the length over which it is alike [m]."""
SAME_WAY = 0.06
"""Ways that cross the face so near to each other [m] are one."""
SEED_COUNT, MAP_COUNT = 8, 12
STEP_HEIGHTS = (0.09, 0.10, 0.11)


def _smooth(noise: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Gaussian filter of `sigma` cells along both axes, mirrored at the edges."""
    reach = round(4.0 * sigma)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weight /= weight.sum()
    for axis in (0, 1):
        pads = [(reach, reach) if axis == k else (0, 0) for k in (0, 1)]
        noise = np.apply_along_axis(
            np.convolve, axis, np.pad(noise, pads, mode="symmetric"), weight, mode="valid"
        )
    return noise


def _map(step: float, rng: np.random.Generator) -> ElevationGrid:
    """A lane 1.2 m wide with a face of `step` [m]: 2 cm of error alike over 0.3 m, 3 mm in each cell by itself."""
    y, x = np.mgrid[0:40, 0:100] * CELL_SIDE
    error = _smooth(rng.normal(size=x.shape), ERROR_LENGTH / CELL_SIDE / 2.0)
    z = np.where(x > FACE_X, step, 0.0) + ERROR_SIGMA * error / error.std() + rng.normal(0.0, 0.003, x.shape)
    z[(y < 0.2) | (y > 1.4)] = 0.5
    return ElevationGrid(z.astype(np.float32), np.ones(z.shape, bool), (0.0, 0.0), CELL_SIDE)


def _crossings(graph: TraversalGraph) -> NDArray[np.float64]:
    """(n,) y [m] at which edges cross the face."""
    a, b = (graph.nodes[graph.edges[:, k], :2] for k in (0, 1))
    over = (a[:, 0] < FACE_X) != (b[:, 0] < FACE_X)
    a, b = a[over], b[over]
    at: NDArray[np.float64] = a[:, 1] + (FACE_X - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    return at


def kept(step: float, keep: float, seed: int) -> tuple[int, int]:
    """How many crossings of one map are in the graph of the next, of how many, over `MAP_COUNT` maps."""
    rng = np.random.default_rng(seed)
    stayed, were = 0, 0
    graph, before = None, np.empty(0)
    for _ in range(MAP_COUNT):
        grid = _map(step, rng)
        if graph is None:
            graph = TraversalGraph.build(
                grid, (1.0, 0.8), GraphParams(blind_radius=0.0, keep_step=keep), seed
            )
        else:
            graph.update(grid, [(0, 0, *grid.shape)])
        now = _crossings(graph)
        were += len(before)
        stayed += sum(bool((np.abs(now - y) < SAME_WAY).any()) for y in before)
        before = now
    return stayed, were


def rows(report: Report) -> None:
    """Rows for a hard limit and for the stack's (`graph.keep_step`)."""
    for step in STEP_HEIGHTS:
        for name, keep in (("hard", 0.0), ("stack", GraphConfig().keep_step)):
            counts = np.sum([kept(step, keep, seed) for seed in range(SEED_COUNT)], axis=0)
            limit = 0.9 if name == "stack" else None
            report.rate(f"crossings.{round(100 * step)}cm.{name}", int(counts[0]), int(counts[1]), limit)
