"""The table of monitors: rows that say something, limits that hold, and a way to take one out that is noticed."""

from __future__ import annotations

import math
from string import Formatter

import pytest

from hal.safety import monitors
from hal.safety.monitors import Check, Consequence, Monitor, taken_out
from tests.places import ROOT

ROW = Monitor(
    "a row", "imu", Check.RANGE, Consequence.HOLD, "robot", "{value:.0f} m/s^2", "look at it", 1.0, 2.0, "m/s^2"
)  # fmt: skip


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 0.9, 2.1])
def test_what_is_beyond_the_limits_or_no_number_is_outside(value: float) -> None:
    assert ROW.outside(value)


@pytest.mark.parametrize("value", [1.0, 1.5, 2.0])
def test_limits_are_allowed(value: float) -> None:
    assert not ROW.outside(value)


def test_limits_of_the_configuration_count_before_those_of_the_row() -> None:
    assert ROW.outside(1.5, high=1.4)
    assert not ROW.outside(0.5, low=0.0)


def test_a_monitor_that_was_taken_out_says_nothing_and_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(monitors.BY_NAME, ROW.name, ROW)
    with taken_out(ROW.name):
        assert not ROW.outside(math.nan)
        assert not ROW.active
    assert ROW.outside(math.nan)
    assert ROW.active


def test_only_monitors_of_the_table_are_taken_out() -> None:
    with pytest.raises(KeyError), taken_out("no such monitor"):
        pass


def test_words_are_found_again_in_what_the_operator_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(monitors, "MONITORS", (ROW,))
    assert monitors.raised(f"robot is held: {ROW.tell(value=3.0)}; battery low") == [ROW]
    assert monitors.raised("m/s^2") == []


def test_names_are_unique() -> None:
    assert len(monitors.BY_NAME) == len(monitors.MONITORS)


@pytest.mark.parametrize("row", monitors.MONITORS, ids=lambda row: row.name)
def test_a_row_says_what_and_what_to_do_and_names_its_test(row: Monitor) -> None:
    assert row.words
    assert row.remedy
    assert list(Formatter().parse(row.words))
    assert row.low < row.high
    assert row.unit or not (math.isfinite(row.low) or math.isfinite(row.high))
    test = (ROOT / "tests" / row.test).read_text()
    constant = next(name for name, value in vars(monitors).items() if value is row)
    assert constant in test, f"{row.test} does not speak of it"
    assert "with taken_out(" in test, f"{row.test} was not seen to fail without it"
