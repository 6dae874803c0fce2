"""Ordinary places of people that nobody tuned the robot for, driven by the whole stack in lockstep: stairs, ramps,
houses, and goals that
nothing leads to.

One line per trial goes to `--out` (JSON); trials that stand in it are not driven again.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from itertools import product
from statistics import median
from typing import Any

from hal.scenes.places import PLACES, place
from tools.bench.lanes.bench import driven, drives
from tools.bench.lanes.trial import Trial
from tools.bench.records import numbers
from tools.bench.report import Report

DETOUR_RATIO = 1.6
"""Greatest length driven over the shortest."""
REFUSAL_TIME, REFUSAL_WAY = 40.0, 15.0
"""Within which a goal that nothing leads to is refused, beside what it takes to look at once."""
LOOK_SPEED = 0.5
"""[m/s] of that."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench foreign", description=__doc__)
    parser.add_argument("--kinds", default=",".join(PLACES), help="beginnings of kinds: stairs,ramp,...")
    parser.add_argument("--seeds", default="0-2", help="such as 0-2 or 3,7,12")
    options = drives(parser, args, "seen")
    kinds = [kind for kind in PLACES if kind.startswith(tuple(options.kinds.split(",")))]
    if not kinds:
        parser.error(f"--kinds: there are {', '.join(PLACES)}")
    trials = [
        Trial(
            seed,
            5 if place(kind, seed).beyond else 0,
            controller,
            how,
            options.policy,
            log=str(options.logs or ""),
            goal=f"places:{kind},{seed}/end",
        )
        for kind, seed, how, controller in product(
            kinds, numbers(options.seeds), options.map.split(","), options.controller.split(",")
        )
    ]
    return table(driven(trials, options.out, options.pictures, options.workers, options.scheduler))


def table(records: Iterable[dict[str, Any]]) -> Report:
    """Rows `foreign.CONTROLLER.MAP.KIND.*`: rates with their trials; of goals that were reached medians of time [s] and
    of the length driven
    over the shortest; of those that nothing leads to the share refused in time."""
    report = Report("foreign")
    groups: dict[str, list[dict[str, Any]]] = {}
    for record in sorted(records, key=lambda r: r["key"]):
        kind = record["goal"].partition(":")[2].partition(",")[0]
        groups.setdefault(f"foreign.{record['controller']}.{record['map']}.{kind}", []).append(record)
    for key, here in groups.items():
        closed = here[0]["level"] == 5
        wanted = "refused" if closed else "reached"
        good = [r for r in here if r["outcome"] == wanted]
        report.rate(f"{key}.{wanted}", len(good), len(here))
        report.rate(f"{key}.fell", sum(r["outcome"] == "fell" for r in here), len(here), at_least=False)
        if closed:
            report.rate(f"{key}.entered", sum(r["tried"] for r in here), len(here), at_least=False)
            report.rate(f"{key}.in_time", sum(map(_in_time, good)), len(here))
        elif good:
            report.add(
                f"{key}.length", median(r["driven"] / r["shortest"] for r in good), "ratio", DETOUR_RATIO
            )
        if good:
            report.add(f"{key}.time", median(r["time"] for r in good), "s")
            report.add(f"{key}.driven", median(r["driven"] for r in good), "m")
    return report


def _in_time(record: dict[str, Any]) -> bool:
    look = place(record["goal"].partition(":")[2].partition(",")[0], record["seed"]).look
    return bool(record["driven"] <= REFUSAL_WAY + look and record["time"] <= REFUSAL_TIME + look / LOOK_SPEED)
