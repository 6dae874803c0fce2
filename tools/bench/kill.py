"""`kill -9` of every process in turn while the robot drives, or a signal that makes it hang: when the robot stands,
when the process
is back, what the goal does, and how much the log lacks.

Rest is judged by the simulator's truth and clock; it is asked of the processes whose loss matters for motion.
The killed robot process is the simulator itself here, so its body is gone until it is back. `supervisor` and `zygote`
are no rows of the
table: without the supervisor everything ends, robot process first, and the bench tells when; the zygote starts the
others and nobody misses it
until one has to be started.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.log.stats import summarize
from rbtrg_robot.processes import BY_NAME, PROCESSES, Process
from rbtrg_robot.stages.navigation.goal import goal_request
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.messages import stamp_of
from tools.bench.live.stack import running
from tools.bench.report import Report

DRIVING_SPEED, RESTING_SPEED = 0.4, 0.05
"""Speeds [m/s] at which the kill is given, and below which the robot is at rest."""
BRAKING_DROP = 0.1
"""[m/s] slower than at the kill: somebody has noticed it. The rest of the time is the body's."""
STEADY_TIME = 1.0
"""Seconds above DRIVING_SPEED before the kill: the robot cruises by then."""
GOAL_DISTANCE = 4.0
"""Distance [m] of the goals."""
ENDED = ("reached", "rejected", "aborted")
ZYGOTE, SUPERVISOR, RECORDER = "zygote", "supervisor", "recorder"
HANG_TIMES = (5.0, 15.0)
"""[s] for which the supervisor hangs: both longer than the lease of a Zenoh session (2 s); the second is longer than
most limits of the supervisor."""
LONGEST_WAIT = 10.0
"""Longest wait [s] for the end of what must not outlive the supervisor."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    names = [*(row.name for row in PROCESSES if row.name not in load().absent), ZYGOTE, SUPERVISOR]
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
    parser.add_argument("--seed", type=int, default=0, help="of the simulation")
    parser.add_argument("--scene", default="flat")
    parser.add_argument("--map", help="prior map of the stack")
    parser.add_argument("--keep", type=Path, help="keep the log in this folder")
    options = parser.parse_args(args)
    report = Report("kill")
    if options.lockstep:
        rows = [BY_NAME[name] for name in options.only if name in BY_NAME]
        _in_lockstep(rows, options.rounds, options.scene, options.seed, report)
        return report
    with tempfile.TemporaryDirectory() as scratch:
        logs = options.keep or Path(scratch) / "logs"
        prior = ("--map", options.map) if options.map else ()
        settings = ("--scene", options.scene, "--seed", str(options.seed), *prior)
        try:
            _live(options, settings, logs, Path(scratch), report)
        except NotDriving as error:
            print(error, flush=True)
            report.add("not_driving", 1.0, "-", 0.0)
    return report


def _live(
    options: argparse.Namespace, settings: tuple[str, ...], logs: Path, scratch: Path, report: Report
) -> None:
    if set(options.only) - {SUPERVISOR}:
        with running(report, scratch, logs, *settings) as bus:
            watch = Watch(bus)
            for turn in range(options.rounds):
                for row in PROCESSES:
                    if row.name in options.only:
                        _kill(watch, row, f"{row.name}.{turn}", options.hang, report)
                if ZYGOTE in options.only:
                    _kill_zygote(watch, f"{ZYGOTE}.{turn}", options.hang, report)
        if RECORDER in options.only:  # one that dies twice within 30 s waits longer before it is started anew
            run = max(logs.iterdir())  # its name begins with the date
            gap = summarize(run).topics[t.IMU.name].longest_gap
            report.add("log_gap_s.worst", gap, "s", 1.0 + (BY_NAME[RECORDER].hang if options.hang else 0.0))
    for turn in range(options.rounds if SUPERVISOR in options.only else 0):
        with running(report, scratch, logs, *settings, ended=not options.hang) as bus:
            if options.hang:
                for held in HANG_TIMES:
                    _hang_supervisor(Watch(bus), f"{SUPERVISOR}.{turn}.{held:.0f}s", held, report)
            else:
                _kill_supervisor(Watch(bus), f"{SUPERVISOR}.{turn}", report)


def _in_lockstep(rows: list[Process], rounds: int, scene: str, seed: int, report: Report) -> None:
    """The stages that stop motion die in turn at full speed. Each is back after half a second, and the next goal lies
    behind the robot."""
    rested: dict[str, list[float]] = {row.name: [] for row in rows if row.stops_motion}
    lost = 0
    with Lockstep(load(None, ["sim.lidar_step=8"], scene=scene, seed=seed)) as stack:
        stack.wait_ready()

        def truth() -> tuple[float, float]:
            """x [m], speed [m/s]."""
            message = stack.newest[t.TRUTH]
            twist = message.twist.twist.linear
            return message.pose.pose.position.x, math.hypot(twist.x, twist.y)

        for number in range(rounds):
            for name, found in rested.items():
                goal = stack.send_goal(-GOAL_DISTANCE if truth()[0] > 0.0 else GOAL_DISTANCE, 0.0)
                stack.run_until(lambda: truth()[1] > DRIVING_SPEED, 30.0, f"motion before {name} dies")
                stack.run(STEADY_TIME)
                stack.kill(name)
                killed = stack.seconds
                while truth()[1] >= RESTING_SPEED and stack.seconds - killed < 3.0:
                    stack.run(0.01)
                found.append(stack.seconds - killed)
                stack.run(0.5)
                stack.restart(name)
                stack.run(0.5)
                told = stack.newest[t.GOAL_STATUS]
                lost += told.id != goal or (told.state == "aborted" and not told.reason)
            worst = {name: round(max(found), 3) for name, found in rested.items()}
            print(
                f"round {number + 1} of {rounds}, at rest after [s], worst so far: {worst}; {lost} goals lost",
                flush=True,
            )
    for name, found in rested.items():
        report.add(f"kills.{name}", len(found), "-")
        report.add(f"rest_s.{name}.worst", max(found), "s", 0.3)
    report.add("goals_lost_silently", lost, "-", 0.0)


class NotDriving(Exception):
    """The bench cannot go on; what it has measured so far counts."""


class Watch:
    """The newest of what matters."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        bus.subscribe((t.TRUTH, t.GOAL_STATUS, t.MAP_STATUS))
        self.place = (math.nan, math.nan)
        self.speed = 0.0
        self.stamp = 0
        self.goal: Any = None
        self.map: Any = None

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
            elif received.topic is t.MAP_STATUS:
                self.map = message

    def ask(self) -> bytes:
        """`status`."""
        return self._bus.ask("status") or b"{}"

    def process(self, name: str) -> Any:
        """Its row of `status`."""
        rows = json.loads(self.ask()).get("processes", [])
        return next((row for row in rows if row["process"] == name), {})

    def drive(self, goal_id: str) -> tuple[float, float]:
        """Send a goal and return it [m] once the robot drives."""
        end = time.monotonic() + 30.0
        while math.isnan(self.place[0]):
            self.turn()
        goal = (self.place[0] + (GOAL_DISTANCE if self.place[0] < 0.0 else -GOAL_DISTANCE), self.place[1])
        resend = 0.0
        since = math.inf
        while not time.monotonic() - since > STEADY_TIME:
            since = min(since, time.monotonic()) if self.speed > DRIVING_SPEED else math.inf
            if time.monotonic() > end:
                raise NotDriving(f"the robot did not set off for goal {goal_id}")
            if time.monotonic() > resend and (self.goal is None or self.goal.id != goal_id):
                resend = time.monotonic() + 1.0
                self._bus.publish(
                    t.GOAL_REQUEST, goal_request(time.time_ns(), goal_id, *goal), time.time_ns()
                )
            self.turn()
        return goal


def _pids(watch: Watch) -> tuple[int, dict[str, int], list[int]]:
    """The supervisor, the processes by name, the zygote (the supervisor's other child). Waits until none is being
    started."""
    end = time.monotonic() + 10.0
    while True:
        status = json.loads(watch.ask())
        if all(row["pid"] for row in status["processes"]):
            break
        if time.monotonic() > end:
            raise NotDriving(f"a process is missing: {status['processes']}")
        watch.turn()
    known = {row["process"]: int(row["pid"]) for row in status["processes"]}
    children = [child.pid for child in psutil.Process(status["pid"]).children()]
    return int(status["pid"]), known, [pid for pid in children if pid not in known.values()]


def _kill_zygote(watch: Watch, label: str, hang: bool, report: Report) -> None:
    """The robot drives on, and a process that is killed after it comes back all the same."""
    goal = watch.drive(f"kill-{label}")
    _, _, (zygote,) = _pids(watch)
    os.kill(zygote, signal.SIGSTOP if hang else signal.SIGKILL)
    end = time.monotonic() + 60.0
    while watch.goal.state not in ENDED and time.monotonic() < end:
        watch.turn()
    report.add(f"reached.{label}", float(watch.goal.state == "reached"), "bool", 1.0, at_least=True)
    report.add(f"error_m.{label}", math.dist(watch.place, goal), "m", 0.25)
    _kill(watch, BY_NAME["tracker"], f"tracker_after_{label}", hang=False, report=report)


def _kill_supervisor(watch: Watch, label: str, report: Report) -> None:
    """It hosts the router: who watches the bus sees nothing any more. The processes are watched themselves."""
    watch.drive(f"kill-{label}")
    supervisor, known, others = _pids(watch)
    left = {name: psutil.Process(pid) for name, pid in known.items()}
    left |= {f"{ZYGOTE}{pid}": psutil.Process(pid) for pid in others}
    os.kill(supervisor, signal.SIGKILL)
    killed = time.monotonic()
    gone: dict[str, float] = {}
    while len(gone) < len(left) and time.monotonic() - killed < LONGEST_WAIT:
        for name, process in left.items():
            if name not in gone and not _lives(process):
                gone[name] = time.monotonic() - killed
        time.sleep(0.005)
    # The robot process stops the robot as its first act after the signal and its end is later than that.
    report.add(f"robot_ended_s.{label}", gone.get("robot", math.nan), "s", BY_NAME["robot"].farewell)
    report.add(f"all_ended_s.{label}", max(gone.values(), default=math.nan), "s", BY_NAME["robot"].farewell)
    report.add(f"outlived.{label}", len(left) - len(gone), "-", 0.0)


def _hang_supervisor(watch: Watch, label: str, held: float, report: Report) -> None:
    """Its router carries nothing meanwhile: the robot must stand. Nothing may be ended for the silence once it goes
    on."""
    goal = watch.drive(f"hang-{label}")
    supervisor, known, _ = _pids(watch)
    os.kill(supervisor, signal.SIGSTOP)
    place, stamp = watch.place, watch.stamp
    time.sleep(held)
    os.kill(supervisor, signal.SIGCONT)
    began = time.monotonic()
    driven, standing = 0.0, math.nan
    while math.isnan(standing) and time.monotonic() - began < LONGEST_WAIT:
        watch.turn()
        driven = max(driven, math.dist(watch.place, place))
        if (watch.stamp - stamp) / 1e9 > 0.8 * held:  # what was still on its way has come
            standing = watch.speed
    report.add(f"driven_m.{label}", driven, "m", 0.3)
    report.add(f"speed_after.{label}", standing, "m/s")
    while watch.goal.state not in ENDED and time.monotonic() - began < 60.0:
        watch.turn()
    _, after, _ = _pids(watch)
    restarted = [name for name, pid in known.items() if after[name] != pid]
    print(
        f"{label}: driven {driven:.2f} m, {watch.goal.state} after {time.monotonic() - began:.1f} s, "
        f"restarted: {restarted}",
        flush=True,
    )
    report.add(f"restarted.{label}", len(restarted), "-", 0.0)
    report.add(f"reached.{label}", float(watch.goal.state == "reached"), "bool", 1.0, at_least=True)
    report.add(f"error_m.{label}", math.dist(watch.place, goal), "m", 0.25)


def _lives(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.NoSuchProcess):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False


def _has_all(status: Any, kept: Any) -> bool:
    """The map of a restarted elevation process, whose scans count from 0, is what the one before had told; half a
    percent may be seen
    anew. Stray cells are never told to the planner, and are not expected back: on ground that is being mapped a third
    of all."""
    anew = status.scans < kept.scans and not status.restoring
    return bool(anew and status.trusted_cells >= 0.995 * kept.trusted_cells)


def _kill(watch: Watch, row: Process, label: str, hang: bool, report: Report) -> None:
    name = row.name
    goal = watch.drive(f"kill-{label}")
    pid = watch.process(name)["pid"]
    watch.turn()
    os.kill(pid, signal.SIGSTOP if hang else signal.SIGKILL)
    killed, stamp = time.monotonic(), watch.stamp
    speed, braking, rest, back = watch.speed, math.nan, math.nan, math.nan
    look, kept = killed, watch.map
    whole = math.nan if name == "elevation" and kept is not None else 0.0
    while time.monotonic() - killed < 60.0:
        watch.turn()
        if math.isnan(braking) and watch.speed < speed - BRAKING_DROP:
            braking = (watch.stamp - stamp) / 1e9
        if math.isnan(rest) and watch.speed < RESTING_SPEED:
            rest = (watch.stamp - stamp) / 1e9
        if math.isnan(back) and time.monotonic() > look:
            look = time.monotonic() + 0.1
            told = watch.process(name)
            if told.get("state") == "ready" and told["pid"] != pid:
                back = time.monotonic() - killed
        if math.isnan(whole) and _has_all(watch.map, kept):
            whole = time.monotonic() - killed
        if watch.goal.state in ENDED and not math.isnan(back + whole):
            break
    print(
        f"{label}: brakes after {braking:.2f} s, at rest after {rest:.2f} s, back after {back:.1f} s, "
        f"{watch.goal.state}",
        flush=True,
    )
    report.add(f"speed.{label}", speed, "m/s")
    if row.stops_motion:
        report.add(f"braking_s.{label}", braking, "s")
        report.add(f"rest_s.{label}", rest, "s", 1.3 if hang else 0.3)
    # A process that hangs is ended when its heartbeat is that old.
    report.add(f"back_s.{label}", back, "s", 5.0 + (row.hang if hang else 0.0))
    if whole != 0.0:
        print(
            f"{label}: {watch.map.trusted_cells} of {kept.trusted_cells} trusted cells after {whole:.1f} s; "
            f"{watch.map.detail}",
            flush=True,
        )
        report.add(f"whole_map_s.{label}", whole, "s", 5.0 + (row.hang if hang else 0.0))
    reached = watch.goal.state == "reached"
    ended = reached or (watch.goal.state == "aborted" and watch.goal.reason != "")
    report.add(f"reached.{label}", float(reached), "bool")
    report.add(f"goal_ended.{label}", float(ended), "bool", 1.0, at_least=True)
    if reached:
        report.add(f"error_m.{label}", math.dist(watch.place, goal), "m", 0.25)
