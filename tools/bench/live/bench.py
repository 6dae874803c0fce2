"""A running `up` on the yard, recording on: real-time factor, CPU, memory, latencies, and whether goals are reached.

Five goals in a row, one on the platform and one behind a wall that is not seen from the start. Positions are judged by
the simulator's truth, which the stack itself never sees.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from hal.rotation import wrap
from hal.scenes import load_scene
from rbtrg_robot import topics as t
from rbtrg_robot.stages.navigation.goal import goal_request
from rbtrg_robot.wire.bus import Bus, Received
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.messages import stamp_of
from tools.bench.live.stack import running
from tools.bench.report import Report

SWEEP_TIME = 100_000_000
"""Duration of a scan [ns]: a map update carries the stamp of its end."""
MOVING_SPEED = 0.05
GOAL_LIMIT = 150.0
"""Seconds for one goal."""


@dataclass
class Watch:
    """What comes by while the stack drives; times are wall seconds."""

    truth: Any = None
    status: Any = None
    factors: list[float] = field(default_factory=list)
    scans: dict[int, float] = field(default_factory=dict)
    map_latency: list[float] = field(default_factory=list)
    plan_latency: list[float] = field(default_factory=list)
    asked: dict[int, float] = field(default_factory=dict)
    moved: float = 0.0

    TOPICS = (
        t.TRUTH,
        t.GOAL_STATUS,
        t.ROBOT_STATE,
        t.POINTS,
        t.MAP_UPDATE,
        t.PLAN_REQUEST,
        t.PLAN,
        t.CMD_VEL,
    )

    def take(self, received: Received, goal_id: str) -> None:
        """One message."""
        now = time.monotonic()
        message = received.decode()
        match received.topic:
            case t.TRUTH:
                self.truth = message
            case t.GOAL_STATUS if message.id == goal_id:
                self.status = message
            case t.ROBOT_STATE:
                self.factors.append(float(message.realtime_factor))
            case t.POINTS:
                self.scans[(stamp_of(message) + SWEEP_TIME) // SWEEP_TIME] = now
            case t.MAP_UPDATE:
                begun = self.scans.pop(round(stamp_of(message) / SWEEP_TIME), None)
                if begun is not None:
                    self.map_latency.append(now - begun)
            case t.PLAN_REQUEST:
                self.asked[int(message.sequence)] = now
            case t.PLAN:
                begun = self.asked.pop(int(message.sequence), None)
                if begun is not None:
                    self.plan_latency.append(now - begun)
            case t.CMD_VEL:
                twist = message.twist
                if not self.moved and abs(twist.linear.x) + abs(twist.angular.z) > MOVING_SPEED:
                    self.moved = now


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench live", description=__doc__)
    parser.add_argument("--goals", default="a,b,rough,platform,behind_wall", help="named goals of the scene")
    parser.add_argument("--scene", default="yard")
    parser.add_argument("--set", action="append", default=[], help="set one key of the stack: a.b=c")
    parser.add_argument("--cold", action="store_true", help="no kernel is kept, as at the first start of all")
    parser.add_argument("--keep", type=Path, help="keep the log in this folder")
    options = parser.parse_args(args)
    report = Report("live")
    with tempfile.TemporaryDirectory() as scratch:
        logs = options.keep or Path(scratch) / "logs"
        settings = [word for one in options.set for word in ("--set", one)]
        with running(
            report, Path(scratch), logs, "--scene", options.scene, *settings, cold=options.cold
        ) as bus:
            _drive(bus, options.scene, options.goals.split(","), report)
    return report


def proportional(supervisor: int) -> float:
    """Memory [MB] of a stack at this moment, by its supervisor's pid: what processes share counts once in all (PSS)."""
    found = 0
    for process in (psutil.Process(supervisor), *psutil.Process(supervisor).children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):  # it has just ended
            found += process.memory_full_info().pss
    return found / 1e6


def _drive(bus: Bus, scene_name: str, goals: list[str], report: Report) -> None:
    scene = load_scene(scene_name)
    watch = Watch()
    bus.subscribe(Watch.TOPICS)
    cpu: list[float] = []
    memory: dict[str, float] = {}
    together = 0.0
    first_motion = []
    for number, name in enumerate(goals):
        x, y, yaw = scene.goals[name]
        goal_id = f"bench{number}"
        request = goal_request(time.time_ns(), goal_id, x, y, yaw, timeout=GOAL_LIMIT)
        sent = resend = time.monotonic()
        watch.status, watch.moved = None, 0.0
        bus.publish(t.GOAL_REQUEST, request, time.time_ns())
        sample = sent + 2.0
        while time.monotonic() - sent < GOAL_LIMIT:
            for received in bus.take(0.1):
                watch.take(received, goal_id)
            now = time.monotonic()
            if watch.status is None and now - resend > 1.0:
                resend = now
                bus.publish(t.GOAL_REQUEST, request, time.time_ns())
            if now > sample:
                sample = now + 2.0
                status = json.loads(bus.ask("status") or b"{}")
                processes = status.get("processes", [])
                if status:
                    together = max(together, proportional(status["pid"]))
                cpu.append(sum(p["cpu"] for p in processes))
                for p in processes:
                    memory[p["process"]] = max(memory.get(p["process"], 0.0), p["memory_mb"])
            if watch.status is not None and watch.status.state in ("reached", "rejected", "aborted"):
                break
        if watch.moved:
            first_motion.append(watch.moved - sent)
        reached = watch.status is not None and watch.status.state == "reached"
        report.add(f"reached.{name}", float(reached), "bool", 1.0, at_least=True)
        place = watch.truth.pose.pose
        error = math.hypot(place.position.x - x, place.position.y - y)
        report.add(f"error_m.{name}", error if reached else math.nan, "m", 0.25)
        if yaw is not None:
            turn = math.degrees(abs(wrap(yaw_of(place.orientation) - yaw)))
            report.add(f"error_deg.{name}", turn if reached else math.nan, "deg", 10.0)
        report.add(f"goal_s.{name}", time.monotonic() - sent, "s")
    report.add("realtime_factor", float(np.mean(watch.factors)), "-", 0.95, at_least=True)
    report.add("realtime_factor.min", float(np.min(watch.factors)), "-")
    report.add("cpu_pct", float(np.mean(cpu)), "% of one core", 200.0)
    report.add("memory_pss_mb", together, "MB", 1000.0)
    for name, value in memory.items():
        report.add(f"memory_mb.{name}", value, "MB")
    for key, values in (
        ("point_to_map_ms", watch.map_latency),
        ("map_to_plan_ms", watch.plan_latency),
        ("goal_to_motion_ms", first_motion),
    ):
        report.add(f"{key}.p50", 1000 * float(np.median(values)) if values else math.nan, "ms")
        report.add(f"{key}.max", 1000 * float(np.max(values)) if values else math.nan, "ms")
