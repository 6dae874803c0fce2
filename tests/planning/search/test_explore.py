"""Driving to a goal nobody has seen: mazes with dead ends, a goal walled in, two ways that are equally good."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.graph.flags import HIGH, LOW, VIRTUAL
from planning.graph.graph import GraphParams, TraversalGraph
from planning.search.frontier import Tried, frontiers, virtual_around
from planning.search.plan import plan
from planning.search.request import PlanRequest
from planning.search.to_go import way_to_go
from tests.planning.search.explore_world import World, explore, maze, rooms_of, shortest
from tests.planning.worlds import flat

RING = 1.9
"""Where the lowest ray of the default LiDAR meets the ground [m]."""


@pytest.mark.parametrize(
    ("pitch", "rooms", "loops", "blind", "seeds"),
    [
        (1.7, 5, 0.1, RING, (0,)),
        (1.1, 6, 0.1, 0.0, (1, 22)),
        pytest.param(1.7, 5, 0.1, RING, (1, 2), marks=pytest.mark.campaign),
        pytest.param(1.1, 6, 0.1, 0.0, (2, 18), marks=pytest.mark.campaign),
        pytest.param(1.2, 6, 0.3, 0.0, (9, 13, 3), marks=pytest.mark.campaign),
        pytest.param(1.4, 7, 0.0, 0.0, (5,), marks=pytest.mark.campaign),
    ],
)
def test_the_way_through_an_unseen_maze_is_at_most_twice_the_known_one(
    pitch: float, rooms: int, loops: float, blind: float, seeds: tuple[int, ...]
) -> None:
    ratios = []
    for seed in seeds:
        world = maze(seed, rooms, pitch, loops)
        run = explore(world, blind)
        assert run.end == "reached", f"maze {seed}"
        ratios.append(run.driven / shortest(world))
        track = np.array(run.track)
        row, col = np.round(track[:, ::-1] / world.res).astype(int).T
        assert not world.wall[row, col].any(), "it went through a wall"
    assert max(ratios) <= 2.0, ratios
    assert np.mean(ratios) <= 1.4, ratios
    assert min(ratios) > 0.9, "shorter than the way on the full map: something was crossed"


@pytest.mark.parametrize(
    ("pitch", "blind", "seed"),
    [
        (1.7, RING, 0),
        pytest.param(1.1, 0.0, 2, marks=pytest.mark.campaign),
        pytest.param(1.4, 0.0, 3, marks=pytest.mark.campaign),
    ],
)
def test_a_goal_walled_in_ends_in_no_route_once_its_walls_are_seen(
    pitch: float, blind: float, seed: int
) -> None:
    world = maze(seed, 4, pitch, closed=True)
    run = explore(world, blind)
    assert run.end == "no_route"
    assert 2.0 < run.driven <= 2.0 * 15 * pitch, "every passage of the tree at most there and back"
    assert run.seen is not None
    assert run.seen[rooms_of(world)].mean() > 0.5, "it gave up before it had looked"


def test_between_two_equal_ways_it_makes_up_its_mind() -> None:
    n = 121
    y, x = np.mgrid[0:n, 0:n] * 0.05
    wall = (x < 0.1) | (x > 5.9) | (y < 0.1) | (y > 5.9)
    wall |= (np.abs(y - 3.0) < 0.1) & (np.abs(x - 3.0) < 1.8)  # a way round on either side
    noise = 0.01 * np.random.default_rng(3).standard_normal(wall.shape)
    world = World((wall + noise).astype(np.float32), 0.05, (3.0, 1.5), (3.0, 4.5), wall)
    run = explore(world, every=0.15)
    assert run.end == "reached"
    track = np.array(run.track)
    side = track[track[:, 1] < 3.0, 0] - 3.0  # before the wall's end
    assert np.abs(side).max() > 1.5
    assert (np.sign(side[np.abs(side) > 0.2]) == np.sign(side[np.argmax(np.abs(side))])).all()


@pytest.mark.parametrize(
    "seed", [1, pytest.param(4, marks=pytest.mark.campaign)]
)  # without `previous_frontier` both swing
def test_a_frontier_given_up_on_the_way_is_not_taken_up_again(seed: int) -> None:
    run = explore(maze(seed, 5, 1.7), every=0.3)
    assert run.end == "reached"
    legs = run.frontiers[:1]
    for frontier in run.frontiers:
        if math.dist(frontier, legs[-1]) > 1.0:
            assert all(math.dist(frontier, earlier) > 0.6 for earlier in legs), frontier
            legs.append(frontier)
        else:
            legs[-1] = frontier
    assert len(legs) > 3


def test_the_way_to_go_leads_around_what_is_known_to_stand_there() -> None:
    grid = flat(6, 4)
    points = np.array([[1.0, 2.0], [5.0, 2.0], [1.0, 3.6]])
    np.testing.assert_allclose(way_to_go(grid, points, (9.0, 2.0)), [8.0, 4.0, 8.16], rtol=0.05)
    y, x = np.mgrid[0:81, 0:121] * 0.05
    grid.height[(np.abs(x - 3.0) < 0.1) & (y < 3.0)] = 1.0
    around = way_to_go(grid, points, (4.0, 0.5))
    # off the map nothing is known: round the wall's southern end
    assert around[0] == pytest.approx(np.hypot(2.0, 2.2) + np.hypot(1.0, 0.7), rel=0.05)
    assert around[1] == pytest.approx(np.hypot(1.0, 1.5), rel=0.1)
    assert around[2] == pytest.approx(np.hypot(2.0, 0.4) + np.hypot(1.0, 2.7), rel=0.1)
    unseen = flat(6, 4)
    unseen.trusted[:] = False
    unseen.height[:] = grid.height
    assert way_to_go(unseen, points, (4.0, 0.5))[0] == pytest.approx(np.hypot(3.0, 1.5), rel=0.1)
    ring = np.hypot(x - 4.0, y - 1.5)
    grid.height[(ring > 0.9) & (ring < 1.1)] = 1.0
    assert np.isinf(way_to_go(grid, points, (4.0, 1.5))).all()
    np.testing.assert_allclose(way_to_go(grid, np.array([[4.3, 1.5]]), (4.0, 1.5)), 0.3, atol=0.01)


def test_the_way_to_go_leads_over_no_hole_that_is_too_wide_whether_its_floor_was_seen_or_not() -> None:
    grid = flat(6, 4)
    y, x = np.mgrid[0:81, 0:121] * 0.05
    ring = np.hypot(x - 4.0, y - 1.5)
    trench = (ring > 0.9) & (ring < 1.1)
    grid.trusted[trench & (x > 4.0)] = False
    points = np.array([[1.0, 1.5], [4.3, 1.5]])
    np.testing.assert_allclose(way_to_go(grid, points, (4.0, 1.5)), [3.0, 0.3], atol=0.05)
    holes = replace(grid, holes=trench)
    np.testing.assert_allclose(way_to_go(holes, points, (4.0, 1.5)), [np.inf, 0.3], atol=0.01)
    bridge = replace(grid, holes=trench & (y < 2.0))
    assert 3.1 < way_to_go(bridge, points, (4.0, 1.5))[0] < 3.6


def test_the_way_to_go_does_not_lead_back_over_ground_that_was_reached() -> None:
    # A frontier in a corner of a field is none on the way into a pit in its middle: the rim of the pit is.
    grid = flat(6, 4)
    y, x = np.mgrid[0:81, 0:121] * 0.05
    pit, corner = np.hypot(x - 3.0, y - 2.0) < 0.8, (x > 5.5) & (y > 3.5)
    grid.trusted[pit | corner] = False
    nodes = np.stack(np.meshgrid(np.arange(0.4, 6.0, 0.3), np.arange(0.4, 4.0, 0.3)), -1).reshape(-1, 2)
    nodes = nodes[(np.hypot(*(nodes - (3.0, 2.0)).T) > 1.2) & (nodes.max(axis=1) < 5.2)]
    ends = np.array([[1.7, 2.0], [5.1, 3.4]])
    np.testing.assert_allclose(way_to_go(grid, ends, (3.0, 2.0)), [1.3, 2.6], atol=0.2)
    left = way_to_go(grid, ends, (3.0, 2.0), nodes)
    assert left[0] == pytest.approx(1.3, abs=0.1)
    assert np.isinf(left[1])


def test_the_way_to_go_leads_around_a_stepfield_or_counts_it_eleven_times() -> None:
    grid = flat(6, 4)
    points = np.array([[1.0, 2.0], [5.0, 2.0]])
    y, x = np.mgrid[0:81, 0:121] * 0.05
    fields = (np.abs(x - 3.0) < 1.0) & (y < 3.0)
    around = 2.0 * np.hypot(1.0, 1.0) + 2.0
    left = way_to_go(grid, points, (5.0, 2.0), fields=fields)
    np.testing.assert_allclose(left, [around, 0.0], atol=0.35)
    wide = flat(6, 24)
    across = np.array([[1.0, 12.0], [5.0, 12.0]])
    x = np.mgrid[0:481, 0:121][1] * 0.05
    rims = np.abs(np.abs(x - 3.0) - 0.5) < 0.1
    np.testing.assert_allclose(way_to_go(wide, across, (5.0, 12.0), fields=rims), [8.0, 0.0], atol=1.0)
    wide.trusted[np.abs(x - 3.0) < 0.4] = False
    unseen = way_to_go(wide, across, (5.0, 12.0), fields=rims)
    np.testing.assert_allclose(
        unseen, [16.0, 0.0], atol=2.0, err_msg="a field goes on between its seen parts"
    )


def test_a_lane_beside_a_stepfield_that_was_not_seen_yet_is_free() -> None:
    grid = flat(6, 4)
    y, x = np.mgrid[0:81, 0:121] * 0.05
    grid.height[y > 3.6] = 0.6
    fields = (np.abs(x - 3.0) < 1.5) & (y < 3.0)
    grid.trusted[(np.abs(x - 3.0) < 1.5) & (y >= 3.0) & (y <= 3.6)] = False
    to_go = way_to_go(grid, np.array([[1.0, 2.0]]), (5.0, 2.0), fields=fields)[0]
    assert to_go == pytest.approx(3.0 + 2.0 * np.hypot(0.5, 1.0), abs=0.5), (
        "the posts hide it: look there first"
    )


def test_frontiers_around_places_that_the_robot_looked_from_are_closed() -> None:
    graph = TraversalGraph.build(flat(4.0, 3.0), (1.0, 1.5))
    start, near, far = (int(np.hypot(*(graph.nodes[:, :2] - (x, 1.5)).T).argmin()) for x in (1.0, 2.0, 3.0))
    graph.frontier[:] = False
    graph.frontier[[start, near, far]] = True
    tried = Tried()
    x, y = graph.nodes[near, :2].tolist()
    request = PlanRequest((1.0, 1.5), (9.0, 1.5))
    assert np.flatnonzero(frontiers(graph, start, request)).tolist() == sorted([near, far])
    tried.at((x + 0.2, y), None)
    request = replace(request, tried=tuple(tried.places))
    assert np.flatnonzero(frontiers(graph, start, request)).tolist() == [far]


def test_towards_a_goal_that_nothing_leads_to_the_robot_keeps_to_one_side_and_goes_nowhere_twice() -> None:
    # Around a trench robots turned from the way along its left to that along its right, and back, for a minute.
    grid = flat(6.0, 5.0)
    y, x = np.mgrid[0 : grid.shape[0], 0 : grid.shape[1]] * grid.resolution
    ring = np.abs(np.maximum(np.abs(x - 3.5), np.abs(y - 2.5)) - 0.9) < 0.08
    grid.height[ring] = np.where(np.abs(x - 3.5) < 0.4, 0.24, 0.5)[
        ring
    ]  # two sides look as if they may be crossed
    graph = TraversalGraph.build(grid, (1.0, 2.5), GraphParams(blind_radius=0.0))
    graph.frontier[:] = False
    request = PlanRequest((1.0, 2.5), (3.5, 2.5), 0.0, allow_frontier=True)
    sides = (3.5, 3.9), (3.5, 1.1)

    def end(request: PlanRequest) -> tuple[float, float]:
        found = plan(graph, grid, request)
        assert not found.reaches_goal
        assert found.frontier is not None
        return found.frontier

    for here, there in (sides, sides[::-1]):
        assert math.dist(end(replace(request, previous_frontier=here)), here) < 0.6
        assert math.dist(end(replace(request, tried=((*there, 1.0),))), here) < 0.6
    tried = tuple((*side, 1.0) for side in sides)
    assert min(math.dist(end(replace(request, tried=tried)), side) for side in sides) > 1.0


def test_a_frontier_that_the_robot_does_not_come_nearer_to_is_given_up_however_the_samples_change() -> None:
    grid = flat(6.0, 4.0)
    tried = Tried()
    for second in range(7):
        assert tried.places == []
        tried.found((1.2, 0.1 * (second % 3)), 1.0, float(second), grid)
    assert tried.places == [(1.2, 0.0, 0.3)]
    driving = Tried()
    for second in range(20):
        driving.found((9.0, 0.0), 9.0 - 0.3 * second, float(second), grid)
    assert driving.places == []
    paused = Tried()
    for time in (0.0, 100.0, 101.0, 102.0):
        paused.found((9.0, 0.0), 9.0, time, grid)
    assert paused.places == []


def test_a_frontier_that_shows_nothing_closes_those_around_it() -> None:
    grid = flat(6.0, 4.0)
    x = np.mgrid[0:81, 0:121][1] * 0.05
    grid.trusted[x > 3.0] = False
    for shown, radius in ((3.05, 1.0), (3.6, None)):
        tried = Tried()
        tried.found((2.8, 2.0), 1.0, 0.0, grid)
        later = replace(grid, trusted=x < shown)
        tried.at((2.6, 2.0), later)
        closed = [r for px, _, r in tried.places if px == 2.8]
        assert closed == ([] if radius is None else [radius])


def test_ground_behind_a_wall_is_not_looked_at_from_before_it() -> None:
    flags = np.zeros((40, 40), np.uint16)
    flags[:, 30:] = VIRTUAL
    points = np.array([[2.4, 2.0], [0.5, 2.0]])
    assert virtual_around(flags, 0.0, 0.0, 0.1, points, 0.35, 0.75).tolist() == [True, False]
    flags[:, 28] = HIGH | LOW
    assert virtual_around(flags, 0.0, 0.0, 0.1, points, 0.35, 0.75).tolist() == [False, False]


def test_a_lane_whose_valleys_nobody_saw_yet_is_not_left_for_the_lane_beside_it() -> None:
    # Beyond a frontier ground counts as free. Virtual ground before one had its price, and the lane of the goal was
    # dearer than the other.
    y, x = np.mgrid[0:100, 0:160] * 0.04
    z = np.zeros(x.shape, np.float32)
    z[(x < 0.1) | (y < 0.1) | (y > 3.9) | ((np.abs(y - 2.0) < 0.1) & (x > 1.6))] = 0.5
    valley = (y > 0.1) & (y < 1.9) & (((x > 2.2) & (x < 3.0)) | ((x > 3.6) & (x < 4.4)))
    dark = (y > 2.1) & (x > 2.2)
    z[dark] = np.nan
    grid = ElevationGrid(z, ~valley & ~dark, (0.0, 0.0), 0.04, virtual=valley)
    graph = TraversalGraph.build(grid, (1.0, 1.0), GraphParams(blind_radius=0.0))
    found = plan(graph, grid, PlanRequest((1.0, 1.0), (20.0, 1.0), 0.0, allow_frontier=True))
    assert found.frontier is not None
    assert found.frontier[1] < 1.9
    assert found.frontier[0] > 1.3


def test_a_frontier_that_moved_on_is_kept_and_one_beside_it_that_lies_back_is_another() -> None:
    # From the mouth of a lane a robot went back to the rim of the stepfield beside it, and then into the field.
    grid = flat(6.0, 3.0)
    grid.trusted[:, 76:] = False
    graph = TraversalGraph.build(grid, (1.0, 1.5))
    on, back = (int(np.hypot(*(graph.nodes[:, :2] - xy).T).argmin()) for xy in ((3.2, 1.5), (2.5, 1.9)))
    graph.frontier[:] = False
    graph.frontier[[on, back]] = True
    source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
    graph.risk[(source == on) | (graph.indices == on)] += 2.4
    x, y = graph.nodes[on, :2].tolist()
    request = PlanRequest((1.0, 1.5), (9.0, 1.5), 0.0, allow_frontier=True)
    assert plan(graph, grid, request).nodes[-1] == back, "it costs less"
    driven_to = replace(request, previous_frontier=(x - 0.1, y))
    assert plan(graph, grid, driven_to).nodes[-1] == on


def unseen_between(detour: bool) -> ElevationGrid:
    """8 x 4 m of level ground. Between x = 4 and 6 m rays passed low everywhere, or only behind a wall along the
    middle: the straight way is dark there."""
    y, x = np.mgrid[0:100, 0:200] * 0.04
    gap = (x > 4.0) & (x < 6.0)
    z = np.zeros(x.shape, np.float32)
    dark = gap & (y < 2.0) if detour else np.zeros(x.shape, bool)
    if detour:
        z[(np.abs(y - 2.0) < 0.1) & (x > 1.6) & (x < 7.0)] = 0.5
    z[dark] = np.nan
    return ElevationGrid(z, ~gap, (0.0, 0.0), 0.04, virtual=gap & ~dark)


def test_a_far_way_over_ground_that_nobody_saw_is_no_reason_to_leave_a_near_frontier() -> None:
    # Robots before the end of a lane turned round and drove all the way back, because hidden ground on another way
    # joined the goal to the graph.
    request = PlanRequest((3.0, 1.0), (7.3, 1.0), 0.0, allow_frontier=True)
    grid = unseen_between(detour=True)
    graph = TraversalGraph.build(grid, (3.0, 1.0), GraphParams(blind_radius=0.0))
    around = plan(graph, grid, replace(request, allow_frontier=False))
    assert around.cost > 12.0
    found = plan(graph, grid, request)
    assert not found.reaches_goal
    assert found.worth < around.cost
    assert found.points[:, 1].max() < 2.0


def test_a_way_ahead_over_ground_that_nobody_saw_leads_to_the_goal() -> None:
    grid = unseen_between(detour=False)
    graph = TraversalGraph.build(grid, (1.0, 1.0), GraphParams(blind_radius=0.0))
    request = PlanRequest((1.0, 1.0), (7.3, 1.0), 0.0, allow_frontier=True)
    assert plan(graph, grid, request).reaches_goal


def test_a_dear_way_over_known_ground_is_left_for_a_frontier_beside_it() -> None:
    z = np.zeros((160, 220), np.float32)
    known = np.ones(z.shape, bool)
    known[:50, 80:120] = False
    grid = ElevationGrid(z, known, (0.0, 0.0), 0.05)
    graph = TraversalGraph.build(grid, (2.0, 4.0), GraphParams(blind_radius=0.0))
    request = PlanRequest((2.0, 4.0), (8.0, 4.0), 0.0, allow_frontier=True)
    assert plan(graph, grid, request).reaches_goal
    left = graph.nodes[:, 0] < 5.0
    source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
    graph.price[left[source] != left[graph.indices]] += 50.0  # as over the edge of a kerb
    found = plan(graph, grid, request)
    assert not found.reaches_goal
    assert found.points[-1, 1] < 3.5
