"""The robot itself goes while the whole stack drives it, and comes back: what `status` says, and whether it drives
again."""

from __future__ import annotations

import math
import os
import sys
import time
from typing import Any

from tests.hal.unitree.peer_process import PeerProcess
from tools.bench.report import Report
from tools.bench.unitree.stack import ENDED, Stack, running_stack

GONE_TIME = 3.5
"""[s] after which the robot comes back; a goal waits for 3 s."""
WORDS = "no LowState for "


def run(report: Report) -> None:
    """Kill the peer, start another in its place."""
    domain = 20 + os.getpid() % 180
    peer = PeerProcess(domain, "--body", "mujoco")
    try:
        with running_stack(domain, peer) as stack:
            stack.cruise()
            place = peer.last
            peer.end()
            gone = time.monotonic()
            report.add("unitree.away.told_s", stack.until(_away, 5.0, "`disconnected`"), "s", 0.6)
            stack.until(_goal_ended, 10.0, "the end of the goal")
            report.add("unitree.away.goal_ended_s", time.monotonic() - gone, "s", 5.0)
            time.sleep(max(0.0, gone + GONE_TIME - time.monotonic()))
            where = [str(place[name]) for name in ("x", "y", "yaw")]
            stack.peer = peer = PeerProcess(domain, "--body", "mujoco", "--start", *where)
            report.add("unitree.back.usable_s", stack.until(_usable, 20.0, "a usable robot"), "s", 5.0)
            stack.cruise()
            stack.until(lambda robot: robot["goal"]["state"] in ENDED, 60.0, "the end of the second goal")
            reached = stack.status()["robot"]["goal"]["state"] == "reached"
            report.add("unitree.back.goal_reached", float(reached), "bool", 1.0, at_least=True)
            error = math.dist((peer.last["x"], peer.last["y"]), stack.target)
            report.add("unitree.back.goal_error_m", error, "m", 0.25)
            report.add("unitree.away.tracebacks", float(_tracebacks(stack)), "", 0.0)
    finally:
        peer.end()


def _away(robot: dict[str, Any]) -> bool:
    return robot["mode"] == "disconnected" and robot["cause"].startswith(WORDS)


def _goal_ended(robot: dict[str, Any]) -> bool:
    goal = robot["goal"]
    return bool(goal["reason"] == "robot_disconnected" and goal["detail"].startswith(WORDS))


def _usable(robot: dict[str, Any]) -> bool:
    """It stands, knows where it is and waits for a command."""
    waits = robot["hold"] in ("", "no command", "no fresh command")
    return bool(robot["mode"] == "ready" and waits and robot["localization"] == "good")


def _tracebacks(stack: Stack) -> int:
    found = [path for path in stack.logs.rglob("*.log") if "Traceback" in path.read_text()]
    for path in found:
        print(path.read_text(), file=sys.stderr)
    return len(found)
