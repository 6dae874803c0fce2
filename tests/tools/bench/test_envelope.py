"""The bench that measures an envelope: what a trial is, and that a file can be gone on with."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hal.envelope import FAILURES, SPORT, Axis, Table, read, stored
from hal.robots import describe
from hal.robots.go2w.locomotion.vmc import VmcController, warm_up
from tools.bench.envelope import run
from tools.bench.envelope.campaign import GRID, Tally, log_losses, measure
from tools.bench.envelope.manoeuvres import MANOEUVRES, attempt


@pytest.fixture(scope="module")
def vmc() -> VmcController:
    warm_up()
    return VmcController()


def end_of(vmc: VmcController, manoeuvre: str, *values: float, seed: int = 0):
    return attempt(vmc, MANOEUVRES[manoeuvre](values, np.random.default_rng(seed)))


@pytest.mark.parametrize(
    ("manoeuvre", "values", "units", "fails"),
    [
        ("up", (0.05, 0.0, 0.0), 1, False),
        ("back_down", (0.05, 0.3, 0.0), 1, False),
        ("up", (0.35, 0.0, 0.0), 1, True),
        ("gap", (0.30,), 1, True),
        ("spin", (0.0, 0.0, 1.0), 3, False),
        ("bend", (0.0, 0.0, 0.0), 2, False),
        ("slope", (math.radians(10), math.radians(90)), 2, False),
    ],
)
def test_what_is_easy_ends_well_and_what_is_hopeless_fails(
    vmc, manoeuvre: str, values: tuple[float, ...], units: int, fails: bool
) -> None:
    end = end_of(vmc, manoeuvre, *values)
    assert (end.units, end.failure in FAILURES) == (units, fails)
    assert fails or end.failure == ""


def test_a_bench_that_goes_on_with_a_file_counts_what_one_run_does(vmc, tmp_path: Path) -> None:
    measure(vmc, "vmc", tmp_path / "whole.json", describe(), drives=2, only="gap")
    measure(vmc, "vmc", tmp_path / "parts.json", describe(), drives=1, only="gap")
    measure(vmc, "vmc", tmp_path / "parts.json", describe(), drives=1, only="gap")
    whole, parts = (read(tmp_path / f"{name}.json").manoeuvres["gap"] for name in ("whole", "parts"))
    assert whole.drives == whole.trials.sum() == 2
    assert whole == parts


def test_the_command_writes_a_file_with_every_manoeuvre(tmp_path: Path) -> None:
    """A run of a few seconds, for who finds the bench broken."""
    path = tmp_path / "vmc.json"
    report = run(
        [
            "--controller",
            "vmc",
            "--write",
            "--drives",
            str(len(GRID)),
            "--file",
            str(path),
            "--picture",
            str(tmp_path / "vmc.png"),
        ]
    )
    assert (tmp_path / "vmc.png").stat().st_size > 5_000
    envelope = read(path)
    assert set(envelope.manoeuvres) == set(GRID)
    assert all(table.drives == 1 and table.trials.sum() >= 1 for table in envelope.manoeuvres.values())
    assert envelope.drawn["friction"] == ("-", 0.5, 1.0)
    keys = {row.key for row in report.rows}
    assert keys >= {f"drives.vmc.{m}" for m in GRID} | {"max_step.vmc", "max_gap.vmc"}


def test_the_vendors_service_is_assumed_from_what_was_measured(tmp_path: Path) -> None:
    run(["--controller", "sport", "--write", "--file", str(tmp_path / "sport.json")])
    assert read(tmp_path / "sport.json").manoeuvres == stored(SPORT).manoeuvres, (
        "made from the files as they are"
    )


def test_trials_gather_where_failure_is_in_doubt() -> None:
    tally = Tally("gap")
    for cell, (passes, falls) in enumerate([(40, 0), (40, 0), (40, 0), (6, 2), (0, 40), (0, 40)]):
        for k in range(passes + falls):
            tally.add((cell,), 1, "fell" if k < falls else "")
    rng = np.random.default_rng(0)
    cells = [tally.next_cell(rng)[0] for _ in range(200)]
    assert cells.count(2) > 80, "the last width that may be one in thirty"
    assert cells.count(0) < 20
    assert sum(c >= 4 for c in cells) < 40


def test_the_file_tells_how_well_trials_left_out_were_predicted() -> None:
    rng = np.random.default_rng(0)
    tally = Tally("gap")
    for cell, width in enumerate(GRID["gap"][1][0].values):
        for _ in range(30):
            tally.add((cell,), 1, FAILURES[0] if rng.random() < 1 / (1 + np.exp(40 * (0.15 - width))) else "")
    loss, blind = log_losses(tally)
    assert loss is not None
    assert blind is not None
    assert loss < 0.7 * blind
    assert log_losses(Tally("gap")) == (None, None)


def test_a_table_is_gone_on_with_as_it_was_left() -> None:
    tally = Tally("gap")
    tally.add((2,), 1, "slid")
    tally.add((2,), 1, False)
    again = Tally.of("gap", tally.table())
    assert np.array_equal(again.counts, tally.counts)
    assert again.drives == 2
    assert isinstance(tally.table(), Table)
    assert isinstance(tally.table().axes[0], Axis)
