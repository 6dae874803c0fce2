"""`kill -9` of every process in turn while the robot drives, or a signal that makes it hang: when the robot stands, when the process
is back, what the goal does.

Rest is judged by the simulator's truth and clock; it is asked of the processes whose loss matters for motion.
The killed robot process is the simulator itself here, so its body is gone until it is back.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.processes import BY_NAME, PROCESSES, Process
from rbtrg_robot.stages.navigation.goal import goal_request
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import stamp_of
from tools.bench.live.stack import running
from tools.bench.report import Report

DRIVING, RESTING = 0.4, 0.05
"""Speeds [m/s] at which the kill is given, and below which the robot is at rest."""
STEADY = 1.0
"""Seconds above DRIVING before the kill: the robot cruises by then."""
AHEAD = 4.0
"""Distance [m] of the goals."""
ENDED = ("reached", "rejected", "aborted")


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    names = [row.name for row in PROCESSES]
    parser = argparse.ArgumentParser(prog="python -m tools.bench kill", description=__doc__)
    parser.add_argument("--only", nargs="*", choices=names, default=names, metavar="PROCESS")
    parser.add_argument("--rounds", type=int, default=1, help="how often each process is killed")
    parser.add_argument(
        "--hang",
        action="store_true",
        help="SIGSTOP instead of SIGKILL: it lives, holds its token and says nothing",
    )
    parser.add_argument(
        "--lockstep",
        action="store_true",
        help="all in one process: only when the robot rests after each loss",
    )
    parser.add_argument("--scene", default="flat")
    parser.add_argument("--keep", type=Path, help="keep the log in this folder")
    options = parser.parse_args(args)
    report = Report("kill")
    if options.lockstep:
        _in_lockstep([BY_NAME[name] for name in options.only], options.rounds, options.scene, report)
        return report
    with tempfile.TemporaryDirectory() as scratch:
        logs = options.keep or Path(scratch) / "logs"
        with running(report, Path(scratch), logs, "--scene", options.scene) as bus:
            watch = Watch(bus)
            for turn in range(options.rounds):
                for row in PROCESSES:
                    if row.name in options.only:
                        _kill(watch, row, f"{row.name}.{turn}", options.hang, report)
    return report


def _in_lockstep(rows: list[Process], rounds: int, scene: str, report: Report) -> None:
    """The stages that stop motion die in turn at full speed. Each is back after half a second, and the next goal lies behind the robot."""
    rested: dict[str, list[float]] = {row.name: [] for row in rows if row.stops_motion}
    lost = 0
    with Lockstep(load(None, ["sim.lidar_step=8"], scene=scene)) as stack:
        stack.wait_ready()

        def truth() -> tuple[float, float]:
            """x [m], speed [m/s]."""
            message = stack.newest[t.TRUTH]
            twist = message.twist.twist.linear
            return message.pose.pose.position.x, math.hypot(twist.x, twist.y)

        for _ in range(rounds):
            for name, found in rested.items():
                goal = stack.send_goal(-AHEAD if truth()[0] > 0.0 else AHEAD, 0.0)
                stack.run_until(lambda: truth()[1] > DRIVING, 30.0, f"motion before {name} dies")
                stack.run(STEADY)
                stack.kill(name)
                killed = stack.seconds
                while truth()[1] >= RESTING and stack.seconds - killed < 3.0:
                    stack.run(0.01)
                found.append(stack.seconds - killed)
                stack.run(0.5)
                stack.restart(name)
                stack.run(0.5)
                told = stack.newest[t.GOAL_STATUS]
                lost += told.id != goal or (told.state == "aborted" and not told.reason)
    for name, found in rested.items():
        report.add(f"kills.{name}", len(found), "-")
        report.add(f"rest_s.{name}.worst", max(found), "s", 0.3)
    report.add("goals_lost_silently", lost, "-", 0.0)


class Watch:
    """The newest of what matters."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        bus.subscribe((t.TRUTH, t.GOAL_STATUS))
        self.place = (math.nan, math.nan)
        self.speed = 0.0
        self.stamp = 0
        self.goal: Any = None

    def turn(self) -> None:
        """What came in since the last turn."""
        for received in self._bus.take(0.01):
            message = received.decode()
            if received.topic is t.TRUTH:
                place, twist = message.pose.pose.position, message.twist.twist.linear
                self.place, self.speed = (place.x, place.y), math.hypot(twist.x, twist.y)
                self.stamp = stamp_of(message)
            elif received.topic is t.GOAL_STATUS:
                self.goal = message

    def process(self, name: str) -> Any:
        """Its row of `status`."""
        rows = json.loads(self._bus.ask("status") or b"{}").get("processes", [])
        return next((row for row in rows if row["process"] == name), {})

    def drive(self, goal_id: str) -> tuple[float, float]:
        """Send a goal and return it [m] once the robot drives."""
        end = time.monotonic() + 30.0
        while math.isnan(self.place[0]):
            self.turn()
        goal = (self.place[0] + (AHEAD if self.place[0] < 0.0 else -AHEAD), self.place[1])
        resend = 0.0
        since = math.inf
        while not time.monotonic() - since > STEADY:
            since = min(since, time.monotonic()) if self.speed > DRIVING else math.inf
            if time.monotonic() > end:
                raise SystemExit(f"the robot did not set off for goal {goal_id}")
            if time.monotonic() > resend and (self.goal is None or self.goal.id != goal_id):
                resend = time.monotonic() + 1.0
                self._bus.publish(
                    t.GOAL_REQUEST, goal_request(time.time_ns(), goal_id, *goal), time.time_ns()
                )
            self.turn()
        return goal


def _kill(watch: Watch, row: Process, label: str, hang: bool, report: Report) -> None:
    name = row.name
    goal = watch.drive(f"kill-{label}")
    pid = watch.process(name)["pid"]
    watch.turn()
    os.kill(pid, signal.SIGSTOP if hang else signal.SIGKILL)
    killed, stamp = time.monotonic(), watch.stamp
    speed, rest, back = watch.speed, math.nan, math.nan
    look = killed
    while time.monotonic() - killed < 60.0:
        watch.turn()
        if math.isnan(rest) and watch.speed < RESTING:
            rest = (watch.stamp - stamp) / 1e9
        if math.isnan(back) and time.monotonic() > look:
            look = time.monotonic() + 0.1
            told = watch.process(name)
            if told.get("state") == "ready" and told["pid"] != pid:
                back = time.monotonic() - killed
        if watch.goal.state in ENDED and not math.isnan(back):
            break
    report.add(f"speed.{label}", speed, "m/s")
    if row.stops_motion:
        report.add(f"rest_s.{label}", rest, "s", 1.3 if hang else 0.3)
    # A process that hangs is ended when its heartbeat is that old.
    report.add(f"back_s.{label}", back, "s", 5.0 + (row.hang if hang else 0.0))
    reached = watch.goal.state == "reached"
    ended = reached or (watch.goal.state == "aborted" and watch.goal.reason != "")
    report.add(f"reached.{label}", float(reached), "bool")
    report.add(f"goal_ended.{label}", float(ended), "bool", 1.0, at_least=True)
    if reached:
        report.add(f"error_m.{label}", math.dist(watch.place, goal), "m", 0.25)
