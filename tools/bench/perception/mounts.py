"""LiDARs that are mounted otherwise than configured: what it costs, whether it is told, and what `calibrate lidar`
makes of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np

from hal.lidar.spec import LIDARS
from hal.rotation import rotation_rpy, rotation_vector, rpy_of
from hal.types import NS, Array, Extrinsics, LidarName, MountedLidar
from mapping.odometry.pipeline import OdometryConfig
from rbtrg_robot.hosts.calibrate import calibrate
from tools.bench.perception.map import EngineMap
from tools.bench.perception.odometry import Errors, Track, errors, matrix
from tools.bench.perception.offset import delayed, driven, two_lidars
from tools.bench.report import Report

SIGN_DRAWS = 3
"""Of signs of the errors of 1 deg and 1 cm."""
STAMP_DELAY = 0.015
"""Of the main LiDAR's stamps, for the calibration [s]."""
TOLD_SECONDS = 8.0
"""Driven until a mount that is off by 2 deg or 2 cm must have been told."""
MOUNTS: dict[LidarName, tuple[str, Extrinsics]] = {
    "main": ("xt16", LIDARS["xt16"].mount),
    "head": ("l1", LIDARS["l1"].mount),
}
VISIBLE = {"main": np.array([0.0, 0.0, 1.0]), "head": np.ones(3)}
"""Axes along which an error of the place shows."""
NO_DELAY: dict[LidarName, float] = {"main": 0.0, "head": 0.0}


def wrong(mount: Extrinsics, turn: Array, place: Array) -> Extrinsics:
    """`mount` off by `turn` (3,) [rad] about the axes of base_link and `place` (3,) [m]."""
    x, y, z = np.add(mount.translation, place).tolist()
    return Extrinsics((x, y, z), rpy_of(rotation_rpy(*turn) @ rotation_rpy(*mount.rpy)))


def draw(random: np.random.Generator, degrees: float, metres: float) -> dict[LidarName, Extrinsics]:
    """Both mounts off about and along every axis that shows, signs at random."""
    return {
        name: wrong(
            mount,
            np.radians(degrees) * random.choice([-1.0, 1.0], 3),
            metres * VISIBLE[name] * random.choice([-1.0, 1.0], 3),
        )
        for name, (_, mount) in MOUNTS.items()
    }


def one_by_one(degrees: float, metres: float) -> Iterator[tuple[str, Mapping[LidarName, Extrinsics]]]:
    """One mount off about or along one axis; what was done to it in words."""
    right = {name: mount for name, (_, mount) in MOUNTS.items()}
    for name, axis, sign in product(MOUNTS, range(3), (-1.0, 1.0)):
        unit = sign * np.eye(3)[axis]
        turned = wrong(right[name], np.radians(degrees) * unit, np.zeros(3))
        yield f"{name} {('roll', 'pitch', 'yaw')[axis]}", right | {name: turned}
        if VISIBLE[name][axis]:
            yield f"{name} {'xyz'[axis]}", right | {name: wrong(right[name], np.zeros(3), metres * unit)}


def rows(report: Report, seconds: float, seed: int) -> None:
    """Rows `mounts.*`; the baselines are those of right mounts."""
    run, samples = two_lidars(seconds, seed)

    def cost(mounts: Mapping[LidarName, Extrinsics]) -> tuple[Errors, float, int]:
        """Errors of the motion, of the map [mm], scans at which something was to be mended."""
        track, drawn, told = Track(cpu=[0.0]), EngineMap(run), 0
        for scan in driven(samples, OdometryConfig(), mounts, NO_DELAY):
            track.stamps.append(scan.stamp)
            track.poses.append(matrix(scan.position, scan.orientation))
            drawn.take(scan)
            told += bool(scan.fault)
        return errors(run, track), drawn.rmse_mm(), told

    right, even, alarms = cost({name: mount for name, (_, mount) in MOUNTS.items()})
    report.add("mounts.right.alarms", alarms, "scans", 0.0)
    random = np.random.default_rng(seed)
    costs, turns, places, clocks = [], [], [], []
    for _ in range(SIGN_DRAWS):
        mounts = draw(random, 1.0, 0.01)
        costs.append(cost(mounts))
        lidars = [MountedLidar(name, MOUNTS[name][0], mount) for name, mount in mounts.items()]
        late: dict[LidarName, float] = {"main": STAMP_DELAY, "head": 0.0}
        for found in calibrate([delayed(s, late) for s in samples], lidars, OdometryConfig())[0]:
            got, wanted = found.lidar.mount, MOUNTS[found.lidar.name][1]
            turns.append(
                rotation_vector(rotation_rpy(*got.rpy) @ rotation_rpy(*wanted.rpy).T) / found.turn_sigma
            )
            places.append(np.subtract(got.translation, wanted.translation) / found.place_sigma)
            clocks.append((found.offset - late[found.lidar.name]) / found.offset_sigma)
    report.add("mounts.1deg_1cm.rpe_mm", max(e.rpe_mm for e, _, _ in costs), "mm", 12.0, right.rpe_mm)
    report.add("mounts.1deg_1cm.drift_pct", max(e.drift_pct for e, _, _ in costs), "%", None, right.drift_pct)
    report.add("mounts.1deg_1cm.map_rmse_mm", max(m for _, m, _ in costs), "mm", None, even)
    for key, off in (("turn", turns), ("place", places), ("clock", clocks)):
        report.add(f"mounts.1deg_1cm.calibrated_{key}_off", float(np.abs(off).max()), "sigma", 3.0)
    soon = [s for s in samples if s.stamp < samples[0].stamp + TOLD_SECONDS * NS]
    told = [
        (what, list(driven(soon, OdometryConfig(), mounts, NO_DELAY))[-1].fault)
        for what, mounts in one_by_one(2.0, 0.02)
    ]
    report.rate("mounts.2deg_2cm.told", sum(bool(words) for _, words in told), len(told), 1.0)
    named = sum(what.split()[1] in words for what, words in told)
    report.rate("mounts.2deg_2cm.axis_named", named, len(told))
