"""Another robot than the default one drives the whole stack, and is judged by its own grade."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tools.bench import barn, robots
from tools.bench.lanes.trial import Trial, drive


@pytest.mark.campaign
@pytest.mark.parametrize("driver", ["jackal/drive", "go2/trot"])
def test_another_robot_reaches_a_goal_of_the_yard(driver: str) -> None:
    """On four fixed wheels, and on feet."""
    record = drive(Trial(0, 0, driver, "seen", goal="yard/a"))
    assert record["outcome"] == "reached"
    assert record["error"] < 0.3
    assert record["key"] == f"{driver.replace('/', '-')}.seen.yard.a.0"


def test_a_world_of_the_challenge_is_driven_and_judged_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(barn, "LONGEST_DRIVE", 1.5)
    command = ["--robots", "jackal", "--seeds", "0", "--workers", "0", "--out", str(tmp_path / "out.jsonl")]
    report = barn.run(command)
    monkeypatch.setattr(barn, "drive", lambda *_: pytest.fail("it stands in the file"))
    assert barn.run(command).rows == report.rows
    rows = {row.key: row for row in report.rows}
    assert rows["barn.jackal.touched"].value == 0.0
    assert rows["barn.jackal.reached"].value == rows["barn.jackal.metric"].value == 0.0, "there is no time to"


def test_what_each_robot_must_do_becomes_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    driven: list[str] = []

    def drives(trials: list[Trial], *_: Any) -> list[dict[str, Any]]:
        driven.extend(trial.key for trial in trials)
        return [
            {
                "key": trial.key,
                "outcome": "refused" if trial.level == 5 else "fell" if trial.seed == 3 else "reached",
            }
            for trial in trials
        ]

    monkeypatch.setattr(robots, "driven", drives)
    report = robots.run(["--robots", "jackal", "--seeds", "0-3", "--levels", "1-2"])
    rows = {row.key: row for row in report.rows}
    assert rows["robots.jackal.wrong"].value == 0.0
    assert (rows["robots.jackal.goals.reached"].value, rows["robots.jackal.forbidden.refused"].value) == (
        1.0,
        1.0,
    )
    assert rows["robots.jackal.lanes.reached"].value == 0.75
    assert not rows["robots.jackal.lanes.reached"].ok
    assert rows["robots.jackal.fell"].value == 2 / 13
    assert len(driven) == 13
