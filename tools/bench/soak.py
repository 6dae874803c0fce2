"""Hours of simulated driving in lockstep: does anything grow, slow down, or stay open?

The robot drives between two places of a scene until the simulated time is over. Memory, CPU of each stage per simulated
second, open
descriptors and shared memory of this process are sampled once a simulated minute; the first quarter settles, the rest
is fitted by a line.
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np
import psutil

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from tools.bench.raised import Raised
from tools.bench.report import Report
from tools.bench.spent import Spent

SAMPLE_PERIOD = 60.0
"""Simulated seconds between two samples."""
COARSE = "sim.lidar_step=8"
"""A quarter of the points of the live simulation: the rays cost most of the time."""
FRESH = "sim.battery_life=1e6"
"""A battery of two hours stops the robot after 1.8 h, as it must: the rest of the soak would watch a robot that
stands."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=8.0, help="simulated")
    parser.add_argument("--wall-minutes", type=float, default=1e9, help="end after this long in any case")
    parser.add_argument("--seed", type=int, default=1, help="of the simulation")
    parser.add_argument("--scene", default="yard")
    parser.add_argument("--places", nargs=2, default=["a", "b"], help="named goals of the scene")
    parser.add_argument("--people", type=int, default=0, help="who walk past the robot; on level ground")
    options = parser.parse_args(args)
    config = load(
        None, [COARSE, FRESH, f"sim.people={options.people}"], scene=options.scene, seed=options.seed
    )
    goals = config.load_scene().goals
    places = [goals[name][:2] for name in options.places]
    report = Report("soak")
    samples: list[tuple[float, ...]] = []
    ended = {"reached": 0, "other": 0}
    process = psutil.Process()
    with Lockstep(config) as stack:
        stack.wait_ready()
        spent = Spent(stack)
        heard = Raised(stack)
        began, first = time.monotonic(), stack.seconds
        cpu, due = time.process_time(), stack.seconds + SAMPLE_PERIOD
        busy: dict[str, float] = {}
        rows: list[dict[str, float]] = []
        number = 0
        while stack.seconds - first < 3600.0 * options.hours:
            if time.monotonic() - began > 60.0 * options.wall_minutes:
                break
            state = stack.newest[t.ROBOT_STATE]
            if state.estop:  # nothing drives any more
                print(f"stopped: {state.estop_cause}", flush=True)
                break
            status = stack.newest.get(t.GOAL_STATUS)
            if status is None or GoalState(status.state).terminal or not status.id:
                if status is not None and status.id:
                    ended["reached" if status.state == "reached" else "other"] += 1
                stack.send_goal(*places[number % 2], timeout=120.0)
                stack.statuses.clear()  # the host's own memory of goals, for tests
                number += 1
            stack.run(1.0)
            if stack.seconds >= due:
                due += SAMPLE_PERIOD
                now = time.process_time()
                samples.append(
                    (
                        stack.seconds / 3600.0,
                        process.memory_info().rss / 2**20,
                        len(os.listdir("/proc/self/fd")),
                        sum(m.size for m in process.memory_maps() if m.path.startswith("/dev/shm/")) / 2**20,
                        1e3 * (now - cpu) / SAMPLE_PERIOD,
                    )
                )
                rows.append(
                    {k: 1e3 * (v - busy.get(k, 0.0)) / SAMPLE_PERIOD for k, v in spent.seconds.items()}
                )
                cpu, busy = now, dict(spent.seconds)
                print(
                    f"{60 * samples[-1][0]:.0f} min simulated, {samples[-1][1]:.0f} MB, {samples[-1][4]:.0f} "
                    f"ms CPU per s, goals {ended}",
                    flush=True,
                )
        hours, wall = (stack.seconds - first) / 3600.0, time.monotonic() - began
    report.add("hours", hours, "h simulated")
    report.add("speed", 3600.0 * hours / wall, "simulated s per s")
    report.add("goals.reached", ended["reached"], "-")
    report.add("goals.other", ended["other"], "-")
    for name in heard.monitors:
        print(f"raised: {name}", flush=True)
    report.add("monitors_raised", len(heard.monitors), "-", 0)
    table = np.array(samples)[len(samples) // 4 :]
    if len(table) < 3:
        return report
    for column, (name, unit, limit) in enumerate(
        (("memory", "MB/h", 20.0), ("descriptors", "1/h", 1.0), ("shared_memory", "MB/h", 1.0)), start=1
    ):
        report.add(f"slope.{name}", _slope(table[:, 0], table[:, column]), unit, limit)
    kept = rows[len(samples) // 4 :]
    for name in sorted(k for k in spent.seconds if "." not in k):
        values = np.array([row.get(name, 0.0) for row in kept])
        report.add(f"cpu.{name}", float(values.mean()), "ms per simulated s")
        report.add(f"slope.cpu.{name}", 100.0 * _slope(table[:, 0], values) / max(values.mean(), 1e-9), "%/h")
    return report


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    """Of the least-squares line."""
    return float(np.polyfit(x, y, 1)[0])
