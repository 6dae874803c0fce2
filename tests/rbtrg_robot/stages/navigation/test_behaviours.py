"""The table of behaviours: read from the top, each row until its budget is spent."""

from __future__ import annotations

from pathlib import Path

import pytest

from rbtrg_robot.stage_config import NavigatorConfig
from rbtrg_robot.stages.navigation.behaviours import TABLE, Action, Behaviours, Trigger
from rbtrg_robot.stages.navigation.progress import Pose2

HERE, THERE = (1.0, 2.0, 0.3), (2.0, 2.0, 0.3)
CONFIG = NavigatorConfig(no_route_retries=2, max_recoveries=3, max_touches=4)


def all_of(behaviours: Behaviours, trigger: Trigger, pose: Pose2, **what: float | bool) -> list[Action]:
    """What is done until the goal ends."""
    done: list[Action] = []
    while Action.GIVE_UP not in done:
        done.append(behaviours.next(trigger, pose, **what))  # type: ignore[arg-type]
        assert len(done) < 50, "it never ends"
    return done[:-1]


def test_without_a_route_the_cheapest_is_tried_first_and_each_row_ends() -> None:
    look = [Action.LOOK] * 2
    assert all_of(Behaviours(CONFIG), Trigger.NO_ROUTE, HERE) == [Action.LOOK, *look, Action.MOVE_OUT]
    whole = Behaviours(CONFIG, feels_edges=True, tilts=True)
    assert all_of(whole, Trigger.NO_ROUTE, HERE) == [
        Action.LOOK, Action.LOOK_DOWN, *look, Action.CREEP, Action.MOVE_OUT
    ]  # fmt: skip
    assert whole.creep
    assert all_of(whole, Trigger.NO_ROUTE, THERE) == [Action.LOOK, Action.LOOK_DOWN, *look], (
        "once in a row, or once"
    )
    whole.found()
    assert all_of(whole, Trigger.NO_ROUTE, THERE) == [Action.LOOK, *look, Action.MOVE_OUT], (
        "a look down helps once"
    )


def test_places_kept_off_are_allowed_before_the_goal_ends() -> None:
    behaviours = Behaviours(CONFIG)
    assert behaviours.next(Trigger.STUCK, HERE, way=1.0) is Action.MOVE_OUT
    assert len(behaviours.avoid) == 3
    done = all_of(behaviours, Trigger.NO_ROUTE, HERE)
    assert done[-2:] == [Action.ALLOW, Action.MOVE_OUT]
    assert not behaviours.avoid


@pytest.mark.parametrize(("trigger", "times"), [(Trigger.STUCK, 3), (Trigger.TURN_STUCK, 3)])
def test_a_robot_that_is_stuck_moves_out_so_often_at_each_place(trigger: Trigger, times: int) -> None:
    behaviours = Behaviours(CONFIG)
    for pose in (HERE, THERE):
        assert all_of(behaviours, trigger, pose, way=1.0) == [Action.MOVE_OUT] * times


def test_a_held_turn_goes_on_a_little_where_there_is_room_and_the_wheels_felt_no_edge() -> None:
    behaviours = Behaviours(CONFIG)
    assert behaviours.next(Trigger.TURN_STUCK, HERE, room_ahead=True) is Action.MOVE_ON
    assert behaviours.next(Trigger.TURN_STUCK, HERE, room_ahead=True) is Action.MOVE_OUT
    behaviours.edge(THERE)
    assert behaviours.next(Trigger.TURN_STUCK, THERE, room_ahead=True) is Action.MOVE_OUT


def test_edges_and_touches_are_counted_for_the_goal_wherever_they_are() -> None:
    behaviours = Behaviours(CONFIG, feels_edges=True)
    places = [(float(k), 0.0, 0.0) for k in range(9)]
    assert [behaviours.edge(pose) for pose in places[:4]] == [Action.MOVE_OUT] * 3 + [Action.GIVE_UP]
    touched = [behaviours.touched(pose, 1.0, 2.0) for pose in places[:5]]
    assert touched == [Action.MOVE_OUT] * 4 + [Action.GIVE_UP]


def test_every_setting_of_the_table_is_one() -> None:
    assert all(isinstance(row.times, int) or row.times in NavigatorConfig.model_fields for row in TABLE)
    assert {row.trigger for row in TABLE} == set(Trigger)


def test_the_page_shows_the_table_as_it_is() -> None:
    page = (Path(__file__).parents[4] / "docs" / "design" / "navigation.md").read_text()
    shown = [line for line in page.splitlines() if line.startswith("| ")][1:]
    assert shown == [
        f"| {row.trigger} | {row.action} | {row.times} | {row.per} | {row.needs} |".replace("  |", " |")
        for row in TABLE
    ]
