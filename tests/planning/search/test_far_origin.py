"""Where `map` has its origin changes no risk: the same ground, seen from up to 100 km away, is planned on alike."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from planning.path.path import make_path
from planning.risk.body import BodyModel
from planning.search.plan import Plan, PlanRequest, plan

BODY = BodyModel()
REACH = 95_000.0
"""[m]; a grid beyond 100 km is refused (`tests/mapping/test_grid.py`)."""


def planned(ox: float, oy: float) -> tuple[Plan, float]:
    """Over waves and round a wall whose grid begins at (ox, oy) [m]: the plan and the length of its path [m]."""
    y, x = np.mgrid[0:80, 0:120] * 0.05
    wall = np.where((x > 2.5) & (x < 2.7) & (y > 1.0), 0.3, 0.0)
    height = (0.05 * np.sin(2 * x) * np.cos(3 * y) + wall).astype(np.float32)
    grid = ElevationGrid(height, np.ones(height.shape, bool), (ox, oy), 0.05)
    graph = TraversalGraph.build(grid, (ox + 1.0, oy + 1.5), GraphParams(blind_radius=0.0), 0)
    request = PlanRequest((ox + 1.03, oy + 1.48), (ox + 4.87, oy + 2.11), 0.4, -0.3)
    found = plan(graph, grid, request, BODY)
    return found, make_path(found, grid, BODY).length


@pytest.mark.parametrize("seed", range(5))
def test_cost_risk_and_length_do_not_depend_on_the_origin(seed: int) -> None:
    ox, oy = np.random.default_rng(seed).uniform(-REACH, REACH, 2)
    (near, short), (far, length) = planned(0.0, 0.0), planned(float(ox), float(oy))
    assert far.reaches_goal
    assert far.cost == pytest.approx(near.cost, rel=0.06), "nodes are sampled anew"
    assert length == pytest.approx(short, rel=0.04)
    assert (np.abs(np.subtract(far.maxima, near.maxima)) < (0.005, 0.5, 0.01, 0.01)).all()
    np.testing.assert_allclose(far.points[-1, :2] - (ox, oy), (4.87, 2.11), atol=0.01)
