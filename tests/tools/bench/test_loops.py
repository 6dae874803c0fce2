"""A short drive of the bench of maps that close."""

from __future__ import annotations

import pytest

from tools.bench.loops import run


@pytest.mark.campaign
def test_a_short_round_closes_and_nothing_else_does() -> None:
    report = run(["--only", "ring", "--scale", "0.5"])
    rows = {row.key: row.value for row in report.rows}
    assert report.ok, report.to_text()
    assert rows["ring.loops"] >= 2
    assert rows["ring.wrong"] == 0
    assert 0.0 < rows["ring.after_m"] < rows["ring.before_m"]
