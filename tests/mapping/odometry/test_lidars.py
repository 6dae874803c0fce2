"""Two LiDARs on one robot: both are registered, the main one makes the map, and the other takes over where the main one
is silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hal.lidar import LIDARS
from hal.robots.go2w.facts import L1_MOUNT, XT16_MOUNT
from hal.rotation import rotation
from hal.types import NS, GroundTruth, ImuSample, JointSample, LidarScan, Sample
from mapping.odometry.health import Health
from mapping.odometry.pipeline import LidarInertialOdometry
from mapping.odometry.types import ScanOdometry
from tests.mapping.odometry.test_intake import feed
from tools.synthetic import SyntheticRun, arena_run

SECONDS = 6.0


@pytest.fixture(scope="module")
def recorded() -> tuple[SyntheticRun, list[Sample]]:
    """Figure-eight with a pitching trunk, both LiDARs, in order of arrival; their sweeps do not end together."""
    run = replace(arena_run("xt16", duration=SECONDS, seed=3), lidar=LIDARS["xt16"].decimated(4))
    head = replace(run, lidar=LIDARS["l1"])
    samples = [s for s in run.samples() if not isinstance(s, GroundTruth)]
    samples += [replace(s, name="head") for s in head.samples() if isinstance(s, LidarScan)]
    return run, in_order(samples)


@pytest.fixture(scope="module")
def both(recorded: tuple[SyntheticRun, list[Sample]]) -> list[ScanOdometry]:
    return driven(recorded[1])


def in_order(samples: list[Sample], head_late: int = 0) -> list[Sample]:
    """By arrival: a scan comes when its sweep ends, one of the head LiDAR `head_late` [ns] after that."""

    def arrival(s: Sample) -> int:
        return s.stamp + NS // 10 + head_late * (s.name == "head") if isinstance(s, LidarScan) else s.stamp

    return sorted(samples, key=arrival)


def driven(samples: list[Sample]) -> list[ScanOdometry]:
    return feed(LidarInertialOdometry(mounts={"main": XT16_MOUNT, "head": L1_MOUNT}), samples)


def off(run: SyntheticRun, scan: ScanOdometry) -> float:
    """Horizontal error [m]; the run begins at the origin of its frame."""
    position, orientation = run.truth(np.array([run.start_stamp, scan.stamp]))
    return float(
        np.linalg.norm((rotation(orientation[0]).T @ (position[1] - position[0]))[:2] - scan.position[:2])
    )


def test_each_lidar_has_a_cloud_at_the_stamp_of_the_pose(
    recorded: tuple[SyntheticRun, list[Sample]], both: list[ScanOdometry]
) -> None:
    run, _ = recorded
    assert len(both) >= 50
    for scan in both[5:]:
        assert set(scan.clouds) == {"main", "head"}
        position, orientation = run.truth(scan.stamp)
        world = scan.clouds["head"] @ rotation(orientation[0]).T + position[0]
        ground = world[np.abs(world[:, 2]) < 0.06]
        assert len(ground) > 300
        assert np.abs(ground[:, 2]).mean() < 0.02


def test_a_head_lidar_whose_clock_is_wrong_leaves_the_pose_to_the_main_one(
    recorded: tuple[SyntheticRun, list[Sample]], both: list[ScanOdometry]
) -> None:
    _, samples = recorded
    alone = driven([s for s in samples if not (isinstance(s, LidarScan) and s.name == "head")])
    assert not any("head" in s.clouds for s in alone)
    wrong = [
        replace(s, stamp=s.stamp - 30_000_000) if isinstance(s, LidarScan) and s.name == "head" else s
        for s in samples
    ]
    for other, near in ((both, 0.003), (driven(in_order(wrong)), 0.01)):
        assert [s.stamp for s in other] == [s.stamp for s in alone]
        assert max(np.linalg.norm(a.position - b.position) for a, b in zip(other, alone, strict=True)) < near
        assert any((a.position != b.position).any() for a, b in zip(other, alone, strict=True))


def test_a_late_head_cloud_changes_nothing(
    recorded: tuple[SyntheticRun, list[Sample]], both: list[ScanOdometry]
) -> None:
    late = driven(in_order(recorded[1], head_late=60_000_000))
    assert len(late) >= len(both) - 1
    for a, b in zip(both, late, strict=False):
        assert a.stamp == b.stamp
        assert all(a.clouds[name].tobytes() == b.clouds[name].tobytes() for name in ("main", "head"))


@pytest.mark.parametrize(
    ("repeats", "words"), [(False, "the main LiDAR is silent"), (True, "the main LiDAR repeats its sweep")]
)
def test_the_head_lidar_takes_over_where_the_main_one_is_silent_or_repeats_itself(
    recorded: tuple[SyntheticRun, list[Sample]], repeats: bool, words: str
) -> None:
    run, samples = recorded
    begin = samples[0].stamp
    gap = begin + 2 * NS, begin + 4 * NS
    spoiled: list[Sample] = []
    for s in samples:
        if not (isinstance(s, LidarScan) and s.name == "main"):
            spoiled.append(s)
        elif not gap[0] <= s.stamp < gap[1]:
            last = s
            spoiled.append(s)
        elif repeats:
            spoiled.append(replace(last, stamp=s.stamp))
    scans = driven(spoiled)
    taken = [s for s in scans if gap[0] + 0.7 * NS < s.stamp < gap[1]]
    assert len(taken) >= 11
    for scan in taken:
        assert set(scan.clouds) == {"head"}
        assert scan.health is Health.DEGRADED
        assert words in scan.reason
        assert "the head LiDAR takes its place" in scan.reason
    assert max(off(run, s) for s in scans) < 0.06
    assert [s.health for s in scans[-5:]] == [Health.GOOD] * 5
    assert set(scans[-1].clouds) == {"main", "head"}


def test_a_silent_head_lidar_is_not_waited_for(recorded: tuple[SyntheticRun, list[Sample]]) -> None:
    _, samples = recorded
    silent = samples[0].stamp + 2 * NS
    odometry = LidarInertialOdometry(mounts={"main": XT16_MOUNT, "head": L1_MOUNT})
    delay = []
    for sample in samples:
        if isinstance(sample, LidarScan) and (sample.name == "main" or sample.stamp < silent):
            odometry.add_scan(sample)
        elif isinstance(sample, ImuSample):
            odometry.add_imu(sample)
            delay += [(s.stamp, sample.stamp - s.stamp) for s in odometry.poll()]
        elif isinstance(sample, JointSample):
            odometry.add_joints(sample)
    late = [d for stamp, d in delay if stamp > silent + NS]
    assert len(late) > 25
    assert max(late) < 30_000_000
