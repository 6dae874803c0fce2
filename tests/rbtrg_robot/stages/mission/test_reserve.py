"""What is kept of the battery for the way home."""

from __future__ import annotations

import math

import pytest

from rbtrg_robot.stages.mission.reserve import MORE, Reserve


def driven(metres: int, per_metre: float, floor: float = 0.1) -> Reserve:
    reserve = Reserve(floor)
    for k in range(10 * metres + 1):
        reserve.take(0.9 - per_metre * 0.1 * k, (0.1 * k, 0.0, 0.0))
    return reserve


def test_the_way_home_is_told_by_what_driving_cost_with_a_fifth_more() -> None:
    reserve = driven(300, 0.002)  # 30 % are left, 20 % above the floor
    assert reserve.per_metre == pytest.approx(0.002, rel=0.25)
    least = 0.2 / (MORE * reserve.per_metre)
    assert reserve.short(least - 1.0) == ""
    assert "30 %" in reserve.short(least + 1.0)


def test_before_much_was_driven_a_cautious_figure_counts_and_an_unknown_way_says_nothing() -> None:
    assert driven(1, 0.0).per_metre == pytest.approx(0.0005, rel=0.02)
    assert driven(1, 0.0).short(1e5) != ""
    assert driven(1, 0.0).short(math.inf) == driven(1, 0.0).short(math.nan) == Reserve(0.1).short(10.0) == ""


def test_a_pose_that_was_set_is_no_drive() -> None:
    reserve = Reserve(0.1)
    reserve.take(0.9, (0.0, 0.0, 0.0))
    reserve.take(0.8, (50.0, 0.0, 0.0))
    assert reserve.per_metre == pytest.approx((0.1 + 0.05) / 100.0)
