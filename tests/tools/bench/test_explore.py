"""The exploration bench: a small site end to end without the stack, and its table."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tools.bench.explore.bench import table
from tools.bench.explore.drawn import Walk
from tools.bench.explore.sites import SITES, site


@pytest.mark.parametrize("plain", [False, pytest.param(True, marks=pytest.mark.campaign)])
def test_a_small_site_is_seen_whole_and_the_robot_is_home(plain: bool) -> None:
    record = Walk(site("rooms", 0, 8.0), plain=plain).explore()
    assert record["share"] > 0.97
    assert record["home"]
    assert record["left"] == 0
    assert 0.0 < record["at_0.8"] <= record["at_0.95"] <= record["explored"] <= record["way"]


def test_there_are_ten_sites_of_20_to_60_m_and_each_can_be_begun() -> None:
    assert len(SITES) == 10
    assert all(20.0 <= side <= 60.0 for _, _, side in SITES)
    scene = site("basement", 9, 24.0)
    assert scene.height.min() == 0.0
    assert scene.z(1.2, 1.2) == pytest.approx(1.2, abs=0.05)


def test_the_table_compares_ways_of_the_same_site_only() -> None:
    def record(key: str, way: float, share: float = 0.99) -> dict[str, Any]:
        reached = way if share >= 0.97 else math.nan
        return {
            "key": key,
            "share": share,
            "home": True,
            "way": way,
            "at_0.97": reached,
            "at_0.5": 1.0,
            "at_0.8": 2.0,
            "at_0.95": 3.0,
        }

    report = table(
        [
            record("drawn.rooms.0.20.ours", 80.0),
            record("drawn.rooms.0.20.nearest", 100.0),
            record("drawn.yard.4.20.ours", 50.0, share=0.9),
            record("drawn.yard.4.20.nearest", 60.0),
        ],
        "drawn",
    )
    rows = {row.key: row for row in report.rows}
    assert rows["explore.drawn.ours_to_nearest.at_0.97"].value == 0.8
    assert rows["explore.drawn.ours.seen_97"].value == 0.5
    assert not rows["explore.drawn.ours.seen_97"].ok
