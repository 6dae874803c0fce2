"""To and fro on a line, as in the ICRA Legged Robot Challenge: traverses in 5 minutes, at most 10, falls,
interventions.

`--endurance` goes on for 30 repetitions, the number after ASTM E54's tests (E3380 on continuous ramps is of that kind).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

from hal.mujoco.driver import Driver
from tools.bench.closed_loop import protocol as p
from tools.bench.closed_loop.routes import Route
from tools.bench.closed_loop.trial import controller_of, follow, place, simulation, tracker_of
from tools.bench.report import Report

CHALLENGE_MINUTES, MOST_TRAVERSES = 5.0, 10
"""Time and traverses of the challenge."""
ENDURANCE_REPETITIONS = 30
"""Of the endurance test, lost ones counted."""
SLOWEST_SPEED = 0.1
"""Where a line slows down for its end, the way back begins [m/s]."""
FALLS = ("fall", "off an edge")


def back(route: Route) -> Route:
    """The same line from its end to its start."""
    least = route.least[::-1]
    speed = [max(v, SLOWEST_SPEED) for v in route.speed[::-1]]
    return replace(
        route, line=route.line[::-1], speed=[*speed[:-1], 0.0] if speed else [], least=least, yaw=[]
    )


def drive(trial: p.Trial, route: Route, policy: str = "", endurance: bool = False) -> dict[str, Any]:
    """The record: traverses, falls, interventions, time [s]. After a lost traverse the robot is put where that traverse
    began; the clock
    runs on. A line on whose start the robot cannot stand ends the run.
    """
    given = p.conditions(trial)
    record: dict[str, Any] = {"key": trial.key, **asdict(trial), **given, "why": route.error}
    record |= {
        "traverses": 0,
        "falls": 0,
        "interventions": 0,
        "time": 0.0,
        "limit": ENDURANCE_REPETITIONS if endurance else MOST_TRAVERSES,
    }
    if route.error:
        return record
    sim = simulation(trial.scene, trial.colliders)
    sim.set_friction(given["friction"])
    driver = Driver(sim, controller_of(trial.controller, policy))
    legs = (route, back(route))
    standing, clock, causes = False, 0.0, []
    while record["traverses"] + record["interventions"] < record["limit"]:
        leg = legs[record["traverses"] % 2]
        before = sim.time if standing else 0.0
        if not standing:
            stood = place(driver, leg, trial.scene, given)
            if not stood["eligible"]:
                record["why"] = ", ".join(stood["why"])
                break
        result = follow(driver, tracker_of(trial), leg)
        clock += sim.time - before
        if not endurance and clock > 60.0 * CHALLENGE_MINUTES:
            break
        record["time"] = clock
        standing = result["success"]
        record["traverses"] += result["success"]
        record["interventions"] += not result["success"]
        record["falls"] += result["cause"] in FALLS
        if not result["success"]:
            causes.append(result["cause"])
    return record | {"causes": causes}


def report(records: Sequence[dict[str, Any]]) -> Report:
    """Rows per method and scene: traverses, falls, interventions, the rate of traverses that were not lost."""
    out = Report("closed_loop")
    for method in p.methods_in(records):
        for scene in (*p.SCENES, "all"):
            mine = [r for r in records if r["method"] == method and scene in (r["scene"], "all")]
            if not mine:
                continue
            key = f"lrc.{method}.{scene}"
            traverses, lost = (sum(r[name] for r in mine) for name in ("traverses", "interventions"))
            out.add(f"{key}.traverses", traverses / len(mine), "of " + str(mine[0]["limit"]))
            out.add(f"{key}.falls", sum(r["falls"] for r in mine), "-")
            out.add(f"{key}.interventions", lost, "-")
            out.add(f"{key}.not_begun", sum(r["traverses"] + r["interventions"] == 0 for r in mine), "runs")
            out.rate(f"{key}.rate", traverses, traverses + lost)
    return out
