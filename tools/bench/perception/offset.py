"""LiDARs whose stamps are off the IMU: what is found, and what the motion over 1 s costs with and without the
correction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TypeVar

from hal.lidar.spec import LIDARS
from hal.types import NS, Extrinsics, ImuSample, JointSample, LidarName, LidarScan
from mapping.odometry.pipeline import LidarInertialOdometry, OdometryConfig
from mapping.odometry.types import ScanOdometry
from tools.bench.perception.odometry import Track, errors, matrix, take
from tools.bench.report import Report
from tools.synthetic import SyntheticRun, arena_run

Measured = ImuSample | JointSample | LidarScan
S = TypeVar("S", bound=Measured)
STAMP_OFFSETS = (0, 10, 20, 30, -10)
"""Of the main LiDAR [ms]; the head's are the opposite."""
FOUND_LIMIT = {"main": 1.0, "head": 3.0}
"""Error of what is found at the end [ms]."""
MOTION_LIMIT = 6.0
"""RMS over 1 s, the seconds until the offset is found included [mm]."""


def two_lidars(seconds: float, seed: int) -> tuple[SyntheticRun, list[Measured]]:
    """The arena run of an XT16 with every fourth firing, an L1 in the head; in order of arrival."""
    run = replace(arena_run("xt16", duration=seconds, seed=seed), lidar=LIDARS["xt16"].decimated(4))
    head = replace(run, lidar=LIDARS["l1"], seed=seed + 100)
    samples = [s for s in run.samples() if isinstance(s, Measured)]
    samples += [replace(s, name="head") for s in head.samples() if isinstance(s, LidarScan)]
    return run, sorted(samples, key=lambda s: s.stamp + NS // 10 * isinstance(s, LidarScan))


def delayed(sample: S, late: Mapping[LidarName, float]) -> S:
    """A scan whose stamp lies `late` [s] before the truth; another sample as it is."""
    if isinstance(sample, LidarScan):
        return replace(sample, stamp=sample.stamp - round(late[sample.name] * NS))
    return sample


def driven(
    samples: list[Measured],
    params: OdometryConfig,
    mounts: Mapping[LidarName, Extrinsics],
    late: Mapping[LidarName, float],
) -> Iterator[ScanOdometry]:
    """The odometry on samples whose stamps of each LiDAR lie `late` [s] before the truth."""
    odometry = LidarInertialOdometry(params, mounts)
    for sample in samples:
        yield from take(odometry, delayed(sample, late))


def rows(report: Report, seconds: float, seed: int) -> None:
    """Rows `offset_ms.*`; the baseline of a motion is that without the correction."""
    run, samples = two_lidars(seconds, seed)
    mounts: dict[LidarName, Extrinsics] = {"main": run.extrinsics, "head": LIDARS["l1"].mount}
    for offset in STAMP_OFFSETS:
        late: dict[LidarName, float] = {"main": 1e-3 * offset, "head": -1e-3 * offset}
        motion: list[float] = []
        found: dict[LidarName, float] = {}
        for bound in (0.05, 0.0):
            params = OdometryConfig(max_time_offset=bound)
            scans = list(driven(samples, params, mounts, late))
            track = Track([s.stamp for s in scans], [matrix(s.position, s.orientation) for s in scans], [0.0])
            motion.append(errors(run, track).rpe_mm)
            found = found or {lidar.name: lidar.offset for lidar in scans[-1].lidars}
        for name, value in found.items():
            off = 1e3 * abs(value - late[name])
            report.add(f"offset_ms.{offset}.{name}_found_off", off, "ms", FOUND_LIMIT[name])
        report.add(f"offset_ms.{offset}.rpe_mm", motion[0], "mm", MOTION_LIMIT, motion[1])
