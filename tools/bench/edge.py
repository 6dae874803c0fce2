"""A robot driven by hand towards an edge of half a metre: how far the body comes over it. Lockstep, judged by the
truth."""

from __future__ import annotations

import argparse
import math
import tempfile
from itertools import product
from pathlib import Path

import numpy as np

from hal.robots.go2w.facts import BODY_LENGTH, BODY_WIDTH
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.wire.convert import yaw_of
from rbtrg_robot.wire.messages import header
from tools.bench.report import Report

EDGE_DEPTH, EDGE_DISTANCE = 0.5, 1.8
"""Of the edge and to it from the start [m]: nearer than where the lowest beam of an XT16 meets flat ground."""
CARRIED: dict[str, list[dict[str, str]]] = {
    "xt16_l1": [{"name": "main", "model": "xt16"}, {"name": "head", "model": "l1"}],
    "xt16": [{"name": "main", "model": "xt16"}],
    "l1": [{"name": "main", "model": "l1"}],
}


def push_to_edge(vx: float, lean: float, lidars: str, folder: Path) -> tuple[float, float]:
    """Hold `vx` [m/s] until well after the edge, which leans by `lean` [rad]; how far [m] a corner of the body came
    over it, and the
    lowest base_link [m] above the ground on top.
    """
    way = math.copysign(1.0, vx)
    x, y = np.meshgrid(*(2 * [np.arange(201) * 0.05 - 5.0]))
    height = np.where((way * x - EDGE_DISTANCE) * math.cos(lean) + y * math.sin(lean) > 0.0, 0.0, EDGE_DEPTH)
    file = folder / "edge.npz"
    np.savez(file, height=height.astype(np.float32), resolution=0.05, origin=np.array([-5.0, -5.0]))
    config = load(None, [], scene=str(file), origin=(0.0, 0.0, 0.0), lidars=CARRIED[lidars])
    over, lowest = -math.inf, math.inf
    with Lockstep(config) as stack:
        stack.wait_ready()
        for _ in range(round((EDGE_DISTANCE / abs(vx) + 2.0) * 25)):
            command = msg.TwistStamped(header=header(stack.now, "base_link"))
            command.twist.linear.x = vx
            stack.host.inject(t.TELEOP, command)
            stack.run(0.04)
            pose = stack.newest[t.TRUTH].pose.pose
            yaw = yaw_of(pose.orientation)
            lowest = min(lowest, pose.position.z - EDGE_DEPTH)
            for u, v in product((-BODY_LENGTH / 2, BODY_LENGTH / 2), (-BODY_WIDTH / 2, BODY_WIDTH / 2)):
                cx = pose.position.x + u * math.cos(yaw) - v * math.sin(yaw)
                cy = pose.position.y + u * math.sin(yaw) + v * math.cos(yaw)
                over = max(over, (way * cx - EDGE_DISTANCE) * math.cos(lean) + cy * math.sin(lean))
    return over, lowest


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench edge", description=__doc__)
    parser.add_argument("--lidars", nargs="*", choices=CARRIED, default=["xt16_l1", "xt16"])
    parser.add_argument("--speeds", nargs="*", type=float, default=[0.5, 0.2, -0.5, -0.2])
    options = parser.parse_args(args)
    report = Report("edge")
    with tempfile.TemporaryDirectory() as folder:
        for lidars, speed, lean in product(options.lidars, options.speeds, (0.0, 30.0)):
            over, lowest = push_to_edge(speed, math.radians(lean), lidars, Path(folder))
            name = f"{lidars}.{speed:+.1f}.{lean:.0f}deg"
            report.add(f"over_m.{name}", over, "m", 0.04)
            report.add(f"lowest_m.{name}", lowest, "m", 0.3, at_least=True)
    return report
