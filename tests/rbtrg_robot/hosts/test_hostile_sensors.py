"""What a driver can send wrong, on the wire: odometry and map count it, say so, and go on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hal.lidar import LIDARS
from hal.types import NS, GroundTruth, ImuSample, JointSample, LidarScan, Sample
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import build_stages
from rbtrg_robot.hosts.sync import SyncHost
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import cloud_msg, imu_msg, joint_msg, odometry_msg, scan_msg
from rbtrg_robot.wire.messages import decode, encode, stamp_of
from tests.rbtrg_robot.hearsay import map_offset
from tools.synthetic import arena_run

BAD = range(12, 15)
"""Scans that are spoiled; those before and after are sound."""
Messages = list[tuple[Topic, Any]]


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    """Two and a half seconds, from rest into motion."""
    run = replace(arena_run("xt16", duration=2.6, seed=5), lidar=LIDARS["xt16"].decimated(8))
    return [s for s in run.samples() if not isinstance(s, GroundTruth)]


def message(sample: Sample) -> tuple[Topic, Any]:
    """A fresh message on its topic."""
    if isinstance(sample, ImuSample):
        return t.IMU, imu_msg(sample)
    if isinstance(sample, JointSample):
        return t.JOINTS, joint_msg(sample)
    assert isinstance(sample, LidarScan)
    return t.POINTS, scan_msg(sample)


class Pipeline:
    """Odometry and elevation wired as in the stack, fed from the wire."""

    def __init__(self) -> None:
        config = load(None, [], scene="flat", map_file="")
        self.newest: dict[Topic, Any] = {}
        self.stamps: list[int] = []
        self.reasons: list[str] = []
        self.healths: list[str] = []
        self.stages = build_stages(config, ["odometry", "elevation"])
        self.host = SyncHost(self.stages, self._hear)

    def _hear(self, topic: Topic, payload: bytes, now: int) -> None:
        heard = self.newest[topic] = decode(payload, topic.kind)
        if topic is t.ODOM:
            self.stamps.append(stamp_of(heard))
        elif topic is t.ODOM_HEALTH:
            self.reasons.append(heard.reason)
            self.healths.append(heard.health)

    def feed(self, stream: Messages) -> None:
        self.host.tick(max(stamp_of(stream[0][1]), 0))
        for topic, m in stream:
            self.host.inject(topic, m)
            self.host.tick(max(stamp_of(m), 0))

    @property
    def counters(self) -> dict[str, int]:
        health = self.newest[t.ODOM_HEALTH]
        return dict(zip(health.counter, (int(v) for v in health.count), strict=True))

    def well(self) -> None:
        """Position and map are what a clean run gives."""
        assert self.newest[t.ODOM_HEALTH].health == "good"
        p = self.newest[t.ODOM].pose.pose.position
        assert abs(p.y) < 0.3
        assert -0.1 < p.x < 1.0
        assert self.newest[t.MAP_STATUS].known_cells > 3000
        assert self.newest[t.MAP_STATUS].scans > 12


@pytest.mark.parametrize(
    "quaternion", [(0.0, 0.0, 0.0, math.nan), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 7.0)]
)
def test_what_is_handed_to_a_restarted_process_may_be_broken(
    samples: list[Sample], quaternion: tuple[float, ...]
) -> None:
    """The supervisor hands on the newest messages of before the death: a broken one must not end each process that
    follows."""
    pipeline = Pipeline()
    (odometry, _), (elevation, _) = pipeline.stages.values()
    nowhere = math.nan if quaternion[3] == 0.0 else 0.0
    odometry.on(t.TF_STATIC, map_offset(math.nan))
    odometry.on(t.ODOM, odometry_msg(5, (nowhere, 0.0, 0.4), quaternion, np.zeros(3), np.zeros(3)))
    ring = np.linspace(0.0, 6.0, 2000)
    wall = np.column_stack([3 * np.cos(ring), 3 * np.sin(ring), ring / 6])
    odometry.on(t.CLOUD, cloud_msg(5, "base_link", wall.astype(np.float32)))
    elevation.on(t.MAP_STATUS, t.MAP_STATUS.kind(height_correction=math.nan))
    pipeline.feed([message(s) for s in samples])
    if quaternion[3] == 7.0:  # sound but for its length: no wall of the arena is where it was
        assert pipeline.newest[t.ODOM_HEALTH].health == "lost"
        return
    pipeline.well()
    (offset, *_) = [x for x in pipeline.newest[t.TF_STATIC].transforms if x.child_frame_id == "odom"]
    assert math.isfinite(offset.transform.translation.x)
    assert math.isfinite(pipeline.newest[t.MAP_STATUS].height_correction)


def spoil(samples: list[Sample], change: Callable[[LidarScan], list[Any]]) -> Messages:
    """The stream with the scans in BAD replaced by what `change` makes of them."""
    stream: Messages = []
    scans = 0
    for s in samples:
        if isinstance(s, LidarScan):
            scans += 1
            stream += [(t.POINTS, m) for m in (change(s) if scans in BAD else [scan_msg(s)])]
        else:
            stream.append(message(s))
    return stream


def edited(scan: LidarScan, field: str, value: float, every: int = 1) -> Any:
    points = scan.points.copy()
    points[field][::every] = value
    return scan_msg(LidarScan(scan.stamp, points))


def laid_out(scan: LidarScan, **changes: Any) -> Any:
    m = decode(encode(scan_msg(scan)), t.POINTS.kind)
    for name, value in changes.items():
        setattr(m, name, value)
    return m


CASES: dict[str, tuple[str, Callable[[LidarScan], list[Any]]]] = {
    "empty": ("scan_empty", lambda s: [scan_msg(LidarScan(s.stamp, s.points[:0]))]),
    "nan": ("scan_points_not_finite", lambda s: [edited(s, "y", np.nan, 3)]),
    "all nan": ("scan_no_usable_points", lambda s: [edited(s, "x", np.nan)]),
    "duplicated": ("scan_duplicate", lambda s: [scan_msg(s), scan_msg(s)]),
    "backward": ("scan_backward", lambda s: [scan_msg(s), scan_msg(replace(s, stamp=s.stamp - NS // 2))]),
    "one wrong stamp": (
        "scan_strange_stamp",
        lambda s: [scan_msg(replace(s, stamp=s.stamp % 7 * NS)), scan_msg(s)],
    ),
    "times out of the sweep": ("scan_points_out_of_time", lambda s: [edited(s, "time", -3.0, 30)]),
    "times of no sweep": ("scan_times", lambda s: [edited(s, "time", -3.0, 3)]),
    "ten times the points": (
        "scan_too_many_points",
        lambda s: [scan_msg(LidarScan(s.stamp, np.repeat(s.points, 60)))],
    ),
    "no fields": ("malformed", lambda s: [laid_out(s, fields=[])]),
    "other point size": ("malformed", lambda s: [laid_out(s, point_step=16)]),
    "no point size": ("malformed", lambda s: [laid_out(s, point_step=0)]),
    "big-endian": ("malformed", lambda s: [laid_out(s, is_bigendian=True)]),
}


@pytest.mark.parametrize("case", CASES)
def test_spoiled_scans_are_counted_reported_and_survived(samples: list[Sample], case: str) -> None:
    counter, change = CASES[case]
    pipeline = Pipeline()
    pipeline.feed(spoil(samples, change))
    assert pipeline.counters[counter] >= len(BAD)
    assert pipeline.stamps == sorted(set(pipeline.stamps))
    pipeline.well()


@pytest.mark.parametrize("time", [0.0, 0.05])
def test_equal_point_times_never_reach_the_library(samples: list[Sample], time: float) -> None:
    """KISS-ICP aborts the process on them; the scans are used all the same."""
    pipeline = Pipeline()
    pipeline.feed(spoil(samples, lambda s: [edited(s, "time", time)]))
    pipeline.well()


def test_clouds_without_a_time_per_point_are_told(samples: list[Sample]) -> None:
    pipeline = Pipeline()
    pipeline.feed(spoil(samples, lambda s: [edited(s, "time", 0.0)]))
    told = zip(pipeline.healths, pipeline.reasons, strict=True)
    healths = [health for health, reason in told if "carry no time" in reason]
    assert healths == ["degraded"] * len(BAD)
    pipeline.well()


def test_a_time_that_is_not_a_number_costs_its_points(samples: list[Sample]) -> None:
    pipeline = Pipeline()
    pipeline.feed(spoil(samples, lambda s: [edited(s, "time", np.nan, 3)]))
    assert pipeline.counters["scan_points_not_finite"] > 100
    pipeline.well()


def test_a_cut_off_cloud_counts_as_far_as_it_goes(samples: list[Sample]) -> None:
    pipeline = Pipeline()
    pipeline.feed(spoil(samples, lambda s: [laid_out(s, data=scan_msg(s).data[:20_001])]))
    pipeline.well()


def test_bad_inertial_and_joint_messages_are_counted(samples: list[Sample]) -> None:
    pipeline = Pipeline()
    stream: Messages = []
    for k, s in enumerate(samples):
        topic, m = message(s)
        stream.append((topic, m))
        if k % 40 == 7:
            topic, m = message(s)
            if topic is t.IMU:
                m.angular_velocity.x = float("nan")
            elif topic is t.JOINTS:
                m.position = m.position[:5]
            stream.append((topic, m))
    joints = [m for topic, m in (message(s) for s in samples) if topic is t.JOINTS][:4]
    for m, part in zip(joints, ("position", "velocity", "effort", "name"), strict=True):
        setattr(m, part, getattr(m, part)[:0])
        stream.insert(400, (t.JOINTS, m))
    pipeline.feed(stream)
    assert pipeline.counters["imu_impossible"] >= 5
    assert pipeline.counters["malformed"] >= 4
    assert pipeline.newest[t.MAP_STATUS].refused >= 4
    pipeline.well()


@pytest.mark.parametrize("offset", [1_790_000_000 * NS, -6 * NS])
def test_a_source_clock_that_is_set_is_followed(samples: list[Sample], offset: int) -> None:
    """A clock that booted in 1970 and gets the time, and one put back by six seconds."""
    pipeline = Pipeline()
    when = samples[0].stamp + 3 * NS // 2
    stream = [message(replace(s, stamp=s.stamp + offset) if s.stamp > when else s) for s in samples]
    pipeline.feed(stream)
    assert any("clock was set" in r for r in pipeline.reasons)
    assert pipeline.stamps[-1] > when + offset
    assert pipeline.newest[t.ODOM_HEALTH].health != "lost"
    elevation = pipeline.host.stage("elevation")
    assert elevation.map.scans > 12
    assert elevation.map.stamp == pipeline.stamps[-1]
    statuses = [m for now in (0, NS) for _, m in elevation.tick(when + offset + now)]
    assert len(statuses) == 2  # none waits for the old clock's time


def test_a_pose_that_is_not_finite_is_refused_by_the_map(samples: list[Sample]) -> None:
    pipeline = Pipeline()
    pipeline.feed([message(s) for s in samples])
    last = [m for topic, m in (message(s) for s in samples) if topic is t.JOINTS][-1]
    last.header.stamp.sec += 3
    pipeline.host.inject(t.JOINTS, last)  # no scan waits for the wheels any more
    pipeline.host.tick(samples[-1].stamp + NS)
    before = pipeline.newest[t.MAP_STATUS]
    odom, cloud, head = (pipeline.newest[topic] for topic in (t.ODOM, t.CLOUD, t.HEAD_CLOUD))
    odom.header.stamp.sec = cloud.header.stamp.sec = head.header.stamp.sec = odom.header.stamp.sec + 1
    odom.pose.pose.position.x = float("nan")
    for topic, m in ((t.ODOM, odom), (t.CLOUD, cloud), (t.HEAD_CLOUD, head)):
        pipeline.host.inject(topic, m)
    pipeline.host.tick(samples[-1].stamp + 5 * NS)
    after = pipeline.newest[t.MAP_STATUS]
    assert after.refused == before.refused + 1
    assert after.known_cells == before.known_cells
