"""Clouds of a log by its sweeps and poses are those that its odometry made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hal.types import Array
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.map_build import build
from rbtrg_robot.hosts.swept import Swept
from rbtrg_robot.log.read import read_run
from rbtrg_robot.wire.convert import cloud_points
from rbtrg_robot.wire.messages import decode, stamp_of

SETTINGS = ("sim.lidar_step=8", "elevation.resolution=0.08", "recorder.profile=full")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot turns and drives off, at full speed."""
    path = tmp_path_factory.mktemp("swept") / "run.mcap"
    config = load(None, SETTINGS, scene="yard")
    with Lockstep(config, Lockstep.open_log(config, path)) as stack:
        stack.wait_ready()
        x, y, _ = config.start_pose()
        stack.send_goal(x + 1.5, y + 1.0)
        stack.run(4.0)
    return path


def test_clouds_are_those_of_the_odometry(log: Path) -> None:
    config = load(None, SETTINGS, scene="yard")
    swept, made = Swept(config), dict[int, dict[str, Array]]()
    told, healths = dict[int, dict[str, Array]](), list[msg.OdometryHealth]()
    names = {topic.name: name for name, topic in t.CLOUDS.items()}
    sweeps = {topic.name: name for topic, name in swept.topics.items()}
    speeds = []
    for entry in read_run(log, raw=True):
        if entry.topic in sweeps:
            swept.sweep(sweeps[entry.topic], entry.data, entry.type)
        elif entry.topic == t.ODOM_HEALTH.name:
            healths.append(decode(entry.data, t.ODOM_HEALTH.kind))
            swept.health(healths[-1])
        elif entry.topic == t.ODOM.name:
            odom = decode(entry.data, t.ODOM.kind)
            swept.pose(odom)
            made[stamp_of(odom)] = dict(swept.clouds())
            speeds.append((odom.twist.twist.linear.x, odom.twist.twist.angular.z))
        elif entry.topic in names:
            cloud = decode(entry.data, t.CLOUD.kind)
            told.setdefault(stamp_of(cloud), {})[names[entry.topic]] = cloud_points(cloud)
    fastest, turned = np.abs(speeds).max(axis=0)
    assert fastest > 0.3
    assert turned > 0.3
    assert len(told) > 30
    off = []
    for stamp, clouds in told.items():
        for name, cloud in clouds.items():
            assert len(made[stamp][name]) == len(cloud)
            if len(cloud):
                off.append(np.linalg.norm(made[stamp][name] - cloud, axis=1))
    median, most = np.quantile(np.concatenate(off), (0.5, 0.95))
    assert median < 0.002, "a sweep takes a tenth of a second: as it was measured it is 20 mm off"
    assert most < 0.01


def test_a_map_by_sweeps_is_the_map_by_clouds(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_clouds = build([log], tmp_path / "clouds.npz")
    monkeypatch.setattr(t, "CLOUD", t.MAP_CLOUD)  # a log without clouds
    by_sweeps = build([log], tmp_path / "sweeps.npz")
    (one,), (other,) = by_clouds.record["runs"], by_sweeps.record["runs"]
    assert one["kept"] == other["kept"] > 5
    assert by_sweeps.record["known_cells"] == pytest.approx(by_clouds.record["known_cells"], rel=0.01)
    assert by_sweeps.stamp == by_clouds.stamp
    assert by_sweeps.pose == pytest.approx(by_clouds.pose, abs=1e-3)
    early = by_clouds.record["keyframes"][0]["stamp_ns"] + 10**9
    part = build([log], tmp_path / "part.npz", until=early)  # the log grew meanwhile
    assert 0 <= early - part.stamp < 5 * 10**8
