"""What is kept of the battery for the way home, and how long that way is."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from hal.types import NS
from rbtrg_robot.stage_config import HomeConfig
from rbtrg_robot.stages.mission.reserve import CHARGE_STEP, Reserve
from rbtrg_robot.stages.mission.way_home import DETOUR_FACTOR, WayHome

HOME = HomeConfig()


def driven(
    metres: int, per_metre: float, floor: float = 0.1, percents: bool = False, home: HomeConfig = HOME
) -> Reserve:
    """At 0.5 m/s, ten poses a second."""
    reserve = Reserve(floor, home)
    for k in range(20 * metres + 1):
        charge = 0.9 - per_metre * 0.05 * k
        reserve.take(round(charge, 2) if percents else charge, (0.05 * k, 0.0, 0.0), k * NS // 10)
    return reserve


@pytest.mark.parametrize("percents", [False, True])
def test_the_way_home_is_told_by_what_driving_cost_with_a_fifth_more(percents: bool) -> None:
    reserve = driven(300, 0.002, percents=percents)  # 30 % are left, 20 % above the floor
    assert reserve.per_metre == pytest.approx(0.002, rel=0.02)
    least = (0.2 - CHARGE_STEP) / (1.2 * reserve.per_metre)
    assert reserve.short(least - 1.0) == ""
    assert "30 %" in reserve.short(least + 1.0)


def test_it_is_told_two_minutes_ahead() -> None:
    reserve = driven(250, 0.002)
    assert reserve.warning(10.0) == ""
    way = next(way for way in range(10, 90) if reserve.warning(float(way)))
    assert reserve.left(float(way)) == pytest.approx(120.0, abs=2.0)
    assert not reserve.short(float(way))
    assert "will be needed for the way home" in reserve.warning(float(way))


def test_the_operator_sets_the_reserve_and_when_it_is_told() -> None:
    usual, careful = driven(250, 0.002), driven(250, 0.002, home=HomeConfig(reserve=3.0, told_ahead=0.0))
    least = (0.3 - CHARGE_STEP) / 0.002
    assert [r.short(least / 2.0) != "" for r in (usual, careful)] == [False, True]
    way = next(way for way in range(10, 90) if careful.warning(float(way)))
    assert careful.short(float(way)), "nothing is told ahead"
    assert usual.seconds(3.0) == pytest.approx(10.0)


def test_before_much_was_driven_a_cautious_figure_counts_and_an_unknown_way_says_nothing() -> None:
    assert driven(1, 0.0).per_metre == HOME.per_metre
    assert driven(1, 0.0).short(1e5) != ""
    assert driven(1, 0.0).short(math.inf) == driven(1, 0.0).short(math.nan) == Reserve(0.1).short(10.0) == ""


def test_a_battery_that_tells_one_charge_all_the_way_is_told() -> None:
    assert driven(300, 0.0005, percents=True).warning(10.0) == ""
    assert driven(150, 0.0).warning(10.0) == ""
    reserve = driven(250, 0.0)
    assert reserve.warning(10.0).startswith("the battery has told 90 % for 250 m of driving: it may be stuck")
    assert reserve.short(10.0) == ""
    reserve.take(0.89, (12.6, 0.0, 0.0), 600 * NS)
    assert reserve.warning(10.0) == ""


def test_what_standing_took_is_no_cost_of_driving_and_a_pose_that_was_set_is_no_drive() -> None:
    reserve = Reserve(0.1)
    for k in range(1000):
        reserve.take(0.9 - 0.0004 * k, (0.0, 0.0, 0.0), k * NS)
    for k in range(200):
        reserve.take(0.5, (0.05 * k, 0.0, 0.0), (1000 + k) * NS)
    reserve.take(0.4, (100.0, 0.0, 0.0), 1300 * NS)
    assert reserve.per_metre == pytest.approx(0.1 / 10.0, rel=0.02)  # of 10 m, not of 100


def walk(way: WayHome, *corners: tuple[float, float], home: tuple[float, float] = (0.0, 0.0)) -> None:
    for (x0, y0), (x1, y1) in pairwise(corners):
        steps = max(1, round(math.dist((x0, y0), (x1, y1)) / 0.05))
        for k in range(steps + 1):
            way.take((x0 + k / steps * (x1 - x0), y0 + k / steps * (y1 - y0), 0.0), (*home, 0.0))


def test_the_way_home_leads_along_the_trail_and_cuts_its_loops() -> None:
    way = WayHome()
    walk(way, (0.0, 0.0), (10.0, 0.0), (10.0, 8.0))
    assert way.length == pytest.approx(18.0, abs=0.5)
    places = way.places(4.0)
    assert places[-1] == (0.0, 0.0)
    assert all(abs(y) < 0.4 or abs(x - 10.0) < 0.4 for x, y in places)
    assert [math.dist(a, b) < 6.1 for a, b in pairwise(places)] == [True] * (len(places) - 1)
    walk(way, (10.0, 8.0), (2.0, 8.0), (2.0, 0.0))
    assert way.length == pytest.approx(2.0, abs=0.4), "it crossed its way out"
    walk(way, (2.0, 0.0), (2.0, 8.0))
    assert way.length == pytest.approx(10.0, abs=0.5)


def test_a_wall_between_two_ways_is_not_crossed() -> None:
    way = WayHome()
    walk(way, (0.0, 0.0), (10.0, 0.0), (10.0, 0.7), (0.0, 0.7))
    assert way.length == pytest.approx(20.7, abs=0.6)


def test_a_home_where_the_robot_never_was_is_guessed_and_a_pose_that_was_set_begins_anew() -> None:
    way = WayHome()
    walk(way, (0.0, 0.0), (4.0, 0.0), home=(0.0, 6.0))
    assert way.length == pytest.approx(DETOUR_FACTOR * math.hypot(4.0, 6.0), rel=0.01)
    way.take((4.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    assert way.length == pytest.approx(2.0, abs=0.4)
    way.take((40.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    assert way.length == pytest.approx(DETOUR_FACTOR * 38.0, rel=0.01)
    way.take((40.0, 0.0, 0.0), None)
    assert math.isnan(way.length)
    assert WayHome().places(4.0) == []
