"""Where scans tell little or tell wrong: open ground with hardly anything in sight, and people who walk past the robot.

Simulated physics and sensors, driven without a planner: the robot follows a list of velocities. Errors are those of the
way since the start.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from hal.mujoco.backend import MujocoBackend
from hal.rotation import rotation, rotation_vector
from hal.scenes import load_scene
from hal.types import NS, GroundTruth, VelocityCommand
from mapping.odometry.pipeline import LidarInertialOdometry
from mapping.odometry.types import ScanOdometry
from tools.bench.perception.odometry import matrix, take
from tools.bench.records import Records
from tools.bench.report import Report

SIGHTS = "field", "field_wall", "field_posts"
CROWDS = "field", "field_posts"
OPEN_WAY, OPEN_SPEED = 5.0, 0.5
"""Driven straight on open ground [m, m/s]."""
REST_TIME = 1.5
"""Standing before that [s]."""
CROWD_SECONDS = 12.0
"""In a crowd [s]."""
TICK_PERIOD = NS // 200
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
    """Odometry on a robot that stands for `REST_TIME` [s] and then drives `way` [m], for `seconds` in all."""
    robot = MujocoBackend(load_scene(scene), seed=seed, lidar_step=LIDAR_STEP, people=people)
    odometry = LidarInertialOdometry(mounts={lidar.name: lidar.mount for lidar in robot.capabilities.lidars})
    odometry.warm_up()
    robot.connect()
    truths: list[GroundTruth] = []
    scans: list[ScanOdometry] = []
    for k in range(1, round(seconds * NS / TICK_PERIOD) + 1):
        t = k * TICK_PERIOD / NS - REST_TIME
        robot.drive(
            VelocityCommand(k * TICK_PERIOD, OPEN_SPEED if 0.0 <= t < way / OPEN_SPEED else 0.0, 0.0, 0.0)
        )
        for sample in robot.read(k * TICK_PERIOD):
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


def rows(report: Report, seeds: int, records: Records) -> None:
    """Rows of this part: `seeds` runs of each kind; those that stand in `records` are not driven again."""
    seconds = REST_TIME + OPEN_WAY / OPEN_SPEED + 0.5

    def runs(kind: str, scene: str, seconds: float, way: float, *, crowd: bool) -> list[Off]:
        return [
            _recorded(
                records, f"{kind}.{scene}.{seed}", scene, seed, seconds, way, people_of(seed) if crowd else 0
            )
            for seed in range(seeds)
        ]

    for scene in SIGHTS:
        seen = runs("open", scene, seconds, OPEN_WAY, crowd=False)
        report.add(f"open.{scene}.yaw_deg", max(r.degrees for r in seen), "deg", YAW_LIMIT)
        report.add(f"open.{scene}.way_pct", 100.0 * max(r.metres for r in seen) / OPEN_WAY, "%", WAY_LIMIT)
        good = sum(r.degrees <= YAW_LIMIT and 100.0 * r.metres <= WAY_LIMIT * OPEN_WAY for r in seen)
        report.rate(f"open.{scene}.held", good, len(seen))
    for scene in CROWDS:
        stood = runs("standing", scene, CROWD_SECONDS, 0.0, crowd=True)
        report.add(f"crowd.{scene}.standing_m", max(r.worst_m for r in stood), "m", STANDING_LIMIT)
        report.add(f"crowd.{scene}.standing_deg", max(r.worst_deg for r in stood), "deg", STANDING_DEG_LIMIT)
        good = sum(r.worst_m <= STANDING_LIMIT and r.worst_deg <= STANDING_DEG_LIMIT for r in stood)
        report.rate(f"crowd.{scene}.stood", good, len(stood))
        driven = runs("driving", scene, seconds, OPEN_WAY, crowd=True)
        report.add(f"crowd.{scene}.driving_m", max(r.metres for r in driven), "m", DRIVING_LIMIT)
        report.rate(f"crowd.{scene}.drove", sum(r.metres <= DRIVING_LIMIT for r in driven), len(driven))


def _recorded(
    records: Records, key: str, scene: str, seed: int, seconds: float, way: float, people: int
) -> Off:
    record = records.get(key, lambda: asdict(drive(scene, seed, seconds, way=way, people=people)))
    return Off(**{name: value for name, value in record.items() if name != "key"})
