"""The step `explore`, answer by answer, with a planner and a navigator that do as the test says."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot.stages.mission.attempt import Outcome, Verdict
from rbtrg_robot.stages.mission.explore import GIVE_UP, LOOKED, OTHER_GRAPHS, UNREACHABLE, Exploration
from rbtrg_robot.stages.mission.reserve import Reserve
from rbtrg_robot.wire.messages import array, header

Place = tuple[float, float]


class World:
    """Places that are to be looked from, until they are reached; some cannot be come to."""

    def __init__(self, places: list[Place], fails: dict[Place, int] | None = None, **step: Any) -> None:
        self.places, self.fails = places, fails or {}
        self.now = 10**12
        self.reserve = Reserve(0.1)
        self.step = msg.MissionStep(kind="explore", **step)
        self.explore = Exploration(self.step, self.now, (0.0, 0.0, 0.0))
        self.driven: list[Place] = []
        self.goal: msg.GoalStatus | None = None
        self.stays: set[Place] = set()
        """Places that are still to be looked from although the robot was there."""
        self.anew = 0
        self.edges: list[Place] = []
        self.silent = False
        self.home = 3.0
        """[m] that the planner found, and along what was driven."""
        self.trail = 3.0

    def run(self, limit: float = 600.0) -> Verdict:
        end = self.now + limit * NS
        while self.now < end:
            self.now += NS // 10
            for _, question in self.explore.orders(self.now, (0.0, 0.0, 0.0)):
                self.anew += question.anew
                if not self.silent:
                    self.explore.take(self.answer(question), self.now)
            if self.explore.wants_goal:
                assert self.explore.target is not None
                self.driven.append(self.explore.target)
                self.explore.drives(f"g{len(self.driven)}", self.now)
                self.goal = msg.GoalStatus(header(self.now, "map"), id=f"g{len(self.driven)}", state="moving")
            elif self.goal is not None and self.goal.state == "moving" and self.explore.target:
                place = self.explore.target
                if self.fails.get(place, 0) > 0:
                    self.fails[place] -= 1
                    self.goal.state, self.goal.reason = "aborted", "no_route"
                else:
                    self.goal.state = "reached"
                    if place not in self.stays:
                        self.places.remove(place)
            way = self.explore.way_home(self.trail)
            verdict = self.explore.verdict(
                self.now, self.goal, None, self.reserve.seconds(way), self.reserve.short(way)
            )
            if verdict.outcome is not Outcome.RUNNING:
                return verdict
        raise AssertionError("it did not end")

    def answer(self, question: msg.ExploreQuestion) -> msg.Viewpoints:
        barred = question.barred.reshape(-1, 2)
        left = [p for p in self.places if not any(math.dist(p, b) < 0.5 for b in barred)]
        return msg.Viewpoints(
            sequence=question.sequence,
            x=array([p[0] for p in left], "float64"),
            y=array([p[1] for p in left], "float64"),
            seen=100.0 - 10.0 * len(self.places),
            hidden=10.0 * len(self.places),
            home=self.home,
            unreachable_x=array([e[0] for e in self.edges], "float64"),
            unreachable_y=array([e[1] for e in self.edges], "float64"),
        )


def test_every_place_is_looked_from_and_then_other_graphs_are_asked_before_the_end() -> None:
    world = World([(1.0, 0.0), (5.0, 0.0)])
    end = world.run()
    assert end.outcome is Outcome.DONE
    assert world.driven == [(1.0, 0.0), (5.0, 0.0)]
    assert end.detail.startswith("no frontier left within the accepted risk: 100 m2 seen, 100 %")
    assert world.anew == OTHER_GRAPHS
    assert "left" not in end.detail.removeprefix("no frontier left")


def test_a_place_that_could_not_be_come_to_is_tried_once_more_before_the_end() -> None:
    world = World([(1.0, 0.0), (5.0, 0.0)], {(1.0, 0.0): 1})
    end = world.run()
    assert world.driven == [(1.0, 0.0), (5.0, 0.0), (1.0, 0.0)]
    assert "100 %" in end.detail
    world = World([(1.0, 0.0)], {(1.0, 0.0): 9})
    end = world.run()
    assert world.driven == [(1.0, 0.0)] * 2
    assert "left 1.0 0.0 (no route to the goal)" in end.detail


def test_every_place_left_is_told_with_its_reason() -> None:
    world = World([(1.0, 0.0)])
    world.stays, world.edges = {(1.0, 0.0)}, [(7.0, 7.0)]
    end = world.run()
    assert world.driven == [(1.0, 0.0)]  # it looked from there: nothing more is to be seen
    assert f"left 1.0 0.0 ({LOOKED})" in end.detail
    assert f"left 7.0 7.0 ({UNREACHABLE})" in end.detail


@pytest.mark.parametrize(("found", "driven"), [(9.0, 20.0), (20.0, 9.0), (math.inf, 9.0)])
def test_time_ends_it_early_enough_to_be_home(found: float, driven: float) -> None:
    world = World([(float(k), 0.0) for k in range(1, 300, 3)], duration=60.0)
    world.home, world.trail = found, driven  # 9 m: 30 s at the speed that is counted with
    began = world.now
    end = world.run()
    assert end.detail.startswith("the 1 minutes are over")
    assert 29.0 <= (world.now - began) / NS <= 32.0
    assert "(not looked from yet)" in end.detail


def test_a_battery_that_the_way_home_needs_ends_it() -> None:
    world = World([(1.0, 0.0), (5.0, 0.0)])
    world.home, world.trail = math.inf, 60.0  # where the planner finds no way the one that was driven counts
    world.reserve.take(0.12, (0.0, 0.0, 0.0), world.now)
    end = world.run()
    assert end.outcome is Outcome.DONE
    assert end.detail.startswith("the battery (12 %) is needed for the way home of 60 m")
    assert "(not looked from yet)" in end.detail


def test_coverage_of_an_area_ends_it() -> None:
    corners = array([0.0, 0.0, 9.0, 0.0, 9.0, 9.0], "float64")
    world = World([(1.0, 0.0), (5.0, 0.0), (8.0, 0.0)], area=corners, until=0.9)
    end = world.run()
    assert end.detail.startswith("90 % of the area are seen")
    assert len(world.driven) in (2, 3)


def test_a_try_that_was_interrupted_goes_on_with_what_it_knew() -> None:
    world = World([(1.0, 0.0), (5.0, 0.0)], {(1.0, 0.0): 9}, duration=600.0)
    with pytest.raises(AssertionError, match="did not end"):
        world.run(3.0)
    assert world.driven[0] == (1.0, 0.0)
    memory = world.explore.memory(world.now)
    assert json.loads(memory)["spent"] == pytest.approx(3.0, abs=0.2)
    world.explore = Exploration(world.step, world.now, (0.0, 0.0, 0.0), memory)
    end = world.run()
    assert world.driven.count((1.0, 0.0)) == 2, "given up before, and tried once more before the end"
    assert "left 1.0 0.0" in end.detail
    assert json.loads(world.explore.memory(world.now))["places"] == 1


def test_a_planner_that_is_silent_asks_for_an_operator() -> None:
    world = World([(1.0, 0.0)])
    world.silent = True
    began = world.now
    assert world.run().outcome is Outcome.NEEDS_OPERATOR
    assert (world.now - began) / NS < GIVE_UP + 2.0
