"""Cost of a simulated LiDAR beside the physics, in the thread that does both."""

from __future__ import annotations

import time

import numpy as np

from hal.lidar.config import only
from hal.mujoco.backend import MujocoBackend
from hal.scenes import load_scene
from hal.types import NS, VelocityCommand
from tools.bench.report import Report

LIMIT_MS = 8.0
"""Per sweep of 30,000 rays: 8 % of a core at 10 Hz."""
STEP_PERIOD = NS // 200
SWEEP_COUNT = 40


def rows(report: Report, lidars: list[str]) -> None:
    """Row `cpu_ms.lidar.LIDAR`: thread time of a sweep [ms] in the yard while the robot drives; baseline: physics and
    control of the same 0.1 s."""
    for lidar in lidars:
        cost, physics = sweep_ms(lidar)
        report.add(f"cpu_ms.lidar.{lidar}", cost, "ms", LIMIT_MS if lidar == "xt16" else None, physics)


def sweep_ms(lidar: str) -> tuple[float, float]:
    """Thread time of a sweep and of the physics meanwhile [ms]: two robots in turns, one of them without a LiDAR."""
    scene = load_scene("yard")
    robots = [MujocoBackend(scene, lidars=lidars) for lidars in ((), only(lidar))]
    spent: list[list[float]] = [[], []]
    for robot in robots:
        robot.connect()
    for sweep in range(SWEEP_COUNT):
        for robot, times in zip(robots, spent, strict=True):
            robot.drive(VelocityCommand(sweep * NS // 10, 0.3, 0.0, 0.0))
            start = time.thread_time()
            for now in range(sweep * NS // 10, (sweep + 1) * NS // 10, STEP_PERIOD):
                robot.read(now + STEP_PERIOD)
            times.append(time.thread_time() - start)
    alone, both = (1e3 * float(np.median(times)) for times in spent)
    return both - alone, alone
