"""Named goals of scenes, driven by the whole stack in lockstep: reached, refused, falls. Seeds are those of the
simulation.

One line per trial goes to `--out` (JSON); trials that stand in it are not driven again.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from itertools import product
from statistics import median
from typing import Any

from hal.scenes import load_scene
from tools.bench.lanes.bench import driven, drives
from tools.bench.lanes.trial import Trial
from tools.bench.records import numbers
from tools.bench.report import Report

RESCUE = (
    *("rescue_slopes/ramps_end", "rescue_slopes/crossing_end"),
    *("rescue_platform/platform", "rescue_platform/curbs", "rescue_platform/far"),
    *("rescue_steps/detour", "rescue_steps/far"),
    *("rescue_elevated/bridge", "rescue_elevated/far"),
)


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench goals", description=__doc__)
    parser.add_argument(
        "--goals", default=",".join(RESCUE), help="SCENE/GOAL,...; default: the rescue scenes"
    )
    parser.add_argument("--seeds", default="0-9", help="such as 0-9 or 3,7,12")
    options = drives(parser, args, "seen")
    goals = options.goals.split(",")
    for goal in goals:
        scene, _, name = goal.partition("/")
        known = load_scene(scene).goals
        if name not in known:
            parser.error(f"--goals: {goal}: the goals of {scene} are {', '.join(known)}")
    trials = [
        Trial(seed, 0, controller, how, options.policy, log=str(options.logs or ""), goal=goal)
        for seed, how, controller, goal in product(
            numbers(options.seeds),
            options.map.split(","),
            options.controller.split(","),
            goals,
        )
    ]
    return table(driven(trials, options.out, options.pictures, options.workers, options.scheduler))


def table(records: Iterable[dict[str, Any]]) -> Report:
    """Rows `goals.CONTROLLER.MAP.SCENE.GOAL.*`: rates with their trials; time [s] as median over those that reached the
    goal."""
    report = Report("goals")
    groups: dict[str, list[dict[str, Any]]] = {}
    for record in sorted(records, key=lambda r: r["key"]):
        groups.setdefault("goals." + record["key"].rpartition(".")[0], []).append(record)
    for key, here in groups.items():
        for outcome in ("reached", "refused", "fell"):
            count = sum(r["outcome"] == outcome for r in here)
            report.rate(f"{key}.{outcome}", count, len(here), at_least=outcome != "fell")
        times = [r["time"] for r in here if r["outcome"] == "reached"]
        if times:
            report.add(f"{key}.time", median(times), "s")
    return report
