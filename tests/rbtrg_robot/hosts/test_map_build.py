"""`map build` on made-up runs: the loop closes, the files are there, and what cannot be is refused in one line."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from hal.lidar.spec import LIDARS
from hal.types import ImuSample, JointSample, LidarScan
from mapping.elevation import ElevationMap
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.main import app
from rbtrg_robot.config import ConfigError, load
from rbtrg_robot.hosts.map_build import build
from rbtrg_robot.log.read import CONFIG, LogError
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import imu_msg, joint_msg, scan_msg
from rbtrg_robot.wire.messages import encode, header, time_msg
from tools.closing import Drift, Drive, drifted, ring, way_through, write_log
from tools.synthetic import arena_run

STRONG = Drift(bend=math.radians(0.02), climb=0.004)
COARSE = ("elevation.resolution=0.08",)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene, corners = ring(half=(5.0, 3.5))
    truth = way_through(scene, corners, step=0.7)
    folder = tmp_path_factory.mktemp("run")
    write_log(folder / "run.mcap", Drive(scene, truth, drifted(truth, STRONG, 3)), COARSE)
    return folder


def test_a_run_becomes_a_map_with_its_loops_closed_and_one_from_elsewhere_is_left_out(
    run: Path, tmp_path: Path
) -> None:
    scene, corners = ring(half=(9.0, 2.0), seed=7)
    truth = way_through(scene, corners[:3], step=0.7)[:16]
    other, out = tmp_path / "other.mcap", tmp_path / "map.npz"
    write_log(other, Drive(scene, truth, drifted(truth, Drift(), 5)), COARSE)
    result = CliRunner().invoke(
        app, ["map", "build", str(run), str(other), "--out", str(out), "--drift", "6"]
    )
    assert result.exit_code == 3, result.output
    told = [line for line in result.stderr.splitlines() if line.endswith("%")]
    assert [line for line in told if line.endswith(": 0%")][:2] == ["run 1: 0%", "run 2: 0%"]
    assert {line.split(":")[0] for line in told} == {"run 1", "run 2", "loops", "map"}
    record = json.loads(out.with_suffix(".json").read_text())
    assert len(record["closed"]) >= 2
    assert f"{len(record['closed'])} loops closed, {len(record['refused'])} refused" in result.output
    assert all(loop["why"] in result.output for loop in record["refused"])
    assert record["moved_m"] > 0.2
    assert max(loop["residual_m"] for loop in record["closed"]) < 0.1
    assert Image.open(out.with_suffix(".png")).width > 100
    made = ElevationMap()
    assert made.load_prior(out) > 10_000
    assert len(made.cloud) > 200
    assert record["not_in_the_map"] == [str(other)]
    assert np.load(out)["tiles"].shape[1] == 2
    # the frame is that of the run: it starts in a corner of the ring
    assert (record["keyframes"][0]["x"], record["keyframes"][0]["y"]) == pytest.approx((-6.5, -5.0), abs=0.01)


def test_what_cannot_be_is_refused_before_it_is_begun(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"\.npz"):
        build([run], tmp_path / "map.png")
    with pytest.raises(ConfigError, match="no folder"):
        build([run], tmp_path / "none" / "map.npz")
    with pytest.raises(ConfigError, match="drift"):
        build([run], tmp_path / "map.npz", drift=math.nan)
    with LogWriter(tmp_path / "empty.mcap", {}):
        pass
    with pytest.raises(LogError, match="holds no"):
        build([tmp_path / "empty.mcap"], tmp_path / "map.npz")
    assert not list(tmp_path.glob("map*"))


@pytest.mark.parametrize("poses", [False, True])
def test_odometry_runs_again_where_the_log_does_not_tell_how_sure_its_poses_are(
    tmp_path: Path, poses: bool
) -> None:
    drive = replace(arena_run("xt16", duration=5.0, seed=1), lidar=LIDARS["xt16"].decimated(8))
    config = load(None, ["lidars=[{name: main, model: xt16}]"], scene="flat")
    with LogWriter(tmp_path / "run.mcap", {}, {CONFIG: config.to_yaml().encode()}) as log:
        for sample in drive.samples():
            topic: Topic
            message: msg.Message
            if isinstance(sample, ImuSample):
                topic, message, now = t.IMU, imu_msg(sample), sample.stamp
                log.write(t.CLOCK, encode(msg.Clock(clock=time_msg(now))), now, now)
            elif isinstance(sample, JointSample):
                topic, message, now = t.JOINTS, joint_msg(sample), sample.stamp
            elif isinstance(sample, LidarScan):
                topic, message, now = t.POINTS, scan_msg(sample), sample.stamp + drive.lidar.period
                if poses:
                    somewhere = msg.Odometry(header=header(now, "odom"), child_frame_id="base_link")
                    log.write(t.ODOM, encode(somewhere), now, now)
            else:
                continue
            log.write(topic, encode(message), now, sample.stamp)
    built = build([tmp_path / "run.mcap"], tmp_path / "map.npz")
    (run,) = built.record["runs"]
    assert run["scans"] > 35
    assert run["driven_m"] == pytest.approx(drive.path_length(), abs=0.1)
    assert built.record["closed"] == []
    assert built.record["moved_m"] == pytest.approx(0.0, abs=1e-6)
    assert built.record["known_cells"] > 5000
