"""`tools.bench home`: one trial of it, and its rows."""

from __future__ import annotations

import math

import pytest

from tools.bench.home import Record, Trial, drive, table


@pytest.mark.campaign
def test_a_battery_that_runs_low_on_the_way_to_a_goal_brings_the_robot_home() -> None:
    record = drive(Trial("battery/goal", "flat/a", 0))
    assert record.ok, record.words
    assert 0.1 < record.battery < 0.12
    assert record.told >= 0.0


def test_the_rows_count_what_was_home_or_did_what_was_chosen() -> None:
    records = [
        Record("battery/goal/flat/a/0", True, "", 30.0, 0.1, 3.0),
        Record("battery/goal/flat/b/0", False, "it is 2.0 m from home", 30.0, 0.1, 3.0),
        Record("link/hold/flat/a/0", True, "", 30.0, 1.0, math.nan),
    ]
    rows = {row.key: row for row in table(records).rows}
    assert [(rows[k].value, rows[k].trials) for k in ("home.battery.goal", "home.link.hold")] == [
        (0.5, 2),
        (1.0, 1),
    ]
    assert not rows["home.all"].ok
    assert rows["home.told_ahead"].value == 3.0
