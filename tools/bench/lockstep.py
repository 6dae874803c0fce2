"""The closed loop in lockstep: how fast it runs and where the time goes, and how well and how fast six goals on the
yard are reached, by the truth."""

from __future__ import annotations

import argparse
import math
import time

from hal.rotation import wrap
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.processes import PROCESSES
from rbtrg_robot.stages.navigation.goal import GoalState
from rbtrg_robot.stages.stage import warm
from rbtrg_robot.wire.convert import yaw_of
from tools.bench.report import Report
from tools.bench.spent import Spent

GOALS = "a,b,rough,platform,behind_wall,home"
LEAST_SPEED = 0.35
"""Mean speed [m/s] over the six goals."""
LEAST_RATE = 4.0
"""Simulated s per CPU s of the whole stack with both LiDARs, driving, on a quiet core."""


class Way:
    """Length of the true way [m], step by step until the newest goal ended."""

    def __init__(self, stack: Lockstep) -> None:
        self.length = 0.0
        self._stack = stack
        self._place: tuple[float, float] | None = None

    def ended(self) -> bool:
        """Whether the newest goal ended; to be asked in every step."""
        place = self._stack.newest[t.TRUTH].pose.pose.position
        before, self._place = self._place or (place.x, place.y), (place.x, place.y)
        self.length += math.dist(before, self._place)
        status = self._stack.newest.get(t.GOAL_STATUS)
        return status is not None and GoalState(status.state).terminal


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench lockstep", description=__doc__)
    parser.add_argument("--goals", default=GOALS, help="named goals of the scene")
    parser.add_argument("--scene", default="yard")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", action="append", default=[], help="set one key: a.b=c")
    options = parser.parse_args(args)
    config = load(None, options.set, scene=options.scene, seed=options.seed)
    scene = config.load_scene()
    report = Report("lockstep")
    with Lockstep(config) as stack:
        for process in PROCESSES:
            if process.hosted and process.name not in config.absent:
                warm(stack.host.stage(process.name))
        stack.wait_ready()
        spent_in = Spent(stack)
        cpu, simulated = time.process_time(), stack.seconds
        driven, driving, all_reached = 0.0, 0.0, True
        for name in options.goals.split(","):
            x, y, yaw = scene.goals[name]
            begun = stack.seconds
            stack.send_goal(x, y, yaw, timeout=150.0)
            way = Way(stack)
            stack.run_until(way.ended, 160.0, name)
            status = stack.newest[t.GOAL_STATUS]
            driven, driving = driven + way.length, driving + stack.seconds - begun
            stack.run(1.0)
            place = stack.newest[t.TRUTH].pose.pose
            reached = status.state == "reached"
            all_reached &= reached
            report.add(f"reached.{name}", float(reached), "bool", 1.0, at_least=True)
            error = math.hypot(place.position.x - x, place.position.y - y)
            report.add(f"error_m.{name}", error if reached else math.nan, "m", 0.25)
            if yaw is not None:
                turn = math.degrees(abs(wrap(yaw_of(place.orientation) - yaw)))
                report.add(f"error_deg.{name}", turn if reached else math.nan, "deg", 10.0)
            report.add(f"goal_s.{name}", stack.seconds - begun, "s")
            report.add(f"replans.{name}", status.replans, "-")
        report.add(
            "mean_speed",
            driven / driving if all_reached and driving > 0.0 else math.nan,
            "m/s",
            LEAST_SPEED if options.goals == GOALS else None,
            at_least=True,
        )
        spent, seconds = time.process_time() - cpu, stack.seconds - simulated
        report.add("speed", seconds / spent, "simulated s per CPU s", LEAST_RATE, at_least=True)
        for name, share in sorted(spent_in.seconds.items(), key=lambda item: -item[1]):
            report.add(f"cpu.{name}", 1e3 * share / seconds, "ms per simulated s")
        stages = sum(share for name, share in spent_in.seconds.items() if "." not in name)
        report.add("cpu.wire", 1e3 * (spent - stages) / seconds, "ms per simulated s")
    return report
