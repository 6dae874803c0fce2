"""The whole stack drives the peer; what is upstream of the robot dies; how long the robot takes to stand still."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from rbtrg_robot import topics as t
from rbtrg_robot.bus import Bus
from rbtrg_robot.goal import goal_request
from tests.unitree_peer_process import ROOT, PeerProcess
from tools.bench._live import free_port
from tools.bench.report import Report

PROCESSES = ("tracker", "navigator", "elevation", "odometry", "robot")
"""The last two leave a gap in the odometry."""
STACKS = ("up", "host", "cable")
"""Deaths of more than a process: the supervisor; every process at once; the same, seen from a robot whose cable is cut."""
DEATHS = (*PROCESSES, *STACKS)
CRUISE = 0.45
"""[m/s] for `STEADY` [s] before the death; the stack drives 0.5 m/s."""
STEADY = 0.3
AHEAD = 3.0
"""Goals lie this far on the other side of the origin [m]."""
LIMIT = 0.5
ENDED = ("reached", "rejected", "aborted")


def run(report: Report, deaths: list[str], trials: int) -> None:
    """Add the rows: per death the longest time to rest, and how regular Move was until then."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # leaves nothing behind
    domain = 20 + os.getpid() % 180
    peer = PeerProcess(domain, "--body", "mujoco")
    rest: dict[str, list[float]] = {name: [] for name in deaths}
    speed: dict[str, list[float]] = {name: [] for name in deaths}
    alone: dict[str, float] = {}
    gaps: list[float] = []
    processes = [name for name in PROCESSES if name in deaths]
    try:
        for _ in range(trials if processes else 0):
            with _stack(domain, peer) as stack:
                for name in processes:
                    stack.cruise()
                    gaps += stack.move_gaps()
                    speed[name].append(peer.last["v"])
                    rest[name].append(stack.dies(name))
        for name in [n for n in deaths if n in STACKS]:
            for _ in range(trials):
                with _sentry(domain), _stack(domain, peer) as stack:
                    stack.cruise()
                    speed[name].append(peer.last["v"])
                    rest[name].append(stack.dies(name))
            if name != "up":  # what the robot makes of it by itself
                with _stack(domain, peer) as stack:
                    stack.cruise()
                    alone[name] = stack.dies(name)
    finally:
        peer.end()
    for name in deaths:
        report.add(f"unitree.rest_s.{name}", max(rest[name]), "s", LIMIT, alone.get(name))
        report.add(f"unitree.speed_at_death.{name}", min(speed[name]), "m/s")
    if gaps:
        report.add("unitree.move_rate", 1.0 / float(np.mean(gaps)), "Hz", 20.0, at_least=True)
        report.add("unitree.move_gap_p99", float(np.percentile(gaps, 99)), "s", 0.05)
        report.add("unitree.move_gap_max", max(gaps), "s")


class Stack:
    """A running `up` on the peer, and what it takes to drive and to kill it."""

    def __init__(self, bus: Bus, peer: PeerProcess, supervisor: int) -> None:
        self._bus, self._peer, self._supervisor = bus, peer, psutil.Process(supervisor)
        start = peer.last
        self._start = (start["x"], start["y"], start["yaw"])
        self._count = 0

    def cruise(self) -> None:
        """Drive until the robot keeps its speed; to and fro, where one way is not enough."""
        end = time.monotonic() + 40.0
        since, due = math.inf, 0.0
        goal: Any = None
        while not time.monotonic() - since > STEADY:
            now = time.monotonic()
            since = min(since, now) if self._peer.last["v"] > CRUISE else math.inf
            if now > end:
                raise SystemExit(f"the robot did not drive: {self._status()['robot']}")
            if now > due:
                due = now + 0.5
                heard = self._status()["robot"].get("goal") or {}
                if goal is None or (heard.get("id") == goal.id and heard["state"] in ENDED):
                    goal = self._goal()
                stamp = time.time_ns()
                self._bus.publish(t.GOAL_REQUEST, goal, stamp)  # a repeat changes nothing
            time.sleep(0.01)

    def _goal(self) -> Any:
        """To the other side of the origin, in this stack's map, which begins where the robot stood."""
        x, y, yaw = self._start
        dx = (AHEAD if self._peer.last["x"] < 0.0 else -AHEAD) - x
        self._count += 1
        to = (dx * math.cos(yaw) - y * math.sin(yaw), -y * math.cos(yaw) - dx * math.sin(yaw))
        return goal_request(time.time_ns(), f"death-{self._count}", *to)

    def _status(self) -> dict[str, Any]:
        return dict(json.loads(self._bus.ask("status") or b'{"robot": {}, "processes": []}'))

    def move_gaps(self) -> list[float]:
        """[s] between the Moves that the robot got during the last second."""
        now = self._peer.last["t"]
        moves = [at for row in self._peer.reports if row["t"] > now - 1.0 for at in row["moves"]]
        return np.diff(moves).tolist()

    def dies(self, name: str) -> float:
        """Kill it, and return the seconds until the robot rests."""
        family = [self._supervisor, *self._supervisor.children(recursive=True)]
        if name in PROCESSES:
            rows = self._status()["processes"]
            family = [psutil.Process(next(row["pid"] for row in rows if row["process"] == name))]
        elif name == "up":
            family = [self._supervisor]
        moment = time.monotonic()
        for process in reversed(family):  # the guardian, a child of a child, first: nobody is to notice
            if name == "cable":
                process.suspend()
            else:
                process.kill()
        while self._peer.last["t"] < moment + 2.0:
            time.sleep(0.01)
        for process in family:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        if name in PROCESSES:
            self._wait_for(name, family[0].pid)
        seconds = self._peer.first_rest_after(moment)
        print(f"{name}: {seconds:.2f} s to rest", file=sys.stderr)
        return seconds

    def _wait_for(self, name: str, old: int) -> None:
        end = time.monotonic() + 30.0
        while time.monotonic() < end:
            rows = self._status()["processes"]
            if any(r["process"] == name and r["state"] == "ready" and r["pid"] != old for r in rows):
                return
            time.sleep(0.1)
        raise SystemExit(f"{name} did not come back")


@contextmanager
def _stack(domain: int, peer: PeerProcess) -> Iterator[Stack]:
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
            _wait_until_ready(up, Path(scratch) / "rbtrg" / "go2w.json")
            with Bus(f"tcp/127.0.0.1:{port}", "bench") as bus:
                yield Stack(bus, peer, up.pid)
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


@contextmanager
def _sentry(domain: int) -> Iterator[None]:
    arguments = [sys.executable, "-m", "hal.unitree.sentry", "lo", "--domain", str(domain)]
    process = subprocess.Popen(arguments, cwd=ROOT, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait()
