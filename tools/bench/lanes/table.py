"""The rows of the lanes' table from the records of the trials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any

from tools.bench.report import Report

Record = Mapping[str, Any]
REACHED = {
    ("vmc", "prior"): (0.97, 0.85),
    ("policy", "prior"): (0.99, 0.95),
    ("hybrid", "prior"): (0.99, 0.95),
    ("vmc", "seen"): (0.92, 0.75),
    ("policy", "seen"): (0.97, 0.90),
    ("hybrid", "seen"): (0.97, 0.90),
}
"""Least share of goals reached on levels 1 to 3 and on level 4; of other robots none is asked."""
FALLS = {"vmc": 0.01, "policy": 0.005, "hybrid": 0.005}
REFUSED_SHARE = 0.95
DETOUR_RATIO, TIME_RATIO = 1.3, 1.6
"""Greatest length driven over the shortest, and greatest time over the time with a prior map."""


def table(records: Iterable[Record]) -> Report:
    """Rows `lanes.CONTROLLER.MAP.LEVEL.*`: rates with their trials, ratios as medians over the trials that reached the
    goal."""
    report = Report("lanes")
    records = sorted(records, key=lambda r: (r["controller"], r["map"], r["level"], r["seed"]))
    with_map = {
        (r["controller"], r["level"], r["seed"]): r["time"]
        for r in records
        if r["map"] == "prior" and r["outcome"] == "reached"
    }
    for controller, how in sorted({(r["controller"], r["map"]) for r in records}):
        mine = [r for r in records if (r["controller"], r["map"]) == (controller, how)]
        easy, hard = REACHED.get((controller, how), (None, None))
        key = f"lanes.{controller}.{how}"
        for level in sorted({r["level"] for r in mine}):
            here = [r for r in mine if r["level"] == level]
            if level == 5:
                refused = sum(r["outcome"] == "refused" for r in here)
                report.rate(f"{key}.5.refused", refused, len(here), REFUSED_SHARE)
                report.rate(f"{key}.5.tried", sum(r["tried"] for r in here), len(here), at_least=False)
            else:
                _reached(report, f"{key}.{level}", here, hard if level == 4 else None)
        below = [r for r in mine if r["level"] <= 3]
        if below:
            _reached(report, f"{key}.1-3", below, easy)
        drivable = [r for r in mine if r["level"] <= 4]
        alarms = sum(bool(r["raised"]) for r in drivable)
        report.rate(f"{key}.1-4.false_alarms", alarms, len(drivable), 0.0, at_least=False)
        fell = sum(r["outcome"] == "fell" for r in mine)
        report.rate(f"{key}.all.falls", fell, len(mine), FALLS.get(controller), at_least=False)
        told = [r for r in drivable if how == "prior" and r.get("p_fail") is not None]
        if told:  # with a map the first plan tells of the whole way
            failed = sum(r["outcome"] != "reached" for r in told)
            report.add(f"{key}.1-4.told_to_fail", sum(r["p_fail"] for r in told) / len(told), "rate")
            report.rate(f"{key}.1-4.failed", failed, len(told), None, at_least=False)
        got = [r for r in mine if r["outcome"] == "reached"]
        if got:
            report.add(
                f"{key}.all.length", median(r["driven"] / r["shortest"] for r in got), "ratio", DETOUR_RATIO
            )
        both = [r for r in got if (controller, r["level"], r["seed"]) in with_map]
        if how == "seen" and both:
            slower = (r["time"] / with_map[controller, r["level"], r["seed"]] for r in both)
            report.add(f"{key}.all.time", median(slower), "ratio", TIME_RATIO)
        report.add(f"{key}.all.wall_body", sum(r["wall_body"] for r in mine), "touches", 0.0)
        report.add(f"{key}.all.wall_wheels", sum(r["wall_wheels"] for r in mine), "touches")
        speed = sum(r["simulated"] for r in mine) / max(sum(r["cpu"] for r in mine), 1e-9)
        report.add(f"{key}.all.speed", speed, "simulated s per CPU s")
    return report


def _reached(report: Report, key: str, records: list[Record], limit: float | None) -> None:
    report.rate(f"{key}.reached", sum(r["outcome"] == "reached" for r in records), len(records), limit)
