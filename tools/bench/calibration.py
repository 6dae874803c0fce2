"""How well the chance of a plan tells what happens: predicted and observed failures of drives with a map.

    python -m tools.bench lanes --map prior --out drives.jsonl ...
    python -m tools.bench calibration drives.jsonl [MORE ...] [--picture FILE.png] [--record FILE]

With a map the first plan tells of the whole way. A drive failed if it was not `reached`. Drives that the plan refused
itself (level 5 of the lanes, goals beyond `planner.accept_risk`) are left out: nothing was driven.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.bench.report import Report

Array = NDArray[np.float64]

BIN_COUNT = 10
LEAST_DRIVES = 30
"""A decile with fewer drives is told, not judged."""
MEAN_OFF, DECILE_OFF = 0.03, 0.10
"""Predicted and observed rate differ by no more, over all drives and in a decile."""
NORMAL_QUANTILE = 1.2816
"""Quantile of the normal distribution of a two-sided interval at 80 %."""


def run(args: list[str]) -> Report:
    """Rows `calibration.*` of the drives in files of records."""
    parser = argparse.ArgumentParser(prog="calibration", description=__doc__)
    parser.add_argument("files", type=Path, nargs="+", help="records of lanes or goals (--out)")
    parser.add_argument("--picture", type=Path, help="PNG of the reliability diagram")
    options = parser.parse_args(args)
    records = [json.loads(line) for file in options.files for line in file.read_text().splitlines() if line]
    told, failed = drives(records)
    if options.picture is not None and len(told):
        draw(told, failed, options.picture)
    return table(told, failed)


def drives(records: Iterable[Mapping[str, Any]]) -> tuple[Array, Array]:
    """(n,) probability that a drive fails as its first plan told, and whether it did; once for each key, the last."""
    newest = {record["key"]: record for record in records}
    some = [
        record
        for record in newest.values()
        if record["map"] == "prior" and record.get("p_fail") is not None and record["driven"] > 0.0
    ]
    told = np.array([float(record["p_fail"]) for record in some])
    return told, np.array([float(record["outcome"] != "reached") for record in some])


def deciles(told: Array, failed: Array) -> list[tuple[int, float, float]]:
    """Number of drives, mean prediction and observed rate of each tenth of the predictions from 0 to 1 that has any."""
    tenth = np.minimum((told * BIN_COUNT).astype(int), BIN_COUNT - 1)
    return [
        (int(here.sum()), float(told[here].mean()), float(failed[here].mean()))
        for here in (tenth == k for k in range(BIN_COUNT))
        if here.any()
    ]


def table(told: Array, failed: Array) -> Report:
    """Means, their difference with its interval at 80 %, the Brier score beside that of the bare rate, and deciles."""
    report = Report("calibration")
    n = len(told)
    report.add("calibration.drives", float(n), "drives")
    if not n:
        return report
    off = told - failed
    half = NORMAL_QUANTILE * float(off.std(ddof=1)) / math.sqrt(n) if n > 1 else 1.0
    rate = float(failed.mean())
    report.add("calibration.told", float(told.mean()), "rate")
    report.add("calibration.failed", rate, "rate")
    report.add("calibration.difference", abs(float(off.mean())), "rate", MEAN_OFF)
    report.add("calibration.difference_interval", half, "rate")
    report.add("calibration.brier", float((off**2).mean()), "")
    report.add("calibration.brier_of_rate", rate * (1.0 - rate), "")
    for count, mean, observed in deciles(told, failed):
        key = f"calibration.decile.{min(int(mean * BIN_COUNT), BIN_COUNT - 1)}"
        report.add(f"{key}.drives", float(count), "drives")
        report.add(
            f"{key}.difference", abs(mean - observed), "rate", DECILE_OFF if count >= LEAST_DRIVES else None
        )
    return report


def draw(told: Array, failed: Array, file: Path) -> None:
    """The reliability diagram: observed rate over the prediction, a disc as large as its number of drives."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.0, 4.6), layout="constrained")
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.7", lw=1.0)
    for count, mean, observed in deciles(told, failed):
        spread = NORMAL_QUANTILE * math.sqrt(max(observed * (1.0 - observed), 0.25 / count) / count)
        axes.errorbar(mean, observed, spread, color="C0", capsize=3.0)
        axes.scatter(mean, observed, s=20.0 + 2.0 * count, color="C0")
        axes.annotate(str(count), (mean, observed), xytext=(8, 6), textcoords="offset points")
    axes.set(xlabel="told to fail", ylabel="failed", xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    axes.set_title(f"{len(told)} drives with a map; bars: 80 %")
    figure.savefig(file, dpi=110)
    plt.close(figure)
