"""The step `cover`: where its lanes lie, and what it does with places that cannot be come to."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot.stages.mission.attempt import Outcome, Verdict
from rbtrg_robot.stages.mission.cover import GOAL_SPACING, Coverage, Place, lanes
from rbtrg_robot.wire.messages import array, header
from tests.rbtrg_robot.stages.mission.test_executor import World as Stage
from tests.rbtrg_robot.stages.mission.test_executor import order, step

BOX = [[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]]


def test_lanes_lie_along_the_long_side_and_are_driven_to_and_fro() -> None:
    assert lanes(np.array(BOX), 2.0, (0.0, 0.0)) == [
        pytest.approx(p) for p in [(1.0, 1.0), (5.0, 1.0), (5.0, 3.0), (1.0, 3.0)]
    ]
    assert lanes(np.array(BOX), 2.0, (6.0, 4.0))[0] == pytest.approx((5.0, 3.0))


@settings(deadline=None, max_examples=60)
@given(st.floats(1.0, 30.0), st.floats(1.0, 30.0), st.floats(-3.0, 3.0), st.floats(0.5, 4.0))
def test_no_ground_of_a_box_is_farther_from_a_lane_than_half_the_swath(
    length: float, width: float, turn: float, swath: float
) -> None:
    c, s = math.cos(turn), math.sin(turn)
    to_map = np.array([[c, s], [-s, c]])
    corners = np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]]) @ to_map
    way = np.array(lanes(corners, swath, (0.0, 0.0)))
    inside = way @ to_map.T
    assert (inside > -1e-6).all()
    assert (inside < [length + 1e-6, width + 1e-6]).all()
    ground = (
        np.stack(np.meshgrid(np.linspace(0, length, 9), np.linspace(0, width, 9)), -1).reshape(-1, 2) @ to_map
    )
    legs = np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(way)] or [way])
    nearest = np.linalg.norm(ground[:, None] - legs[None], axis=2).min(axis=1)
    assert nearest.max() <= math.hypot(0.5 * swath, 0.5 * swath) + 0.2
    assert (
        max(math.dist(a, b) for a, b in pairwise(way)) <= max(GOAL_SPACING, swath) + 1e-6
        if len(way) > 1
        else True
    )


def test_an_area_of_any_shape_has_its_lanes_inside() -> None:
    ell = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 2.0], [2.0, 2.0], [2.0, 8.0], [0.0, 8.0]])
    way = lanes(ell, 1.0, (0.0, 0.0))
    assert all((0 < x < 8 and 0 < y < 2) or (0 < x < 2 and 0 < y < 8) for x, y in way)
    assert max(y for _, y in way) > 7.0
    assert max(x for x, _ in way) > 7.0


class World:
    """A navigator that comes to each place, but for some."""

    def __init__(self, fails: dict[Place, int] | None = None, memory: str = "", **fields: Any) -> None:
        self.now, self.fails = 10**12, fails or {}
        area = array([v for corner in BOX for v in corner], "float64")
        self.step = msg.MissionStep(kind="cover", area=area, swath=2.0, **fields)
        self.cover = Coverage(self.step, self.now, (0.0, 0.0, 0.0), home=True, memory=memory)
        self.driven: list[Place] = []

    def run(self, places: int = 100, back: float = 0.0) -> Verdict:
        goal = None
        while True:
            self.now += 10 * NS
            verdict = self.cover.verdict(self.now, goal, None, back)
            if verdict.outcome is not Outcome.RUNNING or len(self.driven) >= places:
                return verdict
            assert self.cover.wants_goal
            assert self.cover.target is not None
            place = (round(self.cover.target[0], 6), round(self.cover.target[1], 6))
            self.driven.append(place)
            name = f"g{len(self.driven)}"
            self.cover.drives(name, self.now)
            goal = msg.GoalStatus(header(self.now, "map"), id=name, state="reached")
            if self.fails.get(place, 0) > 0:
                self.fails[place] -= 1
                goal.state, goal.reason = "aborted", "no_route"


def test_a_place_that_cannot_be_come_to_is_left_out_and_tried_once_more() -> None:
    world = World({(5.0, 1.0): 1})
    end = world.run()
    assert world.driven == [(1.0, 1.0), (5.0, 1.0), (5.0, 3.0), (1.0, 3.0), (5.0, 1.0)]
    assert (end.outcome, end.detail) == (Outcome.DONE, "all lanes are driven: 4 of 4 places on the lanes")
    end = World({(5.0, 1.0): 9}).run()
    assert end.outcome is Outcome.DONE
    assert "3 of 4 places on the lanes; left 5.0 1.0 (no route to the goal)" in end.detail
    assert World(dict.fromkeys(world.driven, 9)).run().outcome is Outcome.FAILED


def test_it_ends_in_time_to_be_home_and_goes_on_where_it_was() -> None:
    world = World(duration=100.0)
    end = world.run(back=70.0)
    assert end.detail.startswith("the 1.66667 minutes are over: 3 of 4 places")
    assert "left 1.0 3.0 (not driven to yet)" in end.detail
    begun = World()
    begun.run(places=2)
    again = World(memory=begun.cover.memory(begun.now))
    again.run()
    assert again.driven == [(5.0, 3.0), (1.0, 3.0)]


def test_the_stage_covers_and_resumes_over_a_pause_and_a_restart() -> None:
    stage = Stage()
    area = array([v for corner in BOX for v in corner], "float64")
    stage.run(0.3)
    assert "needs an area" in stage.ask("run", order=order(step("cover", swath=1.0)))
    assert "at least 0.3 m" in stage.ask("run", order=order(step("cover", area=area)))
    assert "in parts" in stage.ask("run", order=order(step("cover", area=1000.0 * area, swath=1.0)))
    stage.start(step("cover", area=area, swath=2.0), step("home"))
    stage.run(1.5)
    assert stage.ask("pause") == ""
    stage.restart()
    assert stage.ask("resume") == ""
    stage.stand(7.0, 1.0)
    stage.until("finished")
    assert stage.goals == pytest.approx([5.0, 1.0, 1.0, 1.0, 5.0, 0.0]), "the second place was under way"
    assert stage.state.result_description[0].startswith("all lanes are driven: 4 of 4")
