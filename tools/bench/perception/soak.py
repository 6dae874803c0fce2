"""Long driving in a still scene: does anything grow, slow down or wear off?"""

from __future__ import annotations

import time

import numpy as np
import psutil

from hal.robots import describe
from hal.types import GroundTruth, JointSample
from mapping.elevation.map import ElevationMap
from mapping.grid import ElevationGrid
from mapping.odometry.contacts import wheel_contacts
from mapping.odometry.pipeline import LidarInertialOdometry, OdometryConfig
from tools.bench.perception.odometry import take
from tools.bench.report import Report
from tools.synthetic import soak_run


def rows(report: Report, minutes: float, lidar: str = "xt16", azimuth_step: int = 2) -> None:
    """Drive rounds through the arena for `minutes` of simulated time with odometry and map as the stack runs them.

    The first third settles. Then: CPU per scan in the last third against the middle third, growth of the process [MB],
    and
    cells that were trusted after the first third and are unknown at the end [%].
    """
    run = soak_run(lidar, minutes=minutes, azimuth_step=azimuth_step)
    odometry = LidarInertialOdometry(OdometryConfig(), {"main": run.extrinsics})
    odometry.warm_up()
    elevation = ElevationMap()
    elevation.warm_up()
    cpu: list[float] = []
    spent = 0.0
    memory, before = 0.0, None
    expected = int(run.duration * 10)
    joints: JointSample | None = None
    for sample in run.samples():
        if isinstance(sample, GroundTruth):
            continue
        start = time.thread_time()
        joints = sample if isinstance(sample, JointSample) else joints
        results = take(odometry, sample)
        for r in results:
            elevation.fuse(r.cloud, r.position, r.orientation, r.stamp, run.sensor)
            if joints is not None:
                elevation.fuse_ground(
                    wheel_contacts(describe().limbs, joints), r.position, r.orientation, r.stamp
                )
            if len(cpu) % 3 == 0:
                elevation.clean()
            elevation.take_patches()
        spent += time.thread_time() - start
        if not results:
            continue
        cpu.append(spent)
        spent = 0.0
        if len(cpu) == expected // 3:
            memory, before = psutil.Process().memory_info().rss, elevation.grid()
    third = len(cpu) // 3
    ratio = float(np.median(cpu[2 * third :]) / np.median(cpu[third : 2 * third]))
    growth = (psutil.Process().memory_info().rss - memory) / 2**20
    assert before is not None
    report.add("soak.minutes", minutes, "min")
    report.add("soak.latency_ratio", ratio, "1", limit=1.2)
    report.add("soak.memory_mb", growth, "MB", limit=20.0)
    report.add("soak.eroded_cells_pct", eroded(before, elevation.grid()), "%", limit=0.1)
    report.add("soak.height_correction_mm", 1e3 * elevation.alignment.height, "mm")
    report.add("soak.latency_ms", 1e3 * float(np.median(cpu)), "ms")


def eroded(before: ElevationGrid, after: ElevationGrid) -> float:
    """Cells trusted in `before` whose height is unknown in `after` [% of them]."""
    row, column = np.nonzero(before.trusted)
    shift_row = round((before.origin[1] - after.origin[1]) / after.resolution)
    shift_column = round((before.origin[0] - after.origin[0]) / after.resolution)
    row, column = row + shift_row, column + shift_column
    rows, columns = after.shape
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    kept = np.isfinite(after.height[row[inside], column[inside]]).sum()
    return 100.0 * (1.0 - float(kept) / max(len(row), 1))
