"""Where scans tell little or tell wrong: open ground with hardly anything in sight, and people who walk past the robot.

Simulated physics and sensors, driven without a planner: the robot follows a list of velocities. Errors are those of the way since the start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hal.mujoco.backend import MujocoBackend
from hal.rotation import rotation, rotation_vector
from hal.scenes import load_scene
from hal.types import NS, GroundTruth, VelocityCommand
from mapping.odometry.pipeline import LidarInertialOdometry
from mapping.odometry.types import ScanOdometry
from tools.bench.perception.odometry import matrix, take
from tools.bench.report import Report

SIGHTS = "field", "field_wall", "field_posts"
CROWDS = "field", "field_posts"
WAY, SPEED = 5.0, 0.5
"""Driven straight on open ground [m, m/s]."""
REST = 1.5
"""Standing before that [s]."""
SECONDS = 12.0
"""In a crowd [s]."""
TICK = NS // 200
LIDAR_STEP = 4
YAW_LIMIT, WAY_LIMIT = 2.0, 0.5
"""After the way [deg], [% of it]."""
STANDING_LIMIT, STANDING_DEG_LIMIT, DRIVING_LIMIT = 0.05, 0.5, 0.25
"""In a crowd [m], [deg], [m]."""


@dataclass(frozen=True, slots=True)
class Off:
    """Errors of one run."""

    metres: float
    """At the end."""
    degrees: float
    worst_m: float
    """At any time."""
    worst_deg: float


def drive(scene: str, seed: int, seconds: float, *, way: float, people: int = 0) -> Off:
    """Odometry on a robot that stands for `REST` [s] and then drives `way` [m], for `seconds` in all."""
    robot = MujocoBackend(load_scene(scene), seed=seed, lidar_step=LIDAR_STEP, people=people)
    odometry = LidarInertialOdometry(mounts={lidar.name: lidar.mount for lidar in robot.capabilities.lidars})
    odometry.warm_up()
    robot.connect()
    truths: list[GroundTruth] = []
    scans: list[ScanOdometry] = []
    for k in range(1, round(seconds * NS / TICK) + 1):
        t = k * TICK / NS - REST
        robot.drive(VelocityCommand(k * TICK, SPEED if 0.0 <= t < way / SPEED else 0.0, 0.0, 0.0))
        for sample in robot.read(k * TICK):
            if isinstance(sample, GroundTruth):
                truths.append(sample)
            scans += take(odometry, sample)
    robot.close()
    return _off(scans, truths)


def _off(scans: list[ScanOdometry], truths: list[GroundTruth]) -> Off:
    stamps = np.array([truth.stamp for truth in truths])
    off = []
    for scan in scans:
        k = int(np.abs(stamps - scan.stamp).argmin())
        # between two truths, 10 ms at most, it moves on
        truth, late = truths[k], (scan.stamp - int(stamps[k])) / NS
        true = matrix(truth.position, truth.orientation)
        true[:3, 3] += late * rotation(truth.orientation) @ truth.linear
        off.append((true, matrix(scan.position, scan.orientation)))
    true0, got0 = off[0]
    errors = []
    for true, got in off:
        d = np.linalg.inv(np.linalg.inv(true0) @ true) @ np.linalg.inv(got0) @ got
        errors.append(
            (float(np.linalg.norm(d[:2, 3])), abs(math.degrees(float(rotation_vector(d[:3, :3])[2]))))
        )
    worst = np.array(errors).max(axis=0)
    return Off(float(errors[-1][0]), float(errors[-1][1]), float(worst[0]), float(worst[1]))


def people_of(seed: int) -> int:
    """2 to 10."""
    return 2 + seed % 9


def rows(report: Report, seeds: int) -> None:
    """Rows of this part: `seeds` runs of each kind."""
    seconds = REST + WAY / SPEED + 0.5
    for scene in SIGHTS:
        runs = [drive(scene, seed, seconds, way=WAY) for seed in range(seeds)]
        report.add(f"open.{scene}.yaw_deg", max(r.degrees for r in runs), "deg", YAW_LIMIT)
        report.add(f"open.{scene}.way_pct", 100.0 * max(r.metres for r in runs) / WAY, "%", WAY_LIMIT)
    for scene in CROWDS:
        stood = [drive(scene, seed, SECONDS, way=0.0, people=people_of(seed)) for seed in range(seeds)]
        report.add(f"crowd.{scene}.standing_m", max(r.worst_m for r in stood), "m", STANDING_LIMIT)
        report.add(f"crowd.{scene}.standing_deg", max(r.worst_deg for r in stood), "deg", STANDING_DEG_LIMIT)
        driven = [drive(scene, seed, seconds, way=WAY, people=people_of(seed)) for seed in range(seeds)]
        report.add(f"crowd.{scene}.driving_m", max(r.metres for r in driven), "m", DRIVING_LIMIT)
