"""Each robot by itself: two goals of the yard, a goal that its envelope forbids, and lanes of its own grade.

One line per drive goes to `--out` (JSON); drives that stand in it are not driven again.
"""

from __future__ import annotations

import argparse

from hal.robots import DEFAULT, describe, names
from hal.robots.check import findings
from tools.bench.lanes.bench import driven, spreads
from tools.bench.lanes.trial import Trial
from tools.bench.records import numbers
from tools.bench.report import Report

GOALS = ("yard/a", "yard/b")
"""On level ground, one in sight and one around blocks."""
LEVELS = "1-3"
WANTED_SHARE = 0.95
"""Share of the lanes that are reached with a prior map."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench robots", description=__doc__)
    parser.add_argument("--robots", default=",".join(names()), help="names or folders")
    parser.add_argument("--seeds", default="0-9", help="of lanes, such as 0-9 or 3,7,12")
    parser.add_argument("--levels", default=LEVELS, help="of lanes")
    parser.add_argument("--goals", default=",".join(GOALS), help="SCENE/GOAL,... that every robot reaches")
    spreads(parser)
    options = parser.parse_args(args)
    report = Report("robots")
    for name in options.robots.split(","):
        robot = describe(name)
        wrong = [finding.words for finding in findings(robot) if finding.verdict == "wrong"]
        report.add(f"robots.{robot.name}.wrong", len(wrong), "findings of `robot check`", 0.0)
        driver = robot.usual if name == DEFAULT else f"{name}/{robot.usual}"
        goals = [Trial(0, 0, driver, "seen", goal=goal) for goal in options.goals.split(",") if goal]
        refused = [Trial(seed, 5, driver, "prior") for seed in numbers(options.seeds)[:3]]
        lanes = [
            Trial(seed, level, driver, "prior")
            for seed in numbers(options.seeds)
            for level in numbers(options.levels)
        ]
        records = driven([*goals, *refused, *lanes], options.out, None, options.workers, options.scheduler)
        outcome = {record["key"]: record["outcome"] for record in records}
        for what, trials, wanted in (
            ("goals", goals, "reached"),
            ("forbidden", refused, "refused"),
            ("lanes", lanes, "reached"),
        ):
            count = sum(outcome[trial.key] == wanted for trial in trials)
            report.rate(
                f"robots.{robot.name}.{what}.{wanted}",
                count,
                len(trials),
                WANTED_SHARE if what == "lanes" else 1.0,
            )
        fell = sum(value == "fell" for value in outcome.values())
        report.rate(f"robots.{robot.name}.fell", fell, len(outcome), 0.0, at_least=False)
    return report
