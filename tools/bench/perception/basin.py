"""The wrong basin: the robot is moved while no scan comes, its gyro alone tells of it, and level ground fits nearly
everywhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hal.rotation import rotation, wrap
from hal.scenes import Scene
from hal.types import NS, GroundTruth, ImuSample, JointSample, Sample
from mapping.odometry.health import Health
from mapping.odometry.pipeline import LidarInertialOdometry, OdometryConfig
from mapping.odometry.types import ScanOdometry
from tools.bench.perception.odometry import take
from tools.bench.report import Report
from tools.synthetic import SyntheticRun, arena_run
from tools.synthetic_motion import Motion

SCAN_GAPS = (0.2, 0.9, 2.0)
"""Time without scans [s]."""
MOVED_DISTANCE = (0.85, 2.5)
"""How far the robot is moved meanwhile [m],"""
MOST_TURN = 0.4
"""and turned at most [rad]."""
TIME_BEFORE, TIME_AFTER = 4.0, 3.0
"""Driven before the gap, watched behind it [s]."""
WRONG_DISTANCE = 0.1
"""A position this far off [m] is wrong."""


@dataclass(frozen=True, slots=True)
class Moved:
    """What came out of one trial."""

    gap: float
    """[s]"""
    far: float
    """[m]"""
    health: Health
    """Of the last scan."""
    off: float
    """Position error of the last scan [m]."""
    good_while_wrong: int
    """Scans behind the gap."""
    mapped_while_wrong: int


def trial(
    run: SyntheticRun,
    samples: Sequence[Sample],
    gap: float,
    place: tuple[float, float, float],
    params: OdometryConfig,
) -> Moved:
    """Drive `samples`, stand still and blind for `gap` [s], then see from x, y [m], yaw [rad] (`place`) beside
    there."""
    odometry = LidarInertialOdometry(params, {"main": run.extrinsics})
    scans: list[ScanOdometry] = []
    for sample in samples:
        scans += take(odometry, sample)
    end = samples[-1].stamp - samples[-1].stamp % (NS // 10)
    position, orientation = run.truth(end)
    heading = rotation(orientation[0])
    yaw = float(np.arctan2(heading[1, 0], heading[0, 0]))
    start = (float(position[0, 0]) + place[0], float(position[0, 1]) + place[1], wrap(yaw + place[2]))
    there = replace(
        run,
        motion=Motion(kind="standstill", start=start),
        start_stamp=end + round(gap * 10) * (NS // 10),
        duration=TIME_AFTER,
    )
    resting = replace(there, start_stamp=end, duration=gap)
    for sample in resting.samples():
        if (
            isinstance(sample, ImuSample | JointSample)
            and samples[-1].stamp < sample.stamp < there.start_stamp
        ):
            if isinstance(sample, ImuSample):
                sample = replace(sample, gyro=sample.gyro + np.array([0.0, 0.0, place[2] / gap]))
            take(odometry, sample)
    first = scans[0]
    to_world = _matrix(run, first.stamp) @ np.linalg.inv(_pose(first))
    behind: list[ScanOdometry] = []
    for sample in there.samples():
        behind += take(odometry, sample)
    behind = [s for s in behind if s.stamp > there.start_stamp]
    off = [float(np.linalg.norm((to_world @ _pose(s))[:2, 3] - start[:2])) for s in behind]
    wrong = [o > WRONG_DISTANCE for o in off]
    return Moved(
        gap,
        float(np.hypot(*place[:2])),
        behind[-1].health,
        off[-1],
        sum(w and s.health is Health.GOOD for w, s in zip(wrong, behind, strict=True)),
        sum(w and bool(s.clouds) and s.health is not Health.LOST for w, s in zip(wrong, behind, strict=True)),
    )


def trials(count: int, seed: int = 0, params: OdometryConfig | None = None) -> Iterator[Moved]:
    """Moved by `MOVED_DISTANCE` and `MOST_TURN` at random within the arena's open ground, gaps in turn."""
    random = np.random.default_rng(seed)
    run = replace(
        arena_run("xt16", duration=TIME_BEFORE, seed=seed), lidar=arena_run("xt16").lidar.decimated(2)
    )
    run = replace(run, caster=run.scene.caster(), motion=Motion(stop=TIME_BEFORE - 1.2))
    samples = [s for s in run.samples() if not isinstance(s, GroundTruth)]
    here = run.truth(samples[-1].stamp)[0][0]
    for k in range(count):
        while True:
            far, way = random.uniform(*MOVED_DISTANCE), random.uniform(-np.pi, np.pi)
            place = far * np.cos(way), far * np.sin(way), random.uniform(-MOST_TURN, MOST_TURN)
            if open_ground(run.scene, here[0] + place[0], here[1] + place[1]):
                break
        yield trial(run, samples, SCAN_GAPS[k % len(SCAN_GAPS)], place, params or OdometryConfig())


def open_ground(scene: Scene, x: float, y: float) -> bool:
    """Level within the length of the body."""
    c, r = round((x - scene.origin[0]) / scene.resolution), round((y - scene.origin[1]) / scene.resolution)
    n = round(0.5 / scene.resolution)
    part = scene.height[max(r - n, 0) : r + n + 1, max(c - n, 0) : c + n + 1]
    return part.shape == (2 * n + 1, 2 * n + 1) and bool(np.abs(part).max() < 0.02)


def rows(report: Report, count: int) -> None:
    """Rows `basin.*`: trials that end `good` in a wrong place, those that find the right one, scans mapped from a wrong
    place."""
    out = list(trials(count))
    wrong = sum(m.health is Health.GOOD and m.off > WRONG_DISTANCE for m in out)
    report.add("basin.good_while_wrong", wrong, "trials", 0.0)
    report.add("basin.good_scans_while_wrong", sum(m.good_while_wrong for m in out), "scans", 0.0)
    report.add("basin.scans_mapped_while_wrong", sum(m.mapped_while_wrong for m in out), "scans", 0.0)
    report.rate(
        "basin.found", sum(m.health is Health.GOOD and m.off <= WRONG_DISTANCE for m in out), len(out)
    )


def _matrix(run: SyntheticRun, stamp: int) -> np.ndarray:
    out = np.eye(4)
    position, orientation = run.truth(stamp)
    out[:3, :3], out[:3, 3] = rotation(orientation[0]), position[0]
    return out


def _pose(scan: ScanOdometry) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation(scan.orientation), scan.position
    return out
