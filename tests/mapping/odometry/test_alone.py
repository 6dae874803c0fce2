"""Odometry that lacks a sensor: it tracks with what is left, and says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hal.lidar import LIDARS
from hal.types import NS, ImuSample, JointSample, LidarScan, Sample
from mapping.odometry.alone import LidarAlone, WheelsAlone
from mapping.odometry.health import Health
from mapping.odometry.types import OdometryConfig, ScanOdometry
from tests.mapping.odometry.test_pipeline import error, rpe
from tools.synthetic import SyntheticRun, arena_run

SECONDS = 6.0


@pytest.fixture(scope="module")
def recorded() -> tuple[SyntheticRun, list[Sample]]:
    run = replace(arena_run("xt16", duration=SECONDS, seed=5), lidar=LIDARS["xt16"].decimated(4))
    return run, list(run.samples())


def drive(odometry: LidarAlone | WheelsAlone, samples: list[Sample]) -> list[ScanOdometry]:
    scans = []
    for sample in samples:
        if isinstance(sample, ImuSample):
            odometry.add_imu(sample)
        elif isinstance(sample, JointSample):
            odometry.add_joints(sample)
        elif isinstance(sample, LidarScan):
            odometry.add_scan(sample)
        scans += odometry.poll()
    return scans


def test_lidar_alone_tracks_and_says_so(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    run, samples = recorded
    scans = drive(LidarAlone(OdometryConfig(), {"main": LIDARS["xt16"].mount}), samples)
    assert len(scans) >= SECONDS * 10 - 2
    millimetres, degrees = rpe(run, scans, 10)
    assert millimetres < 60.0
    assert degrees < 2.5
    assert error(run, scans, 0, -1)[0] < 0.15
    assert {s.health for s in scans} == {Health.DEGRADED}
    assert all("no IMU" in s.reason for s in scans)
    assert all(len(s.cloud) > 100 for s in scans)
    assert np.mean([s.linear[0] for s in scans[20:]]) > 0.2
    assert 0.05 <= scans[0].place_sigma <= scans[-1].place_sigma < 0.3
    assert error(run, scans, 0, -1)[0] < 3.0 * scans[-1].place_sigma


def test_a_scan_that_fits_nowhere_is_lost_and_not_mapped(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    _, samples = recorded
    odometry = LidarAlone(OdometryConfig(), {"main": LIDARS["xt16"].mount})
    scans = [s for s in samples if isinstance(s, LidarScan)][:8]
    drive(odometry, list(scans))
    mixed = scans[-1].points.copy()
    noise = np.random.default_rng(0).uniform(-3.0, 3.0, (len(mixed), 3))
    mixed["x"], mixed["y"], mixed["z"] = noise.T
    (found,) = drive(odometry, [LidarScan(scans[-1].stamp + NS // 10, mixed)])
    assert found.health is Health.LOST
    assert not found.clouds


def test_wheels_alone_go_on_without_a_lidar(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    run, samples = recorded
    scans = drive(
        WheelsAlone(OdometryConfig(), {"main": LIDARS["xt16"].mount}),
        [s for s in samples if not isinstance(s, LidarScan)],
    )
    assert len(scans) > SECONDS * 10 - 40
    way = run.path_length() * (scans[-1].stamp - scans[0].stamp) / (SECONDS * NS)
    assert error(run, scans, 0, -1)[0] < 0.1 * way
    assert {s.health for s in scans} == {Health.DEGRADED}
    assert all("no LiDAR" in s.reason for s in scans)
    sigma = [s.place_sigma for s in scans]
    assert sigma == sorted(sigma), "nothing tells where it is"
    assert 0.0 < sigma[0] < sigma[-1]


def test_speed_of_other_wheels_takes_the_place_of_joints() -> None:
    odometry = WheelsAlone(OdometryConfig(), {})
    poses = []
    for k in range(1200):
        stamp = NS + k * 5_000_000
        moving = k > 300
        odometry.add_imu(
            ImuSample(stamp, np.full(3, 1e-6 * k), np.array([1e-6 * k, 0.0, 9.81]))
        )  # a dead one repeats itself
        if k % 4 == 0:
            odometry.add_speed(stamp, np.array([0.5 * moving, 0.0, 0.0]))
        poses += odometry.poll()
    assert poses[-1].position[0] == pytest.approx(0.5 * (poses[-1].stamp - NS - 1.5 * NS) / NS, abs=0.1)
    assert poses[-1].linear[0] == pytest.approx(0.5, abs=0.02)


def test_silent_wheels_are_lost() -> None:
    odometry = WheelsAlone(OdometryConfig(), {})
    for k in range(400):
        stamp = NS + k * 5_000_000
        odometry.add_imu(
            ImuSample(stamp, np.full(3, 1e-6 * k), np.array([1e-6 * k, 0.0, 9.81]))
        )  # a dead one repeats itself
    last = odometry.poll()[-1]
    assert last.health is Health.LOST
    assert "wheels" in last.reason
