"""How much of a path may be driven by now."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from planning.path import Path, backs_up, creeping, drivable, make_path
from planning.risk.body import BodyModel
from planning.search.plan import DriveRules, PlanRequest, plan
from tests.planning.worlds import flat

BODY = BodyModel()
START = (4.0, 1.5)


def ground(unknown: tuple[float, float] | None) -> ElevationGrid:
    """Level; of a stripe 4 cm wide that lies along the way, x from `unknown[0]` to `unknown[1]` [m] was not seen."""
    level = flat(5.0, 3.0, 0.04)
    trusted = level.trusted.copy()
    if unknown is not None:
        x = np.arange(trusted.shape[1]) * 0.04
        trusted[round((START[1] + 0.1) / 0.04), (x > unknown[0]) & (x < unknown[1])] = False
    return replace(level, trusted=trusted)


def way(yaw: float, grid: ElevationGrid) -> tuple[TraversalGraph, Path]:
    """From the start 2.5 m along -x by a robot that looks at `yaw` [rad] and is to look there at the end."""
    graph = TraversalGraph.build(grid, START, GraphParams(), 0)
    request = PlanRequest(START, (1.5, 1.5), yaw, yaw, rules=DriveRules(1.2, 2.0, straight=True))
    return graph, make_path(plan(graph, grid, request), grid, BODY)


@pytest.mark.parametrize("edge", [3.0, 2.4])
def test_a_path_backward_ends_before_ground_where_the_guard_would_hold_the_robot(edge: float) -> None:
    grid = ground((edge - 0.5, edge))
    graph, path = way(0.0, grid)
    assert backs_up(path)
    part = drivable(path, graph, grid, BODY.width)
    assert part is not None
    rear = part.points[-1, 0] - 0.35
    assert edge + 0.05 < rear < edge + 0.25


def test_a_path_backward_onto_ground_that_the_map_does_not_know_is_none_and_forward_it_is_one() -> None:
    grid = ground((3.0, 3.6))
    for yaw, backward in ((0.0, True), (np.pi, False)):
        graph, path = way(yaw, grid)
        assert backs_up(path) is backward
        part = drivable(path, graph, grid, BODY.width)
        assert (part is None) is backward


def test_over_what_is_narrower_than_a_gap_it_backs_up() -> None:
    grid = ground((3.0, 3.07))
    graph, path = way(0.0, grid)
    assert backs_up(path)
    assert drivable(path, graph, grid, BODY.width) is path


def test_where_a_part_of_the_ground_under_the_leading_wheels_was_not_seen_it_is_driven_slowly() -> None:
    # 9 cm of the 43 under the wheels, along one side, x from 2.2 to 2.8 m, on a way that was planned before; driven
    # along -x
    level = flat(5.0, 3.0, 0.04)
    _, path = way(np.pi, level)
    unseen = np.zeros(level.height.shape, np.bool_)
    unseen[42:47, 55:70] = True
    grid = replace(level, trusted=~unseen, virtual=unseen)
    graph = TraversalGraph.build(grid, START, GraphParams(blind_radius=0.0), 0)
    part = drivable(path, graph, grid, BODY.width)
    assert part is not None
    assert len(part.points) == len(path.points)
    ahead = part.points[:, 0] - 0.225  # where the leading wheels touch the ground
    over = (ahead > 2.2) & (ahead < 2.76)
    assert path.speed[over].min() > 0.4
    assert part.speed[over].max() == pytest.approx(0.2)
    assert (np.abs(np.diff(part.speed**2)) <= 2.0 * part.limits.max_accel * np.diff(part.s) + 1e-9).all()
    beyond = (ahead > 3.3) | ((ahead < 1.6) & (np.arange(len(ahead)) < np.argmin(ahead)))
    assert part.speed[beyond] == pytest.approx(path.speed[beyond])


def test_with_a_part_of_the_body_over_leaves_it_is_driven_slowly() -> None:
    level = flat(5.0, 3.0, 0.04)
    leaves = np.zeros(level.height.shape, np.bool_)
    leaves[:, 55:70] = True  # x from 2.2 to 2.8 m, driven along -x
    grid = replace(level, plants=leaves)
    graph, path = way(np.pi, grid)
    part = drivable(path, graph, grid, BODY.width)
    assert part is not None
    assert len(part.points) == len(path.points)
    over = (part.points[:, 0] > 2.2 - 0.35) & (part.points[:, 0] < 2.76 + 0.35)
    assert path.speed[over].min() > 0.4
    assert part.speed[over].max() == pytest.approx(0.2)
    assert part.speed[~over].max() > 0.35
    assert (np.abs(np.diff(part.speed**2)) <= 2.0 * part.limits.max_accel * np.diff(part.s) + 1e-9).all()


def onto_unseen(yaw: float, first: float, low: float = -1.0) -> tuple[TraversalGraph, Path, ElevationGrid]:
    """A way along -x to ground beyond x = `first` and y = `low` [m] that nobody saw, over which rays passed, by a robot
    that looks at `yaw` [rad]."""
    level = flat(5.0, 3.0, 0.04)
    y, x = np.mgrid[: level.shape[0], : level.shape[1]] * 0.04
    unseen = (x < first) & (y > low)
    grid = replace(level, trusted=~unseen, virtual=unseen)
    graph = TraversalGraph.build(grid, START, GraphParams(blind_radius=0.0), 0)
    request = PlanRequest(START, (1.5, 1.5), yaw, rules=DriveRules(np.inf, 2.0, straight=True))
    return graph, make_path(plan(graph, grid, request), grid, BODY), grid


def test_onto_ground_that_nobody_saw_it_creeps_a_third_of_a_metre() -> None:
    graph, path, grid = onto_unseen(np.pi, 3.8)
    assert drivable(path, graph, grid, BODY.width) is None
    part = creeping(path, graph, BODY.width, 0.1)
    assert part is not None
    assert 0.3 < part.length <= 0.35 + 1e-9
    assert part.speed.max() == pytest.approx(0.1)
    assert part.speed[-1] == 0.0


def test_it_creeps_neither_backward_nor_over_what_needs_more_speed() -> None:
    graph, path, _ = onto_unseen(np.pi, 3.8)
    faster = np.where(path.s > 0.2, 0.5, 0.0)
    part = creeping(replace(path, least=faster), graph, BODY.width, 0.1)
    assert part is not None
    assert part.length == pytest.approx(0.2, abs=0.03)
    assert creeping(replace(path, least=faster + 0.5), graph, BODY.width, 0.1) is None
    assert creeping(replace(path, yaw=path.yaw + np.pi), graph, BODY.width, 0.1) is None


@pytest.mark.parametrize(("low", "turns"), [(1.15, False), (1.85, False), (2.0, True)])
def test_it_turns_no_wheel_onto_ground_that_nobody_saw(low: float, turns: bool) -> None:
    """It stands across the way. What lies 0.35 m beside it, where it turns its wheels to or may drift to, was seen or
    not."""
    level = flat(5.0, 3.0, 0.04)
    _, path, _ = onto_unseen(np.pi / 2, 0.0)
    assert abs(path.initial_turn or 0.0) == pytest.approx(np.pi / 2, abs=0.1)
    unseen = np.zeros(level.shape, np.bool_)
    unseen[round(low / 0.04) : round((low + 0.8) / 0.04), 90:] = True
    unseen[:, :70] = True
    unseen[30:46, 94:108] = False  # what it stands on
    grid = replace(level, trusted=~unseen, virtual=unseen)
    graph = TraversalGraph.build(grid, START, GraphParams(blind_radius=0.0), 0)
    assert (creeping(path, graph, BODY.width, 0.1) is not None) is turns
