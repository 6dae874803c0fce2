"""Mounts and clocks of the LiDARs from what the sensors said during a motion: of a log, or of the last seconds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hal.errors import OperatorError
from hal.rotation import rotation, rotation_rpy, rpy_of, turn
from hal.types import NS, Array, Extrinsics, ImuSample, JointSample, LidarName, LidarScan, MountedLidar
from mapping.odometry.own import OwnPart
from mapping.odometry.pipeline import LidarInertialOdometry
from mapping.odometry.types import OdometryConfig
from rbtrg_robot import topics as t
from rbtrg_robot.log.read import read_run
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import LayoutError, imu_sample, joint_sample, lidar_scan
from rbtrg_robot.wire.messages import MessageError, decode

Sample = ImuSample | JointSample | LidarScan
PASS_COUNT = 3
"""The second and the third start from what the one before found: sweeps are no longer bent by a wrong clock."""
NEEDED_SCANS = 20
"""Scans below which nothing is said."""
HEARD: tuple[Topic, ...] = (t.IMU, t.JOINTS, *t.SWEEPS.values())
_NAMES = {topic: name for name, topic in t.SWEEPS.items()}


class CalibrationError(OperatorError):
    """Nothing can be said; the message tells what is missing."""


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """One LiDAR as it is mounted."""

    lidar: MountedLidar
    """With the mount that was found."""
    offset: float
    """To be added to its stamps, beside what the configuration adds [s],"""
    offset_sigma: float
    """and its standard deviation."""
    turn_sigma: Array
    """(3,) about the axes of base_link [rad]."""
    place_sigma: Array
    """(3,) [m]; infinite where the mount stays as configured, because no motion shows it."""


def sample_of(topic: Topic, message: Any) -> Sample | None:
    """A sensor's message as the odometry takes it; None where it cannot be read."""
    try:
        if topic is t.IMU:
            return imu_sample(message)
        return joint_sample(message) if topic is t.JOINTS else lidar_scan(message, _NAMES[topic])
    except LayoutError:
        return None


def samples_of(log: Path) -> Iterator[Sample]:
    """The sensors' samples of a log, in order of arrival. Raises LogError."""
    for entry in read_run(log):
        topic = t.BY_NAME.get(entry.topic) or t.RENAMED.get(entry.topic)
        if topic in HEARD:
            try:
                sample = sample_of(topic, decode(entry.data, topic.kind))
            except MessageError:
                continue
            if sample is not None:
                yield sample


def calibrate(
    samples: Sequence[Sample],
    lidars: Sequence[MountedLidar],
    params: OdometryConfig,
    own: Sequence[OwnPart] = (),
) -> tuple[list[Found], tuple[OwnPart, ...]]:
    """Mounts and clocks of `lidars` from the samples of a motion; parts of the robot, the known ones of `own` and
    those seen in the motion. Raises CalibrationError if the samples say too little."""
    mounted = {lidar.name: lidar for lidar in lidars}
    late: dict[LidarName, float] = dict.fromkeys(mounted, 0.0)
    for _ in range(PASS_COUNT):
        odometry = LidarInertialOdometry(params, {name: lidar.mount for name, lidar in mounted.items()}, own)
        scans = 0
        for sample in samples:
            if isinstance(sample, ImuSample):
                odometry.add_imu(sample)
            elif isinstance(sample, JointSample):
                odometry.add_joints(sample)
            elif sample.name in late:
                odometry.add_scan(replace(sample, stamp=sample.stamp + round(late[sample.name] * NS)))
            scans += sum(bool(scan.clouds) for scan in odometry.poll())
        if scans < NEEDED_SCANS:
            raise CalibrationError(
                f"only {scans} scans were registered: the robot must rest for a second, then move, with "
                "LiDAR, IMU and joints"
            )
        clocks = {fit.name: fit for fit in odometry.calibration.fits()}
        fits = odometry.calibration.mounts()
        for name, fit in fits.items():
            late[name] += clocks[name].offset
            mounted[name] = replace(mounted[name], mount=corrected(mounted[name].mount, fit.turn, fit.place))
    found = [
        Found(mounted[n], late[n], clocks[n].offset_sigma, fit.turn_sigma, fit.place_sigma)
        for n, fit in fits.items()
    ]
    return found, (*own, *odometry.parts.found)


def corrected(mount: Extrinsics, turned: Array, place: Array) -> Extrinsics:
    """`mount` without an error of `turned` (3,) [rad] and `place` (3,) [m], axes of base_link."""
    q = np.array([0.0, 0.0, 0.0, 1.0])
    turn(q, *-turned)
    x, y, z = (np.array(mount.translation) - place).tolist()
    return Extrinsics((x, y, z), rpy_of(rotation(q) @ rotation_rpy(*mount.rpy)))


def as_yaml(found: Sequence[Found], configured: Sequence[float] = (), parts: Sequence[OwnPart] = ()) -> str:
    """YAML for `--config`; its comments tell one standard deviation. `configured`: present time_offset [s] of each
    LiDAR; `parts` of the robot."""
    lines = ["lidars:"]
    before = configured or [0.0] * len(found)
    for f, old in zip(found, before, strict=True):
        mount = f.lidar.mount
        place = ", ".join(f"{v:.4f}" for v in mount.translation)
        rpy = ", ".join(f"{v:.5f}" for v in mount.rpy)
        about = " ".join(f"{math.degrees(s):.2f}" for s in f.turn_sigma)
        along = " ".join(f"{1e3 * s:.1f}" if math.isfinite(s) else "as-configured" for s in f.place_sigma)
        lines += [
            f"  - name: {f.lidar.name}",
            f"    model: {f.lidar.model}",
            f"    # 1 sigma: x y z {along} mm; about x y z of base_link {about} deg",
            f"    mount: {{translation: [{place}], rpy: [{rpy}]}}",
            f"    time_offset: {old + f.offset:.4f}  # 1 sigma: {1e3 * f.offset_sigma:.1f} ms",
        ]
    lines += ["own_parts:  # what moves with the robot", *(f"  - {part}" for part in parts)] if parts else []
    return "\n".join(lines)
