"""Start and goal as nodes: what is driven first and last is checked where it is driven, and reasons tell the truth."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason
from planning.graph.graph import GraphParams, TraversalGraph
from planning.path.path import make_path
from planning.risk.body import BodyModel, edge_poses, sweep_poses
from planning.risk.table import RiskTable
from planning.search.plan import DriveRules, Plan, PlanRequest, plan
from tests.planning.graph.scenes import random_scene
from tests.planning.risk.test_turns import straddles

BODY = BodyModel()


def world(
    height: np.ndarray, start: tuple[float, float] = (1.5, 1.5), trusted: np.ndarray | None = None
) -> tuple[ElevationGrid, TraversalGraph]:
    """Ground (rows, cols) at 0.05 m, all of it seen, and its graph."""
    seen = np.ones(height.shape, bool) if trusted is None else trusted
    grid = ElevationGrid(height.astype(np.float32), seen, (0.0, 0.0), 0.05)
    return grid, TraversalGraph.build(grid, start, GraphParams(blind_radius=0.0), 0)


def poses_of(found: Plan) -> list[np.ndarray]:
    """Pose sets of a plan in the order they are driven: first turn, leg, turn, leg, ... and the last turn."""
    xy, out, yaw = found.points[:, :2], [], found.request.start_yaw
    for a, b in pairwise(xy):
        leg = edge_poses(a, b, BODY)
        if yaw is not None:
            out.append(sweep_poses(*a, yaw, leg[0, 2], BODY))
        out.append(leg)
        yaw = float(leg[0, 2])
    if found.request.goal_yaw is not None and yaw is not None:
        out.append(sweep_poses(*xy[-1], yaw, found.request.goal_yaw, BODY))
    return out


@pytest.mark.parametrize("seed", range(4))
def test_on_random_ground_nothing_that_is_driven_between_two_poses_sweeps_an_obstacle(seed: int) -> None:
    careless = BodyModel(weight_body=0.0, weight_unknown=0.0)  # whose costs do not keep it from anything
    scene = random_scene(seed)
    graph = TraversalGraph.build(scene.grid, scene.start, GraphParams(blind_radius=0.0), seed)
    table = RiskTable(graph, scene.grid, careless)
    rng = np.random.default_rng(seed)
    limit = GraphParams().max_step + 0.02
    found = 0
    while found < 12:
        ends = [np.array([*rng.uniform(0.5, 6.5, 2), rng.uniform(-3.1, 3.1)]) for _ in range(2)]
        if any(straddles(scene, pose, limit) for pose in ends):
            continue
        (x, y, yaw), (u, v, goal_yaw) = (tuple(e.tolist()) for e in ends)
        try:
            rules = DriveRules(straight=found % 2 == 1)
            request = PlanRequest((x, y), (u, v), yaw, goal_yaw, rules=rules)
            got = plan(graph, scene.grid, request, careless, table)
        except NoRoute:
            continue
        found += 1
        np.testing.assert_allclose(got.points[0, :2], (x, y))
        assert np.hypot(*(got.points[-1, :2] - (u, v))) == pytest.approx(got.short, abs=1e-9)
        for k, poses in enumerate(poses_of(got)):
            # what the robot stands on counts as free: the noise of the map must not hold it
            inner = poses[1:] if k == 0 else poses
            assert not any(straddles(scene, pose, limit) for pose in inner), (k, got.nodes)


def test_a_plan_costs_its_first_and_last_leg_and_its_table_is_shared() -> None:
    y, x = np.mgrid[0:80, 0:120] * 0.05
    grid, graph = world(0.05 * np.sin(2 * x) * np.cos(3 * y))
    table = RiskTable(graph, grid, BODY)
    request = PlanRequest((1.03, 1.48), (4.87, 2.11), 0.4, -0.3)
    first = plan(graph, grid, request, BODY, table)
    assert first.length == pytest.approx(np.hypot(*np.diff(first.points[:, :2], axis=0).T).sum())
    assert first.cost == pytest.approx(sum(t.cost for t in first.transitions))
    assert first.nodes[0] == len(graph.nodes)
    assert first.nodes[-1] == len(graph.nodes) + 1
    assert first.short == 0.0
    evaluated = table.evaluated()[0]
    assert evaluated > 0, "what one query evaluated serves the next"
    again = plan(graph, grid, request, BODY, table)
    assert (again.nodes, again.cost) == (first.nodes, first.cost)
    alone = plan(graph, grid, request, BODY)
    assert (alone.nodes, alone.cost) == (first.nodes, first.cost)
    path = make_path(first, grid, BODY)
    np.testing.assert_allclose(path.points[[0, -1], :2], [(1.03, 1.48), (4.87, 2.11)])


def test_a_robot_that_stands_on_a_face_drives_off_it_straight() -> None:
    _, x = np.mgrid[0:60, 0:120] * 0.05
    grid, graph = world(np.where(x > 3.0, 0.16, 0.0))
    for yaw, goal in ((0.0, (5.0, 1.5)), (np.pi, (1.0, 1.5))):
        with pytest.raises(NoRoute):
            plan(graph, grid, PlanRequest((2.0, 1.5), (5.0, 1.5), yaw), BODY)
        both = TraversalGraph.build(grid, goal, GraphParams(blind_radius=0.0), 0)
        found = plan(both, grid, PlanRequest((3.0, 1.5), goal, yaw), BODY)
        xy = found.points[:, :2]
        assert abs(np.angle(np.exp(1j * (np.arctan2(*(xy[1] - xy[0])[::-1]) - yaw)))) < np.radians(25)


def test_a_goal_too_near_to_a_wall_ends_at_the_nearest_place_and_tells_how_far() -> None:
    _, x = np.mgrid[0:60, 0:120] * 0.05
    grid, graph = world(np.where(x > 4.0, 1.0, 0.0))
    found = plan(graph, grid, PlanRequest((1.5, 1.5), (3.8, 1.5)), BODY)
    assert found.reaches_goal
    assert found.short == pytest.approx(3.8 - found.points[-1, 0], abs=0.03)
    assert found.points[-1, 0] + 0.35 <= 4.0
    assert found.short < 0.25, "the nose reaches the wall, the body stands 0.35 m off"
    with pytest.raises(NoRoute) as none:
        plan(graph, grid, PlanRequest((1.5, 1.5), (4.1, 1.5), allow_frontier=True), BODY)
    assert none.value.reason is NoRouteReason.GOAL_IN_OBSTACLE


def test_a_goal_on_a_low_ledge_is_judged_from_near() -> None:
    y, x = np.mgrid[0:60, 0:120] * 0.05
    ledge = (np.abs(x - 4.5) < 0.25) & (np.abs(y - 1.5) < 0.25)
    grid, graph = world(np.where(ledge, 0.16, 0.0))
    graph.frontier[:] = False  # nothing is left to explore
    ask = PlanRequest((1.0, 1.5), (4.5, 1.5), 0.0, allow_frontier=True)
    far = plan(graph, grid, ask, BODY)
    assert not far.reaches_goal
    assert far.length > 2.0
    asked = 1
    while not far.reaches_goal and asked < 9:
        x0, y0 = far.points[-1, :2].tolist()
        far = plan(graph, grid, PlanRequest((x0, y0), (4.5, 1.5), allow_frontier=True), BODY)
        asked += 1
    assert asked <= 3
    assert 0.3 < far.short < 0.9
    with pytest.raises(NoRoute) as none:
        plan(graph, grid, PlanRequest((1.0, 1.5), (4.5, 1.5), 0.0), BODY)
    assert none.value.reason is NoRouteReason.NOT_CONNECTED


def test_what_blocks_the_way_to_a_goal_behind_a_wall_is_judged_from_near() -> None:
    y, x = np.mgrid[0:60, 0:120] * 0.05
    ledge = (np.abs(x - 2.5) < 0.15) & (y > 1.5)
    wall = (np.abs(y - 1.5) < 0.06) & (x < 4.5)
    grid, graph = world(np.where(wall, 1.0, np.where(ledge, 0.16, 0.0)), (1.0, 0.75))
    graph.frontier[:] = False
    found = plan(graph, grid, PlanRequest((1.0, 0.75), (1.0, 2.25), 0.0, allow_frontier=True), BODY)
    assert not found.reaches_goal
    assert 2.65 < found.points[-1, 0] < 3.5
    assert found.points[-1, 1] > 1.8
    there = PlanRequest((3.05, 2.25), (1.0, 2.25), np.pi, allow_frontier=True)
    with pytest.raises(NoRoute):
        plan(graph, grid, replace(there, allow_frontier=False), BODY)
    assert plan(graph, grid, there, BODY).length < 0.6


def test_a_goal_close_behind_a_wall_is_not_near() -> None:
    """A robot that drove past it on its way around lost the way for a moment, and ended its goal with `the last 0.98 m
    are not drivable` (lane 623)."""
    y, x = np.mgrid[0:60, 0:120] * 0.05
    ring = np.maximum(np.abs(x - 1.5), np.abs(y - 1.5))
    grid, graph = world(np.where(np.abs(ring - 1.0) < 0.06, 1.0, 0.0))
    graph.frontier[:] = False
    found = plan(graph, grid, PlanRequest((2.0, 1.5), (2.95, 1.5), 0.0, allow_frontier=True), BODY)
    assert not found.transitions
    assert found.short > 1.0


def test_ground_that_nothing_leads_to_is_told_from_ground_that_cannot_be_driven_on() -> None:
    _, x = np.mgrid[0:60, 0:120] * 0.05
    grid, graph = world(np.where(np.abs(x - 3.0) < 0.1, 1.0, 0.0))
    with pytest.raises(NoRoute) as none:
        plan(graph, grid, PlanRequest((1.5, 1.5), (4.5, 1.5)), BODY)
    assert none.value.reason is NoRouteReason.NOT_CONNECTED
    with pytest.raises(NoRoute) as none:
        plan(graph, grid, PlanRequest((3.0, 1.5), (1.5, 1.5)), BODY)
    assert none.value.reason is NoRouteReason.START_NOT_ON_GRAPH


def test_a_place_to_avoid_counts_for_the_first_leg_too() -> None:
    grid, graph = world(np.zeros((60, 120)))
    free = plan(graph, grid, PlanRequest((1.5, 1.5), (4.0, 1.5), 0.0), BODY)
    around = plan(
        graph.avoiding(np.array([[2.0, 1.5, 0.3]])), grid, PlanRequest((1.5, 1.5), (4.0, 1.5), 0.0), BODY
    )
    assert np.abs(free.points[:, 1] - 1.5).max() < np.abs(around.points[:, 1] - 1.5).max()
    for a, b in pairwise(around.points[:, :2]):
        t = np.linspace(0, 1, 50)[:, None]
        assert np.hypot(*(a + t * (b - a) - (2.0, 1.5)).T).min() > 0.299


def test_a_robot_with_its_side_at_a_wall_leaves_it_along_its_heading() -> None:
    # By the map, which is a cell wrong, 4 cm of the robot are in the wall.
    y, _ = np.mgrid[0:60, 0:160] * 0.05
    rules, yaw, params = DriveRules(1.6, 0.3, straight=True, guarded=True), np.radians(-2.0), GraphParams()
    height = np.where(y < 0.5, 0.6, 0.0)
    beside, free = (4.0, 0.46 + 0.5 * params.width), (4.0, 1.6)
    for seed in range(6):
        grid, _ = world(height, free)
        graph = TraversalGraph.build(grid, free, GraphParams(blind_radius=0.0), seed)
        table = RiskTable(graph, grid, BODY)
        for start in (beside, free, beside):
            request = PlanRequest(start, (6.5, 1.6), yaw, rules=rules)
            found = plan(graph, grid, request, BODY, table)
            alone = plan(graph, grid, request, BODY)
            assert (found.nodes, found.cost) == (alone.nodes, alone.cost), (
                "the search that is kept knows the other start"
            )
            if start == beside:
                away = np.arctan2(*(found.points[1, :2] - found.points[0, :2])[::-1]) - yaw
                assert abs(np.sin(away)) < np.sin(np.radians(20.0))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_turn_that_the_guard_held_is_made_elsewhere_where_that_can_be(side: float) -> None:
    grid, graph = world(np.zeros((120, 120)), (3.0, 3.0))
    rules = DriveRules(1.6, 0.3, straight=True, guarded=True)
    request = PlanRequest((3.0, 3.0), (3.0, 3.0 + 2.0 * side), 0.0, rules=rules)

    def first_turn(held: tuple[bool, bool]) -> float:
        found = plan(graph, grid, replace(request, held=held), BODY)
        assert found.reaches_goal
        leg = found.points[1, :2] - found.points[0, :2]
        turn = np.arctan2(leg[1], leg[0])
        return float(turn - np.copysign(np.pi, turn)) if found.transitions[0].backward else float(turn)

    assert first_turn((False, False)) == pytest.approx(side * np.pi / 2, abs=0.01)
    assert first_turn((side < 0.0, side > 0.0)) == pytest.approx(side * np.pi / 2, abs=0.01)
    for held in ((side > 0.0, side < 0.0), (True, True)):
        assert abs(first_turn(held)) <= np.radians(30.0) + 0.05 or first_turn(held) * side < 0.0


def test_a_turn_that_the_guard_held_is_asked_for_again_where_no_other_way_leads_on() -> None:
    # A closed end, just long enough for the robot: it can only turn there.
    y, x = np.mgrid[0:120, 0:120] * 0.05
    height = np.where((x > 2.5) & (x < 3.5) & (y > 2.5), 0.0, 0.6)
    grid, graph = world(height, (3.0, 3.0))
    rules = DriveRules(np.inf, 0.3, straight=True, guarded=False)
    request = PlanRequest((3.0, 3.0), (3.0, 5.0), -np.pi / 2, rules=rules)
    alone = plan(graph, grid, request, BODY)
    held = plan(graph, grid, replace(request, held=(True, True)), BODY)
    assert (held.nodes, held.cost) == (alone.nodes, alone.cost)


def test_a_closed_narrow_lane_is_left_backward():
    height = np.zeros((75, 150), np.float32)  # 3 x 6 m of 0.04 m
    across = np.arange(75) * 0.04 - 1.48
    height[np.abs(across) > 0.32, :75] = 0.5  # a lane 0.62 m wide for 3 m
    height[:, :3] = 0.5
    grid = ElevationGrid(height, np.ones(height.shape, bool), (0.0, -1.48), 0.04)
    inside, goal = (0.8, 0.0), (5.0, 0.0)
    for seed in range(20):
        graph = TraversalGraph.build(grid, (4.0, 0.0), GraphParams(blind_radius=0.0), seed)
        into = PlanRequest(inside, goal, np.pi)
        try:
            plan(graph, grid, PlanRequest(inside, goal, 0.0), BODY)  # the lane holds edges in this graph
        except NoRoute:
            continue
        with pytest.raises(NoRoute):
            plan(graph, grid, into, BODY)
        found = plan(graph, grid, replace(into, rules=DriveRules(backward=1.3)), BODY)
        back = np.array([t.backward for t in found.transitions])
        assert back[found.points[:-1, 0] < 2.5].all()
        assert found.cost >= 1.3 * 2.0
        path = make_path(found, grid, BODY)
        chord = np.diff(path.points[:, :2], axis=0)
        against = np.cos(path.yaw[:-1] - np.arctan2(chord[:, 1], chord[:, 0])) < 0.0
        assert against[path.points[:-1, 0] < 2.5].all()
        assert abs(path.initial_turn) < 0.3
        return
    pytest.fail("no graph holds the lane")


CLIMBER = GraphParams(max_step=0.20, max_slope=np.radians(30), controller="hybrid", blind_radius=0.0)
RULES = DriveRules(backward=1.3, turning=0.3)


def test_a_robot_whose_front_wheels_are_down_a_high_kerb_does_not_begin_backward() -> None:
    _, x = np.mgrid[0:100, 0:120] * 0.04
    height = np.where(x > 2.4, 0.0, 0.18).astype(np.float32)
    grid = ElevationGrid(height, np.ones(height.shape, bool), (0.0, 0.0), 0.04)
    graph = TraversalGraph.build(grid, (2.45, 2.0), CLIMBER, 0)
    off = plan(graph, grid, PlanRequest((2.45, 2.0), (1.2, 2.0), 0.0, rules=RULES))
    assert not off.transitions[0].backward
    low = ElevationGrid(0.25 * height, np.ones(height.shape, bool), (0.0, 0.0), 0.04)
    back = plan(
        TraversalGraph.build(low, (2.45, 2.0), CLIMBER, 0),
        low,
        PlanRequest((2.45, 2.0), (1.4, 2.0), 0.0, rules=RULES),
    )
    assert back.transitions[0].backward


def test_a_robot_half_down_a_kerb_that_it_met_askew_drives_on() -> None:
    """Its left wheels are down and its right ones up: it rolls more than the limit of slopes, and stands there all the
    same."""
    y, x = np.mgrid[0:100, 0:150] * 0.04
    a = np.radians(52.0)
    height = np.where((x - 3.0) * np.cos(a) + (y - 2.0) * np.sin(a) > 0.0, 0.0, 0.21).astype(np.float32)
    grid = ElevationGrid(height, np.ones(height.shape, bool), (0.0, 0.0), 0.04)
    graph = TraversalGraph.build(grid, (1.0, 2.0), CLIMBER, 0)
    found = plan(graph, grid, PlanRequest((2.97, 2.09), (4.6, 2.35), np.radians(9.0), rules=RULES))
    assert not any(t.backward for t in found.transitions)
    assert found.cost < 5.0, "no turn beside the edge"


def test_a_robot_astride_a_kerb_drives_straight_on_before_it_bends() -> None:
    """Its left rear wheel is not up yet: at the heading of a bend it would come to the kerb at 65 deg, and of such
    drives most end there."""
    y, x = np.mgrid[0:100, 0:150] * 0.04
    a = np.radians(-55.0)
    height = np.where((x - 3.0) * np.cos(a) + (y - 2.0) * np.sin(a) > 0.0, 0.19, 0.0).astype(np.float32)
    grid = ElevationGrid(height, np.ones(height.shape, bool), (0.0, 0.0), 0.04)
    graph = TraversalGraph.build(grid, (1.0, 2.0), CLIMBER, 0)
    start, yaw = (3.22, 1.95), np.radians(-18.0)
    found = plan(graph, grid, PlanRequest(start, (5.2, 2.3), yaw, rules=RULES))
    first = found.points[1, :2] - found.points[0, :2]
    assert not found.transitions[0].backward
    assert abs(np.arctan2(first[1], first[0]) - yaw) < np.radians(7.0)
