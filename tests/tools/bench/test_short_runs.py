"""Benches that no other test runs: a few seconds of each, with its limits."""

from __future__ import annotations

import pytest

from tools.bench.outside import bench as outside
from tools.bench.perception import bench as perception
from tools.bench.perception import open_ground


def test_bags_and_files_of_others_are_read_or_refused_with_words_that_help() -> None:
    report = outside.run([])
    assert not [row for row in report.rows if not row.ok]
    assert len(report.rows) == 47


def test_open_ground_and_a_crowd_are_driven_within_their_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("WAY", 0.4), ("REST", 1.2), ("SECONDS", 2.0), ("SIGHTS", ("field_wall",))):
        monkeypatch.setattr(open_ground, name, value)
    monkeypatch.setattr(open_ground, "CROWDS", ("field_posts",))
    report = perception.run(["--only", "open", "--open", "1"])
    assert not [
        row for row in report.rows if not row.ok and row.unit != "%"
    ]  # of so short a way a share says nothing
    assert [row.key for row in report.rows] == [
        "open.field_wall.yaw_deg",
        "open.field_wall.way_pct",
        "open.field_wall.held",
        *(
            f"crowd.field_posts.{what}"
            for what in ("standing_m", "standing_deg", "stood", "driving_m", "drove")
        ),
    ]
