"""Predicted against observed failures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tools.bench.calibration import run


def records(file: Path, rates: list[tuple[float, float]], count: int, seed: int) -> Path:
    """So many drives for each told and true rate."""
    rng = np.random.default_rng(seed)
    with file.open("w") as out:
        for k, (told, true) in enumerate(rates):
            for n in range(count):
                outcome = "fell" if rng.random() < true else "reached"
                row = {"key": f"{k}.{n}", "map": "prior", "p_fail": told, "outcome": outcome, "driven": 5.0}
                out.write(json.dumps(row) + "\n")
        for key, more in (
            ("refused", {"map": "prior", "p_fail": 0.9, "outcome": "refused", "driven": 0.0}),
            ("seen", {"map": "seen", "p_fail": 0.9, "outcome": "reached", "driven": 5.0}),
            ("unknown", {"map": "prior", "p_fail": None, "outcome": "reached", "driven": 5.0}),
        ):
            out.write(json.dumps({"key": key, **more}) + "\n")
    return file


def test_a_model_that_tells_the_truth_keeps_the_limits_and_one_that_does_not_misses_them(
    tmp_path: Path,
) -> None:
    good = records(tmp_path / "good", [(0.02, 0.02), (0.15, 0.15), (0.45, 0.45)], 300, 0)
    report = run([str(good), "--picture", str(tmp_path / "good.png")])
    rows = {row.key: row for row in report.rows}
    assert report.ok
    assert rows["calibration.drives"].value == 900, "drives that are refused, seen or not told are left out"
    assert rows["calibration.told"].value == pytest.approx(0.2067, abs=1e-3)
    assert rows["calibration.brier"].value < rows["calibration.brier_of_rate"].value
    assert rows["calibration.decile.4.drives"].value == 300
    assert (tmp_path / "good.png").stat().st_size > 5000
    shy = run([str(records(tmp_path / "shy", [(0.02, 0.2)], 300, 1))])
    assert {row.key for row in shy.rows if not row.ok} == {
        "calibration.difference",
        "calibration.decile.0.difference",
    }
    few = run([str(records(tmp_path / "few", [(0.02, 0.02), (0.95, 0.0)], 10, 2))])
    assert next(row for row in few.rows if row.key == "calibration.decile.9.difference").ok, (
        "too few to judge"
    )


def test_without_drives_nothing_is_claimed(tmp_path: Path) -> None:
    report = run([str(records(tmp_path / "none", [], 0, 0))])
    assert [(row.key, row.value) for row in report.rows] == [("calibration.drives", 0.0)]
