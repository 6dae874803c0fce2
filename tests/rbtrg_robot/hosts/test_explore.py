"""Goals beyond what the robot has seen, with the whole stack in the loop."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.errors import NoRoute
from planning.graph.graph import TraversalGraph
from planning.search.plan import PlanRequest, plan
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from tests.places import TERRAIN, needs_shared


def explore(scene: str, goal: str, timeout: float) -> tuple[str, str, float, float]:
    """State and reason at the end, driven [m] in truth, length [m] of the route on the whole scene (inf: none)."""
    config = load(None, [], scene=scene)
    world = config.load_scene()
    x, y, _ = world.goals[goal]
    grid = ElevationGrid(world.height, np.isfinite(world.height), world.origin, world.resolution)
    try:
        known = plan(
            TraversalGraph.build(grid, world.start[:2]), grid, PlanRequest(world.start[:2], (x, y))
        ).length
    except NoRoute:
        known = math.inf
    with Lockstep(config) as stack:
        stack.wait_ready()
        stack.send_goal(x, y)
        track: list[tuple[float, float]] = []
        while stack.newest[t.GOAL_STATUS].state not in ("reached", "aborted", "rejected"):
            assert stack.seconds < timeout, f"{stack.newest[t.GOAL_STATUS].detail} after {timeout} s"
            stack.run(0.2)
            place = stack.newest[t.TRUTH].pose.pose.position
            track.append((place.x, place.y))
        status = stack.newest[t.GOAL_STATUS]
    driven = sum(math.dist(a, b) for a, b in pairwise(track))
    return status.state, status.reason, driven, known


@pytest.mark.campaign
def test_a_goal_in_a_maze_nobody_has_seen_is_reached_without_driving_twice_the_way() -> None:
    state, reason, driven, known = explore("maze", "half", 100.0)
    assert (state, reason) == ("reached", "")
    assert 8.0 < known < driven <= 2.0 * known


@needs_shared
@pytest.mark.campaign
def test_a_goal_that_cannot_be_reached_ends_in_no_route_once_all_is_seen() -> None:
    state, reason, driven, known = explore(str(TERRAIN / "maze.ply"), "far", 120.0)
    assert known == math.inf, "between a block and the rim of the scan 0.4 m are left"
    assert (state, reason) == ("aborted", "no_route")
    assert driven > 5.0, "it went to look"
