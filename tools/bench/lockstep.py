"""The closed loop in lockstep: how fast it runs and where the time goes, and how well five goals on the yard are reached, by the truth."""

from __future__ import annotations

import argparse
import math
import time

from hal.rotation import wrap
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.wire.convert import yaw_of
from tools.bench.report import Report
from tools.bench.spent import Spent


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench lockstep", description=__doc__)
    parser.add_argument("--goals", default="a,b,rough,platform,behind_wall", help="named goals of the scene")
    parser.add_argument("--scene", default="yard")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", action="append", default=[], help="set one key: a.b=c")
    options = parser.parse_args(args)
    config = load(None, options.set, scene=options.scene, seed=options.seed)
    scene = config.load_scene()
    report = Report("lockstep")
    with Lockstep(config) as stack:
        stack.wait_ready()
        spent_in = Spent(stack)
        cpu, simulated = time.process_time(), stack.seconds
        for name in options.goals.split(","):
            x, y, yaw = scene.goals[name]
            begun = stack.seconds
            stack.send_goal(x, y, yaw, timeout=150.0)
            status = stack.finish_goal(160.0)
            stack.run(1.0)
            place = stack.newest[t.TRUTH].pose.pose
            reached = status.state == "reached"
            report.add(f"reached.{name}", float(reached), "bool", 1.0, at_least=True)
            error = math.hypot(place.position.x - x, place.position.y - y)
            report.add(f"error_m.{name}", error if reached else math.nan, "m", 0.25)
            if yaw is not None:
                turn = math.degrees(abs(wrap(yaw_of(place.orientation) - yaw)))
                report.add(f"error_deg.{name}", turn if reached else math.nan, "deg", 10.0)
            report.add(f"goal_s.{name}", stack.seconds - begun, "s")
            report.add(f"replans.{name}", status.replans, "-")
        spent, seconds = time.process_time() - cpu, stack.seconds - simulated
        report.add("speed", seconds / spent, "simulated s per CPU s")
        for name, share in sorted(spent_in.seconds.items(), key=lambda item: -item[1]):
            report.add(f"cpu.{name}", 1e3 * share / seconds, "ms per simulated s")
        stages = sum(share for name, share in spent_in.seconds.items() if "." not in name)
        report.add("cpu.wire", 1e3 * (spent - stages) / seconds, "ms per simulated s")
    return report
