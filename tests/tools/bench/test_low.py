"""The bench of the motor level measures what it says, and tells a fault that does not soften the motors."""

from __future__ import annotations

import math

import pytest

from hal.unitree.low.loop import TOLD_SHARES, MotorLoop
from hal.unitree.low.process import CLASS_WIDTH, Gaps
from tools.bench.low import run


def test_a_fault_is_timed_and_its_words_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    report = run(["--only", "low.soft_s.nan"])
    (row,) = report.rows
    assert 0.0 < row.value <= 0.1
    assert report.ok
    assert "fault: the controller asked for what is not a number" in capsys.readouterr().err


def test_motors_that_stay_stiff_are_a_missed_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MotorLoop, "soften", lambda *_: None)
    report = run(["--only", "low.soft_s.hot"])
    assert math.isnan(report.rows[0].value)
    assert not report.ok


def test_what_the_loop_tells_of_its_times_are_their_quantiles() -> None:
    gaps = Gaps()
    times = [0.002] * 985 + [0.003] * 13 + [0.0101, 0.5]
    for gap in times:
        gaps.add(gap)
    wanted = (0.002, 0.003, 0.0101)
    assert len(wanted) == len(TOLD_SHARES)
    for told, exact in zip(gaps.shares(), wanted, strict=True):
        assert exact - 1e-9 <= told <= exact + 2 * CLASS_WIDTH
    assert gaps.worst == 0.5
