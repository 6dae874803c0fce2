"""`rbtrg-robot stop` from the start of its process to the first stop on the bus, beside an empty Python process."""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rbtrg_robot import topics as t
from rbtrg_robot.msg import RobotState
from rbtrg_robot.process.runfiles import RunLock
from rbtrg_robot.wire.bus import Bus
from tools.bench.ports import free_endpoint
from tools.bench.report import Report

STOP_LIMIT = 0.25
"""[s]"""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench stop", description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    rounds = parser.parse_args(args).rounds
    report = Report("stop")
    took: list[float] = []
    empty: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        endpoint = free_endpoint()
        os.environ["XDG_RUNTIME_DIR"] = folder
        (Path(folder) / "rbtrg").mkdir()
        with Bus(endpoint, "robot", router=True) as bus:
            bus.subscribe([t.ROBOT_STOP])
            lock = RunLock("go2w")
            lock.write_state(endpoint=endpoint, domain=0)
            for _ in range(rounds):
                began = time.perf_counter()
                subprocess.run([sys.executable, "-c", "pass"], check=True)
                empty.append(time.perf_counter() - began)
                took.append(_once(bus))
            lock.release()
    baseline = statistics.median(empty)
    report.add("stop.first_on_bus.median", statistics.median(took), "s", STOP_LIMIT, baseline)
    report.add("stop.first_on_bus.worst", max(took), "s", STOP_LIMIT, max(empty))
    return report


def _once(bus: Bus) -> float:
    began = time.perf_counter()
    child = subprocess.Popen([sys.executable, "-m", "rbtrg_robot.cli", "stop"], stdout=subprocess.DEVNULL)
    while not (heard := bus.take(0.5)):
        if child.poll() is not None:
            raise RuntimeError("stop ended without having sent anything")
    took = time.perf_counter() - began
    while child.poll() is None:
        bus.publish(t.ROBOT_STATE, RobotState(estop=True, latch=heard[0].decode().latch), 0)
        bus.take(0.02)
    bus.take(0.0)
    return took
