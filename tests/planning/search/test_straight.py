"""Routes on open ground are straight, keep off what the searched route keeps off, and stay while another is hardly
better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hal.rotation import wrap
from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from planning.path import make_path, rest_of
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from planning.search import Driven, DriveRules, Plan, PlanRequest, plan

BODY = BodyModel()
STRAIGHT = DriveRules(straight=True)


def world(height: np.ndarray) -> tuple[ElevationGrid, TraversalGraph]:
    """Seen ground of 0.05 m with the noise of a map, and its graph."""
    noise = 0.004 * np.random.default_rng(1).standard_normal(height.shape)
    grid = ElevationGrid((height + noise).astype(np.float32), np.ones(height.shape, bool), (0.0, 0.0), 0.05)
    return grid, TraversalGraph.build(grid, (1.0, 1.0), GraphParams(blind_radius=0.0), 0)


@pytest.fixture(scope="module")
def open_ground() -> tuple[ElevationGrid, TraversalGraph]:
    return world(np.zeros((100, 160)))


def turned(found: Plan) -> float:
    """All turns of a route [rad]."""
    heading = np.arctan2(*np.diff(found.points[:, :2], axis=0).T[::-1])
    return float(np.abs(wrap(np.diff(heading))).sum())


def test_open_ground_is_crossed_in_a_straight_line(open_ground):
    grid, graph = open_ground
    table = RiskTable(graph, grid, BODY)
    for goal in ((6.5, 3.6), (6.8, 1.2), (2.0, 4.0)):
        request = PlanRequest((1.0, 1.0), goal, 0.4)
        searched = plan(graph, grid, request, BODY, table)
        found = plan(graph, grid, replace(request, rules=STRAIGHT), BODY, table)
        assert turned(found) < min(0.5, 0.4 * turned(searched))
        assert found.length < 1.01 * np.hypot(goal[0] - 1.0, goal[1] - 1.0)
        assert found.cost < searched.cost
        assert found.cost == pytest.approx(sum(t.cost for t in found.transitions))
        assert found.nodes == searched.nodes


def test_a_wall_on_the_chord_is_gone_around():
    height = np.zeros((100, 160))
    height[0:60, 70:76] = 0.4  # from y = 0 to 3 at x = 3.6
    grid, graph = world(height)
    found = plan(graph, grid, PlanRequest((1.0, 1.0), (6.5, 1.0), 0.0, rules=STRAIGHT), BODY)
    path = make_path(found, grid, BODY)
    beside = (path.points[:, 0] > 3.4) & (path.points[:, 0] < 3.9)
    assert path.points[beside, 1].min() > 2.96 + 0.5 * BODY.width
    assert path.worst[2] < 0.03, "nothing reaches under the body"
    assert turned(found) < 3.0


def test_the_route_that_is_driven_is_kept_unless_another_is_clearly_better(open_ground):
    grid, graph = open_ground
    start, goal = (1.0, 1.0), (6.5, 1.0)

    def bow(height: float) -> np.ndarray:
        s = np.linspace(0.0, 1.0, 14)[1:]
        return np.column_stack([1.0 + 5.5 * s, 1.0 + height * np.sin(np.pi * s)])

    def asked(points: np.ndarray) -> Plan:
        driven = Driven(points, np.zeros(len(points), bool))
        return plan(graph, grid, PlanRequest(start, goal, 0.0, rules=STRAIGHT, driven=driven), BODY)

    little = asked(bow(0.6))
    assert little.kept
    np.testing.assert_allclose(little.points[1:, :2], bow(0.6))
    assert not asked(bow(2.2)).kept, "2 m longer"
    assert not asked(np.add(bow(0.2), (0.0, 0.3))).kept, "it ends elsewhere"
    height = np.zeros((100, 160))
    height[20:24, 70:76] = 0.4
    blocked, other = world(height)
    driven = Driven(bow(0.2), np.zeros(13, bool))
    assert not plan(other, blocked, PlanRequest(start, goal, 0.0, driven=driven), BODY).kept


def test_the_rest_of_a_path_begins_at_the_robot(open_ground):
    grid, graph = open_ground
    path = make_path(plan(graph, grid, PlanRequest((1.0, 1.0), (6.5, 3.6), 0.4), BODY), grid, BODY)
    k = len(path.s) // 3
    x, y, _ = path.points[k]
    rest = rest_of(path, (x, y, path.yaw[k]), grid, BODY)
    np.testing.assert_array_equal(rest.points, path.points[k:])
    np.testing.assert_allclose(rest.speed[40:], path.speed[k + 40 :], atol=0.01)
    rough = ElevationGrid(grid.height.copy(), grid.trusted, grid.origin, grid.resolution)
    rough.height[:, 100:] += 0.08
    slower = rest_of(path, (x, y, path.yaw[k]), rough, BODY)
    edge = np.abs(slower.points[:, 0] - 4.975) < 0.2
    assert slower.speed[edge].max() < 0.85 * rest.speed[edge].max(), "a kerb that was not known before"
    assert rest.length == pytest.approx(path.length - path.s[k])
    assert rest.initial_turn == pytest.approx(0.0, abs=1e-9)
    assert len(rest.back) == len(rest.route) - 1 < len(path.back)
    np.testing.assert_array_equal(rest.route[-1], path.route[-1])
    assert path.ahead(x - 1.0, y + 1.0) is None, "the robot is off the path"
