"""A running `up` on a peer (`tests/hal/unitree/peer.py`), for the benchmarks that make something fail while it
drives."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from rbtrg_robot import topics as t
from rbtrg_robot.stages.navigation.goal import goal_request
from rbtrg_robot.wire.bus import Bus
from tests.hal.unitree.peer_process import PeerProcess
from tools.bench.ports import free_port

CRUISE_SPEED = 0.45
"""[m/s] for `STEADY_TIME` [s]; the stack drives 0.5 m/s."""
STEADY_TIME = 0.3
GOAL_DISTANCE = 3.0
"""Goals lie this far on the other side of the origin [m]."""
ENDED = ("reached", "rejected", "aborted")


class Stack:
    """A running `up` on the peer, and what it takes to drive and to kill it."""

    def __init__(self, bus: Bus, peer: PeerProcess, supervisor: int, logs: Path) -> None:
        self._bus, self.logs = bus, logs
        self.peer, self.supervisor = peer, psutil.Process(supervisor)
        start = peer.last
        self._start = (start["x"], start["y"], start["yaw"])
        self._count = 0
        self.target = (math.nan, math.nan)
        """Where the newest goal lies, in the robot's world [m]."""

    def cruise(self) -> None:
        """Drive until the robot keeps its speed; to and fro, where one way is not enough."""
        end = time.monotonic() + 40.0
        since, due = math.inf, 0.0
        goal: Any = None
        while not time.monotonic() - since > STEADY_TIME:
            now = time.monotonic()
            since = min(since, now) if self.peer.last["v"] > CRUISE_SPEED else math.inf
            if now > end:
                raise SystemExit(f"the robot did not drive: {self.status()['robot']}")
            if now > due:
                due = now + 0.5
                heard = self.status()["robot"].get("goal") or {}
                if goal is None or (heard.get("id") == goal.id and heard["state"] in ENDED):
                    goal = self._goal()
                stamp = time.time_ns()
                self._bus.publish(t.GOAL_REQUEST, goal, stamp)  # a repeat changes nothing
            time.sleep(0.01)

    def _goal(self) -> Any:
        """To the other side of the origin, in this stack's map, which begins where the robot stood."""
        x, y, yaw = self._start
        self.target = (GOAL_DISTANCE if self.peer.last["x"] < 0.0 else -GOAL_DISTANCE, 0.0)
        dx = self.target[0] - x
        self._count += 1
        to = (dx * math.cos(yaw) - y * math.sin(yaw), -y * math.cos(yaw) - dx * math.sin(yaw))
        return goal_request(time.time_ns(), f"bench-{self._count}", *to)

    def status(self) -> dict[str, Any]:
        """As `status --json` prints it."""
        return dict(json.loads(self._bus.ask("status") or b'{"robot": {}, "processes": []}'))

    def move_gaps(self) -> list[float]:
        """[s] between the Moves that the robot got during the last second."""
        now = self.peer.last["t"]
        moves = [at for row in self.peer.reports if row["t"] > now - 1.0 for at in row["moves"]]
        return np.diff(moves).tolist()

    def until(self, condition: Callable[[dict[str, Any]], bool], limit: float, what: str) -> float:
        """Seconds until `condition` holds for the robot's part of `status`."""
        began = time.monotonic()
        while not condition(robot := self.status()["robot"]):
            if time.monotonic() - began > limit:
                raise SystemExit(f"{what} did not come within {limit:.0f} s: {robot}")
            time.sleep(0.02)
        return time.monotonic() - began

    def wait_for(self, name: str, old: int) -> None:
        """Until a process with another pid than `old` is ready."""
        end = time.monotonic() + 30.0
        while time.monotonic() < end:
            rows = self.status()["processes"]
            if any(r["process"] == name and r["state"] == "ready" and r["pid"] != old for r in rows):
                return
            time.sleep(0.1)
        raise SystemExit(f"{name} did not come back")


@contextmanager
def running_stack(domain: int, peer: PeerProcess) -> Iterator[Stack]:
    """A ready stack; it leaves the robot standing."""
    with tempfile.TemporaryDirectory() as scratch:
        port = free_port()
        arguments = ["--backend", "unitree", "--interface", "lo", "--set", f"unitree.domain={domain}"]
        arguments += ["--set", "unitree.sit_on_close=false"]  # the next one drives at once
        up = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "rbtrg_robot.cli",
                "up",
                "--port",
                str(port),
                "--log-dir",
                scratch,
                *arguments,
            ],
            env={**os.environ, "XDG_RUNTIME_DIR": scratch},
            stdout=subprocess.DEVNULL,
        )
        try:
            state = Path(scratch) / "rbtrg" / "go2w.json"
            _wait_until_ready(up, state)
            with Bus(json.loads(state.read_text())["endpoint"], "bench") as bus:
                yield Stack(bus, peer, up.pid, Path(scratch))
        finally:
            up.terminate()
            up.wait()


def _wait_until_ready(up: subprocess.Popen[bytes], state: Path) -> None:
    end = time.monotonic() + 240.0  # the first start after a change compiles
    while time.monotonic() < end and up.poll() is None:
        if state.exists() and json.loads(state.read_text())["ready"]:
            return
        time.sleep(0.1)
    raise SystemExit("the stack did not come up")
