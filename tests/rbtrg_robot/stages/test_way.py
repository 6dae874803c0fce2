"""The search for a way to one goal, and how fast it is driven."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hal.types import NS
from planning.errors import NoRoute, NoRouteReason
from planning.search.plan import Plan
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.stages import tracker
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.stages.navigation.path_order import PathOrder
from rbtrg_robot.stages.way import MOST_REDRAWS
from rbtrg_robot.wire.convert import odometry_msg, rpy_quaternion
from rbtrg_robot.wire.messages import header
from tests.rbtrg_robot.hearsay import map_offset
from tests.rbtrg_robot.stages.test_planner import ask, patch, planner


@pytest.mark.parametrize("narrow", [{"reaches_goal": False}, {"cost": 40.0}])
@pytest.mark.parametrize(("good", "drawn"), [(1, 1), (2, 2), (9, MOST_REDRAWS)])
def test_a_way_that_was_lost_is_searched_in_other_graphs_before_another_is_driven(
    good: int, drawn: int, narrow: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In graphs of seeds below `good` the passage holds no edge: the plan ends before it, or leads a dear way
    around."""
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 150))))
    assert ask(stage, (1.5, 1.5), (5.0, 1.5)).reaches_goal
    first, search = stage._map.graph, MapGraph.search

    def in_graph(self: MapGraph, *args: Any) -> Plan:
        found = search(self, *args)
        return found if self.seed >= good else replace(found, **narrow)

    monkeypatch.setattr(MapGraph, "search", in_graph)
    answer = ask(stage, (1.5, 1.5), (5.0, 1.5), sequence=2)
    found = good <= drawn
    assert (answer.ok, answer.reaches_goal, stage._map.seed) == (True, found or "cost" in narrow, drawn)
    assert (stage._map.graph is first) != found, "without a way the graph stays as it was"
    if not found:  # what has no way any more is not searched again
        assert ask(stage, (1.5, 1.5), (5.0, 1.5), sequence=3).ok
        assert stage._map.seed == drawn


@pytest.mark.parametrize(("good", "drawn"), [(0, 0), (2, 2), (9, 0)])
def test_a_new_way_with_a_leg_much_dearer_than_long_is_compared_with_those_of_other_graphs(
    good: int, drawn: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a turn over the edge of a kerb is. The graph with the least cost stays."""
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 150))))
    search, searched = MapGraph.search, []

    def with_a_dear_leg(self: MapGraph, *args: Any) -> Plan:
        found = search(self, *args)
        searched.append(self.seed)
        if self.seed >= good:
            return found
        leg = found.transitions[0]
        legs = (replace(leg, cost=leg.cost + 20.0), *found.transitions[1:])
        return replace(found, transitions=legs, cost=found.cost + 20.0 + self.seed)

    monkeypatch.setattr(MapGraph, "search", with_a_dear_leg)
    assert ask(stage, (1.5, 1.5), (5.0, 1.5)).reaches_goal
    assert searched == list(range(min(good, MOST_REDRAWS) + 1))
    assert stage._map.graph.seed == drawn


def test_where_there_is_no_way_other_graphs_are_searched_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(np.zeros((75, 150))))
    search = MapGraph.search

    def none_in_the_first(self: MapGraph, *args: Any) -> Plan:
        if self.seed < 3:
            raise NoRoute(NoRouteReason.NO_ROUTE, "no edge")
        return search(self, *args)

    monkeypatch.setattr(MapGraph, "search", none_in_the_first)
    answer = ask(stage, (1.5, 1.5), (5.0, 1.5))
    assert (answer.ok, answer.reaches_goal, stage._map.seed) == (True, True, 3)


def commanded(plan: msg.Plan) -> np.ndarray:
    """(n, 2) x of base_link [m] and the speed [m/s] that navigator and tracker ask for there, of a robot that does at
    once what it is told."""
    stage = tracker.build(load(None, [], scene="flat", controller="vmc"))
    stage.on(t.TF_STATIC, map_offset())
    stage.on(t.PATH_COMMAND, PathOrder().route(NS, plan, creep=0.1))
    x, y, yaw, speed = float(plan.x[0]), float(plan.y[0]), 0.0, 0.0
    out = []
    for now in range(NS, 12 * NS, NS // 50):
        turned, moving = rpy_quaternion((0.0, 0.0, yaw)), np.array([speed, 0.0, 0.0])
        pose = odometry_msg(now, np.array([x, y, 0.4]), turned, moving, np.zeros(3))
        for topic in (t.POSE, t.ODOM):
            stage.on(topic, pose)
        for topic in (t.MAP_STATUS, t.GOAL_STATUS):
            stage.on(topic, topic.kind(header=header(now, "map")))
        twist = next(m for topic, m in stage.tick(now) if topic is t.CMD_VEL).twist
        speed = twist.linear.x
        out.append((x, speed))
        x, y = x + speed * np.cos(yaw) / 50, y + speed * np.sin(yaw) / 50
        yaw += twist.angular.z / 50
    return np.array(out)


def test_ground_of_which_a_part_was_not_seen_comes_under_the_leading_wheels_slowly() -> None:
    """A lane 0.6 m wide. Beside its middle, under the left wheels, 9 cm were not seen from x = 2.4 to 3 m; rays passed
    2 cm above them."""
    fastest = []
    for last in (75, 60):  # then all of it was seen
        ground = np.full((60, 150), 0.8)
        ground[23:38] = 0.0
        seen = np.ones(ground.shape)
        seen[33:38, 60:last] = 0.0
        stage = planner()
        stage.on(t.MAP_UPDATE, patch(ground, seen, bound=0.02))
        plan = ask(stage, (1.2, 1.2), (4.6, 1.2))
        assert (plan.ok, plan.reaches_goal) == (True, True)
        x, speed = commanded(plan).T
        assert x[-1] > 4.5
        wheels = x + 0.225
        over = (wheels > 2.4) & (wheels < 2.96)
        assert over.sum() > 20
        fastest.append(speed[over].max())
        assert speed[wheels < 2.0].max() > 0.4
    assert fastest[0] <= 0.2
    assert fastest[1] > 0.4


def test_where_every_way_begins_with_ground_that_nobody_saw_it_is_crept_when_that_is_asked_for() -> None:
    """A lane 1 m wide of which nothing was seen from x = 1.6 to 2.6 m; rays passed 2 cm above it."""
    ground = np.full((60, 150), 0.8)
    ground[18:43, 10:] = 0.0
    seen = np.ones(ground.shape)
    seen[18:43, 40:65] = 0.0
    stage = planner()
    stage.on(t.MAP_UPDATE, patch(ground, seen, bound=0.02))
    start, goal = (1.4, 1.2), (4.6, 1.2)
    refused = ask(stage, start, goal)
    assert (refused.ok, refused.creep) == (False, False)
    assert "drive it by hand, slowly" in refused.detail
    plan = ask(stage, start, goal, sequence=2, creep=True)
    assert (plan.ok, plan.creep, plan.reaches_goal) == (True, True, False)
    assert plan.x[-1] == pytest.approx(1.75, abs=0.03)
    x, speed = commanded(plan).T
    assert x[-1] > 1.7
    assert speed.max() == pytest.approx(0.1)
    # What it comes to without creeping it drives to as ever, creep or not.
    plan = ask(stage, (0.9, 1.2), goal, sequence=3, creep=True)
    assert (plan.ok, plan.creep) == (True, False)
    assert plan.speed.max() > 0.12
    plan = ask(stage, (0.9, 1.2), (0.9, 1.3), sequence=4, creep=True)
    assert not plan.creep
    # It may still stand at an edge there, until it is far enough from where it crept.
    assert dict(stage.tick(3 * NS))[t.ROUTE_STATUS].crept
    ask(stage, (2.95, 1.2), goal, sequence=5)
    assert not dict(stage.tick(4 * NS))[t.ROUTE_STATUS].crept
