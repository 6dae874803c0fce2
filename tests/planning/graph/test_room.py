"""Room beside the body: a way near a wall or an edge costs more."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel
from planning.search.attach import Ground
from planning.search.plan import PlanRequest, plan

RES = 0.04


def grid_of(z: np.ndarray) -> ElevationGrid:
    return ElevationGrid(z.astype(np.float32), np.ones(z.shape, bool), (0.0, 0.0), RES)


def added(aside: float, height: float, room: float) -> float:
    """What is added to the risk of a move along something of `height` whose foot lies `aside` of its middle [m]."""
    y, _ = np.mgrid[0:80, 0:100] * RES
    grid = grid_of(np.where(y > 1.58 + aside, height, 0.0))
    params = GraphParams(room=room, blind_radius=0.0)
    return Ground(TraversalGraph.build(grid, (1.0, 1.0), params, 0), grid).added_risk(
        (1.6, 1.58), (2.0, 1.58)
    )


@pytest.mark.parametrize("height", [0.6, -0.6])
def test_what_cannot_be_driven_over_costs_the_more_the_nearer_it_is(height: float) -> None:
    risks = [added(aside, height, 0.12) for aside in (0.26, 0.30, 0.34, 0.38)]
    assert all(a > b for a, b in itertools.pairwise(risks))
    assert 0.5 < risks[0] <= 1.0
    assert added(0.42, height, 0.12) == 0.0
    assert added(0.26, height, 0.0) == 0.0
    assert added(0.26, 0.08 * np.sign(height), 0.12) == 0.0, "low enough to be driven over"


def test_a_way_down_an_oblique_kerb_keeps_off_the_wall_beside_it() -> None:
    # Down a kerb of 0.2 m at 50 deg robots slide up to 0.1 m to the low side; one came to the wall there, and tilted by 45 deg (lane 614).
    y, x = np.mgrid[0:60, 0:130] * RES
    kerb = x * np.cos(np.radians(50)) + (y - 1.2) * np.sin(np.radians(50)) > 2.6 * np.cos(np.radians(50))
    lane = np.abs(y - 1.2) < 0.585
    near: dict[float, list[float]] = {0.0: [], 0.12: []}
    for seed in range(6):
        noise = 0.003 * np.random.default_rng(seed).standard_normal(x.shape)
        grid = grid_of(np.where(lane, np.where(kerb, 0.0, 0.2), 0.6) + noise)
        for room, rows in near.items():
            params = GraphParams(
                room=room, max_step=0.20, max_slope=0.6, max_oblique=np.radians(15), blind_radius=0.0
            )
            graph = TraversalGraph.build(grid, (0.7, 1.2), params, seed)
            found = plan(graph, grid, PlanRequest((0.7, 1.2), (4.4, 1.2), 0.0), BodyModel())
            on = (found.points[:, 0] > 1.5) & (found.points[:, 0] < 3.7)
            rows.append(float(np.abs(found.points[on, 1] - 1.2).max()))
    assert max(near[0.0]) > 0.24
    assert max(near[0.12]) < 0.2
