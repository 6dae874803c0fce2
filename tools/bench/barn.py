"""Worlds of the BARN challenge, driven without a map by the whole stack: reached, touched, and the challenge's metric.

The metric of a world is 0 unless the goal is reached without a touch within 100 s, else OT / clip(AT, 2 OT, 8 OT): OT
is the shortest way at 2 m/s, AT the time that it took. It is 0.5 at most. Worlds come from the published rules, or from
a folder of the challenge's own files. One line per world goes to `--out` (JSON); what stands in it is not driven again.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

from hal.robots import DEFAULT, describe
from hal.scenes import load_scene
from hal.scenes.barn import GOAL_POSE, START_POSE, grid_of, shortest_way
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from tools.bench.lanes.bench import spreads
from tools.bench.records import Records, numbers
from tools.bench.report import Report
from tools.bench.spread import spread

CHALLENGE_SPEED = 2.0
"""[m/s] of the robot of the challenge."""
LONGEST_DRIVE = 100.0
"""[s] for a world."""
GOAL_RADIUS = 1.0
"""[m] from the goal that counts as reached there."""
TOUCH_FORCE = 5.0
"""Normal force [N] on the body or on the side of a wheel, higher than anything lies on the ground, that is a touch."""
WANTED_SHARE = 0.95


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench barn", description=__doc__)
    parser.add_argument("--seeds", default="0-23", help="worlds by the rules, such as 0-23 or 3,7,12")
    parser.add_argument("--worlds", type=Path, help="folder of world_N.world files instead")
    parser.add_argument("--robots", default=f"{DEFAULT},jackal", help="names or folders")
    spreads(parser)
    options = parser.parse_args(args)
    if options.worlds:
        names = [str(file.resolve()) for file in sorted(options.worlds.glob("*.world"))]
    else:
        names = [f"barn:{seed}" for seed in numbers(options.seeds)]
    if not names:
        parser.error(f"--worlds: {options.worlds} holds no .world file")
    report, records = Report("barn"), Records(options.out)
    for robot in options.robots.split(","):
        left = [(robot, name) for name in names if _key(robot, name) not in records.done]
        for record in spread(drive, left, options.workers, options.scheduler):
            records.add(record)
            told = f"{record['detail'] or record['reached']} {record['time']:.1f} s, metric {record['metric']:.2f}"
            print(f"{record['key']} {told}", file=sys.stderr, flush=True)
        drives = [records.done[_key(robot, name)] for name in names]
        key = f"barn.{describe(robot).name}"
        reached = [d for d in drives if d["reached"]]
        report.rate(f"{key}.reached", len(reached), len(drives), WANTED_SHARE)
        report.rate(f"{key}.touched", sum(d["touched"] for d in drives), len(drives), 0.0, at_least=False)
        report.add(f"{key}.metric", float(np.mean([d["metric"] for d in drives])), "of 0.5 at most")
        if reached:
            report.add(
                f"{key}.way", float(np.median([d["way"] / d["shortest"] for d in reached])), "of the shortest"
            )
    return report


def _key(robot: str, name: str) -> str:
    return f"{describe(robot).name}.{Path(name).stem}"


def drive(robot: str, name: str) -> dict[str, Any]:
    """One world; what the truth says of it."""
    config = load(
        None,
        ["record=false", "sim.lidar_step=4"],
        robot_model=robot,
        scene=name,
        without=("recorder", "console", "camera"),
    )
    least = shortest_way(grid_of(load_scene(name)))
    if not math.isfinite(least):
        least = math.dist(START_POSE[:2], GOAL_POSE[:2])
    touched, way = False, 0.0
    with Lockstep(config) as stack:
        stack.wait_ready()
        sim = stack.robot.backend.simulation  # type: ignore[attr-defined]
        began, last = stack.seconds, sim.position
        stack.send_goal(*GOAL_POSE, timeout=LONGEST_DRIVE, accept_risk=True)
        while stack.seconds - began < LONGEST_DRIVE:
            stack.run(0.05)
            contacts = sim.contacts()
            high = (
                contacts.places[:, 2] > sim.robot.limbs.radius + 0.05
                if len(contacts.bodies)
                else np.zeros(0, bool)
            )
            touched |= bool((contacts.forces[high] > TOUCH_FORCE).any())
            way += float(np.linalg.norm((sim.position - last)[:2]))
            last = sim.position
            status = stack.newest.get(t.GOAL_STATUS)
            if status is not None and GoalState(status.state).terminal:
                break
        took = stack.seconds - began
    away = math.dist(last[:2], GOAL_POSE[:2])
    reached = status is not None and status.state == "reached" and away < GOAL_RADIUS
    best = least / CHALLENGE_SPEED
    metric = best / min(max(took, 2.0 * best), 8.0 * best) if reached and not touched else 0.0
    return {
        "key": _key(robot, name),
        "robot": robot,
        "world": name,
        "reached": reached,
        "detail": "" if status is None else f"{status.reason} {status.detail}",
        "touched": touched,
        "time": took,
        "way": way,
        "shortest": least,
        "metric": metric,
    }
