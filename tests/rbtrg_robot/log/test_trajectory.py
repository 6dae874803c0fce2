"""The way of a run for other programs, and ATE and RPE as evo counts them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hal.rotation import rotation_rpy
from hal.types import NS
from rbtrg_robot import topics as t
from rbtrg_robot.cli.logs import log_app
from rbtrg_robot.log.read import LogError
from rbtrg_robot.log.trajectory import Trajectory, compare, of_run, read, write
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.wire.convert import odometry_msg
from rbtrg_robot.wire.messages import encode


def wave(rate: float, noise: float, offset: float = 0.0) -> Trajectory:
    """30 s of a way that winds and climbs; `noise` [m, rad] of a seeded generator."""
    rng = np.random.default_rng(3)
    s = np.arange(0.0, 30.0, 1.0 / rate) + offset
    poses = np.tile(np.eye(4), (len(s), 1, 1))
    poses[:, 0, 3], poses[:, 1, 3], poses[:, 2, 3] = 3 * np.cos(s / 3), 3 * np.sin(s / 2), 0.2 * np.sin(s)
    poses[:, :3, 3] += rng.normal(0.0, noise or 1e-12, (len(s), 3))
    yaw = s / 3 + rng.normal(0.0, noise or 1e-12, len(s))
    poses[:, :3, :3] = rotation_rpy(0.1 * np.sin(s), 0.0 * s, yaw)
    return Trajectory(np.rint(s * 1e9).astype(np.int64) + 1_700_000_000 * NS, poses)


def moved(way: Trajectory) -> Trajectory:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation_rpy(0.1, 0.2, 1.0), (1.0, 2.0, 3.0)
    return Trajectory(way.stamps, frame @ way.poses)


def test_figures_are_those_of_evo(tmp_path: Path) -> None:
    """evo 1.38.1 on the two files: `evo_ape tum -a`, `evo_rpe tum --delta 1 -u m`, `--delta 10 -u f`."""
    write(moved(wave(10.0, 0.02, 0.003)), tmp_path / "own.tum")
    write(wave(50.0, 0.0), tmp_path / "reference.tum")
    found = compare(read(tmp_path / "own.tum"), read(tmp_path / "reference.tum"))
    assert found.pairs == 300
    assert found.frames == 10
    assert (found.ate, found.rpe_distance, found.rpe_time) == pytest.approx(
        (0.034798170453, 0.052702950451, 0.048422184907), abs=5e-10
    )
    assert (found.rpe_distance_deg, found.rpe_time_deg) == pytest.approx(
        (1.316697586925, 1.786465636117), abs=5e-8
    )


def test_the_same_way_elsewhere_has_no_error(tmp_path: Path) -> None:
    way = wave(10.0, 0.02)
    found = compare(moved(way), way)
    assert (found.ate, found.rpe_distance, found.rpe_time) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    write(moved(way), tmp_path / "a.kitti")
    write(way, tmp_path / "b.kitti")
    assert compare(read(tmp_path / "a.kitti"), read(tmp_path / "b.kitti")).ate < 1e-6


def test_a_file_keeps_every_nanosecond_and_digit(tmp_path: Path) -> None:
    way = wave(10.0, 0.02, 0.123456789)
    write(way, tmp_path / "way.tum")
    again = read(tmp_path / "way.tum")
    np.testing.assert_array_equal(again.stamps, way.stamps)
    np.testing.assert_allclose(again.poses, way.poses, atol=3e-9)


def test_the_way_of_a_run_is_that_of_its_odometry(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log_0.mcap", {}) as writer:
        for k in range(5):
            q = (0.0, 0.0, math.sin(0.05 * k), math.cos(0.05 * k))
            payload = encode(odometry_msg(k * NS, (0.1 * k, 0.0, 0.0), q, np.zeros(3), np.zeros(3)))
            writer.write(t.ODOM, payload, k, k * NS)
    way = of_run(tmp_path)
    assert way.stamps.tolist() == [k * NS for k in range(5)]
    np.testing.assert_allclose(way.poses[:, 0, 3], 0.1 * np.arange(5))
    with pytest.raises(LogError, match=r"no poses on /pose; poses are on /odom: --topic"):
        of_run(tmp_path, "/pose")
    LogWriter(tmp_path / "empty.mcap", {}).close()
    with pytest.raises(LogError, match=r"no poses on /odom: `rbtrg-robot replay .* --rerun odometry"):
        of_run(tmp_path / "empty.mcap")


def test_the_command_tells_programs_what_it_wrote(tmp_path: Path) -> None:
    write(wave(10.0, 0.02), tmp_path / "way.tum")
    words = ["trajectory", str(tmp_path / "way.tum"), "--out", str(tmp_path / "again.kitti"), "--json"]
    result = CliRunner().invoke(log_app, words, catch_exceptions=False)
    assert json.loads(result.stdout)["poses"] == len(wave(10.0, 0.02).stamps)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2 3\n", "TUM has 8 columns and KITTI 12"),
        ("a b c d e f g h\n", "is no trajectory"),
        ("1 0 0 0 0 0 0 0\n", "without an orientation"),
        ("", "no line"),
    ],
)
def test_what_is_no_trajectory_is_told(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "x.tum").write_text(text)
    with pytest.raises(LogError, match=words):
        read(tmp_path / "x.tum")


def test_ways_of_different_times_have_nothing_in_common() -> None:
    early = wave(10.0, 0.0)
    with pytest.raises(LogError, match="are their clocks the same"):
        compare(early, Trajectory(early.stamps + 100 * NS, early.poses))
