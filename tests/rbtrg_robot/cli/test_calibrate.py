"""`rbtrg-robot calibrate lidar`: wrong mounts and clocks come back right, within the certainty that is told."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hal.robots.go2w.facts import L1_MOUNT, XT16_MOUNT
from hal.rotation import rotation_rpy, rotation_vector, rpy_of
from hal.types import NS, Extrinsics, ImuSample, JointSample, LidarName, LidarScan, MountedLidar, Sample
from mapping.odometry.types import OdometryConfig
from rbtrg_robot import topics as t
from rbtrg_robot.cli.calibrate import COURSE, orders
from rbtrg_robot.cli.main import app
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.calibrate import HEARD, Found, calibrate, sample_of
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.log.read import CONFIG
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.wire.convert import imu_msg, joint_msg, scan_msg
from rbtrg_robot.wire.messages import decode, encode
from tools.bench.perception.offset import two_lidars

RIGHT: dict[LidarName, Extrinsics] = {"main": XT16_MOUNT, "head": L1_MOUNT}
LATE = 0.015
ANTENNA = (-0.3, 0.28, 0.0), (-0.25, 0.33, 0.2)
"""Two corners [m], base_link."""
SYSTEMATIC = 0.003
"""[s] Of the simulator's clock."""


def turned(
    mount: Extrinsics, turn: tuple[float, float, float], place: tuple[float, float, float]
) -> Extrinsics:
    """`mount` off by `turn` [deg] and `place` [m], base_link."""
    x, y, z = np.add(mount.translation, place).tolist()
    return Extrinsics((x, y, z), rpy_of(rotation_rpy(*np.radians(turn)) @ rotation_rpy(*mount.rpy)))


WRONG = (
    MountedLidar("main", "xt16", turned(XT16_MOUNT, (1.0, -1.0, 1.0), (0.0, 0.0, 0.01))),
    MountedLidar("head", "l1", turned(L1_MOUNT, (-1.0, 1.0, 1.0), (0.01, -0.01, 0.01))),
)


def late(samples: Sequence[Sample]) -> list[Sample]:
    """The main LiDAR's stamps lie before the truth."""
    return [
        replace(s, stamp=s.stamp - round(LATE * NS)) if isinstance(s, LidarScan) and s.name == "main" else s
        for s in samples
    ]


def with_antenna(samples: Sequence[Sample]) -> list[Sample]:
    """The main LiDAR sees an antenna that nobody told of, 5 cm thick."""
    rng = np.random.default_rng(2)
    out: list[Sample] = []
    for s in samples:
        if isinstance(s, LidarScan) and s.name == "main":
            s = replace(s, points=s.points.copy())
            some = slice(None, None, len(s.points) // 60)
            seen = rng.uniform(*ANTENNA, (len(s.points[some]), 3)) - RIGHT["main"].translation
            local = seen @ rotation_rpy(*RIGHT["main"].rpy)
            for axis, values in zip("xyz", local.T, strict=True):
                s.points[axis][some] = values
        out.append(s)
    return out


def within(found: Found, mount: Extrinsics, offset: float) -> None:
    """Within three of the standard deviations that are told, which are small enough to be of use."""
    got = found.lidar.mount
    turn = rotation_vector(rotation_rpy(*got.rpy) @ rotation_rpy(*mount.rpy).T)
    assert (np.abs(turn) < 3.0 * found.turn_sigma).all()
    assert (np.abs(np.subtract(got.translation, mount.translation)) < 3.0 * found.place_sigma).all()
    assert abs(found.offset - offset) < 3.0 * found.offset_sigma + SYSTEMATIC
    assert found.turn_sigma[:2].max() < math.radians(0.2)
    assert found.turn_sigma[2] < math.radians(0.3)
    assert found.place_sigma[2] < 0.005
    assert found.offset_sigma < 0.002


def test_a_log_of_a_motion_gives_mounts_clock_and_parts(tmp_path: Path) -> None:
    _, samples = two_lidars(8.0, 3)
    path = tmp_path / "drive.mcap"
    lidars = [{"name": x.name, "model": x.model, "mount": x.mount} for x in WRONG]
    config = StackConfig.model_validate({"lidars": lidars})
    with LogWriter(path, {}, {CONFIG: config.to_yaml().encode()}) as log:
        for s in with_antenna(late(samples)):
            assert isinstance(s, ImuSample | JointSample | LidarScan)
            if isinstance(s, LidarScan):
                log.write(t.SWEEPS[s.name], encode(scan_msg(s)), s.stamp, s.stamp)
            elif isinstance(s, ImuSample):
                log.write(t.IMU, encode(imu_msg(s)), s.stamp, s.stamp)
            else:
                log.write(t.JOINTS, encode(joint_msg(s)), s.stamp, s.stamp)
    done = CliRunner().invoke(app, ["calibrate", "lidar", "--log", str(path)])
    assert done.exit_code == 0, done.output
    (tmp_path / "lidars.yaml").write_text(done.stdout)
    (part,) = load(tmp_path / "lidars.yaml").own_parts
    assert (np.array(part.low) < ANTENNA[0]).all()
    assert (np.array(part.high) > ANTENNA[1]).all()
    found = {lidar.name: lidar for lidar in load(tmp_path / "lidars.yaml").lidars}
    for name, right in RIGHT.items():
        mount = found[name].mount
        assert mount is not None
        turn = rotation_vector(rotation_rpy(*mount.rpy) @ rotation_rpy(*right.rpy).T)
        assert np.degrees(np.abs(turn)).max() < 0.4
        assert mount.translation == pytest.approx(right.translation, abs=0.006)
    assert found["main"].time_offset == pytest.approx(LATE, abs=0.001)
    assert found["head"].time_offset == pytest.approx(0.0, abs=0.003)
    assert "# 1 sigma: x y z as-configured as-configured" in done.stdout


def test_a_log_that_says_too_little_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    with LogWriter(path, {}, {CONFIG: StackConfig().to_yaml().encode()}):
        pass
    done = CliRunner().invoke(app, ["calibrate", "lidar", "--log", str(path)])
    assert done.exit_code != 0
    assert "only 0 scans were registered" in str(done.exception)


@pytest.mark.campaign
def test_the_course_in_simulated_physics_gives_mounts_and_clock() -> None:
    samples: list[Sample] = []

    def hear(topic: t.Topic, payload: bytes, _now: int) -> None:
        if topic in HEARD:
            sample = sample_of(topic, decode(payload, topic.kind))
            assert sample is not None
            samples.append(sample)

    with Lockstep(load(None, [], scene="yard")) as stack:
        stack.host.listen(hear)
        stack.wait_ready()
        began, length = stack.now, sum(part.lasts for part in COURSE)
        while (after := (stack.now - began) / NS) < length:
            for topic, message in orders(after, stack.now):
                stack.host.inject(topic, message)
            stack.run(0.05)
    for found in calibrate(late(samples), WRONG, OdometryConfig())[0]:
        within(found, RIGHT[found.lidar.name], LATE if found.lidar.name == "main" else 0.0)
