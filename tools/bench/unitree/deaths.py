"""The whole stack drives the peer; what is upstream of the robot dies; how long the robot takes to stand still."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import psutil

from tests.hal.unitree.peer_process import PeerProcess
from tests.places import ROOT
from tools.bench.report import Report
from tools.bench.unitree.stack import Stack, running_stack

PROCESSES = ("tracker", "navigator", "elevation", "odometry", "robot")
"""The last two leave a gap in the odometry."""
STACKS = ("up", "host", "cable")
"""Deaths of more than a process: the supervisor; every process at once; the same, seen from a robot whose cable is
cut."""
DEATHS = (*PROCESSES, *STACKS)
REST_LIMIT = 0.5


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
            with running_stack(domain, peer) as stack:
                for name in processes:
                    stack.cruise()
                    gaps += stack.move_gaps()
                    speed[name].append(peer.last["v"])
                    rest[name].append(_dies(stack, name))
        for name in [n for n in deaths if n in STACKS]:
            for _ in range(trials):
                with _sentry(domain), running_stack(domain, peer) as stack:
                    stack.cruise()
                    speed[name].append(peer.last["v"])
                    rest[name].append(_dies(stack, name))
            if name != "up":  # what the robot makes of it by itself
                with running_stack(domain, peer) as stack:
                    stack.cruise()
                    alone[name] = _dies(stack, name)
    finally:
        peer.end()
    for name in deaths:
        report.add(f"unitree.rest_s.{name}", max(rest[name]), "s", REST_LIMIT, alone.get(name))
        report.add(f"unitree.speed_at_death.{name}", min(speed[name]), "m/s")
    if gaps:
        report.add("unitree.move_rate", 1.0 / float(np.mean(gaps)), "Hz", 20.0, at_least=True)
        report.add("unitree.move_gap_p99", float(np.percentile(gaps, 99)), "s", 0.05)
        report.add("unitree.move_gap_max", max(gaps), "s")


def _dies(stack: Stack, name: str) -> float:
    """Kill it, and return the seconds until the robot rests."""
    family = [stack.supervisor, *stack.supervisor.children(recursive=True)]
    if name in PROCESSES:
        rows = stack.status()["processes"]
        family = [psutil.Process(next(row["pid"] for row in rows if row["process"] == name))]
    elif name == "up":
        family = [stack.supervisor]
    moment = time.monotonic()
    for process in reversed(family):  # the guardian, a child of a child, first: nobody is to notice
        if name == "cable":
            process.suspend()
        else:
            process.kill()
    while stack.peer.last["t"] < moment + 2.0:
        time.sleep(0.01)
    for process in family:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()
    if name in PROCESSES:
        stack.wait_for(name, family[0].pid)
    seconds = stack.peer.first_rest_after(moment)
    print(f"{name}: {seconds:.2f} s to rest", file=sys.stderr)
    return seconds


@contextmanager
def _sentry(domain: int) -> Iterator[None]:
    arguments = [sys.executable, "-m", "hal.unitree.sentry", "lo", "--domain", str(domain)]
    process = subprocess.Popen(arguments, cwd=ROOT, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait()
