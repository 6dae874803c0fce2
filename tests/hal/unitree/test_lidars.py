"""Two LiDARs on the wire: each keeps its name, clock and mount, and one that is silent is named."""

from __future__ import annotations

import numpy as np
import pytest

from hal.lidar.config import LidarConfig, only
from hal.robots import describe
from hal.rotation import rotation_rpy
from hal.types import NS, POINT_DTYPE, TIME_QUANTUM, LidarScan
from hal.unitree.api import WireError
from hal.unitree.cloud import RawImu, encode_cloud, encode_imu
from hal.unitree.config import UnitreeConfig
from hal.unitree.layout import CDR_HEADER, LOW_STATE_CDR
from hal.unitree.lidars import LidarInput
from hal.unitree.link import CUSTOM, L1_IMU, LOW_STATE
from hal.unitree.livox import decode_livox, encode_livox
from hal.unitree.telemetry import Telemetry

HOST = 10**18
"""Host clock at the start [ns]."""
CLOCKS = {"rt/lidar_points": 7 * NS, "rt/utlidar/cloud": 1_600_000_000 * NS}
"""What the LiDARs' own clocks tell then [ns]: one counts from its start, the other is years off."""


class Wire:
    """A link that delivers clouds."""

    def __init__(self) -> None:
        self.inbox: dict[str, list[bytes]] = {}
        self.senders: dict[str, str] = {}

    def sweep(self, topic: str, end: int) -> None:
        """A ring of 5 m whose last point was measured `end` [ns] after the start."""
        points = np.zeros(100, POINT_DTYPE)
        angle = np.linspace(0.0, 2 * np.pi, 100)
        points["x"], points["y"] = 5.0 * np.cos(angle), 5.0 * np.sin(angle)
        points["time"] = np.linspace(0.0, 0.1, 100)
        self.inbox.setdefault(topic, []).append(encode_cloud(CLOCKS[topic] + end - NS // 10, "lidar", points))

    def take(self, topic: str) -> list[bytes]:
        self.came = self.inbox.pop(topic, [])
        return self.came

    def speakers(self, _topic: str) -> list[int]:
        return [0] * len(self.came)

    def clouds(self) -> dict[str, str]:
        return self.senders


def test_each_lidar_keeps_its_name_and_clock_and_a_silent_one_is_named() -> None:
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=describe().lidars))  # type: ignore[arg-type]
    scans: list[LidarScan] = []
    for k in range(1, 60):
        now = k * NS // 10
        wire.sweep("rt/lidar_points", now)
        if k <= 20:
            wire.sweep("rt/utlidar/cloud", now - 30_000_000)
        scans += [s for s in telemetry.read(HOST + now) if isinstance(s, LidarScan)]
        assert telemetry.lidar_note(HOST + now) == (
            "" if k <= 40 else "the head LiDAR is silent on rt/utlidar/cloud"
        )
    stamps = {name: np.array([s.stamp for s in scans if s.name == name]) for name in ("main", "head")}
    assert (len(stamps["main"]), len(stamps["head"])) == (59, 20)
    for stamp in stamps.values():  # both on the host clock: what is received now ended now at the latest
        assert (np.diff(stamp) == NS // 10).all()
        assert abs(stamp[0] - HOST) < TIME_QUANTUM * NS
    assert [round(float(lidar.mount.translation[0]), 3) for lidar in telemetry.lidars] == [0.163, 0.289]


def test_a_lidar_whose_stamps_stand_still_is_silent_though_clouds_keep_coming() -> None:
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=only("xt16")))  # type: ignore[arg-type]
    scans = 0
    for k in range(1, 50):
        now = k * NS // 10
        wire.sweep("rt/lidar_points", min(now, NS))
        scans += sum(isinstance(s, LidarScan) for s in telemetry.read(HOST + now))
    assert scans == 10
    assert telemetry.lidar_note(HOST + now) == "the main LiDAR is silent on rt/lidar_points"
    assert telemetry.figures()["lidar_main_frozen"] == 39


def ring(seed: int = 0) -> np.ndarray:
    points = np.zeros(200, POINT_DTYPE)
    angle = np.linspace(0.0, 2 * np.pi, 200)
    points["x"], points["y"], points["z"] = 4.0 * np.cos(angle), 4.0 * np.sin(angle), 0.25
    points["time"] = np.linspace(0.0, 0.1, 200)
    points["intensity"], points["ring"] = np.arange(200), np.arange(200) % 4
    return points


def test_a_mid360_is_read_as_a_cloud_and_as_a_custom_message() -> None:
    scans = {}
    for kind, encode in (("", encode_cloud), (CUSTOM, encode_livox)):
        wire = Wire()
        telemetry = Telemetry(wire, UnitreeConfig(lidars=only("mid360")))  # type: ignore[arg-type]
        wire.inbox["rt/livox/lidar" + kind] = [encode(7 * NS, "livox_frame", ring())]
        (scans[kind],) = [s for s in telemetry.read(HOST) if isinstance(s, LidarScan)]
        assert telemetry.lidar_note(HOST + NS) == ""
    assert scans[""].stamp == scans[CUSTOM].stamp == pytest.approx(HOST - NS // 10, abs=TIME_QUANTUM * NS)
    for name in ("x", "y", "z", "intensity", "ring"):
        np.testing.assert_array_equal(scans[""].points[name], scans[CUSTOM].points[name], name)
    np.testing.assert_allclose(
        scans[""].points["time"], scans[CUSTOM].points["time"], atol=1.1 * TIME_QUANTUM
    )


def test_a_custom_message_that_is_cut_off_or_miscounted_is_refused() -> None:
    good = encode_livox(7 * NS, "livox_frame", ring())
    assert len(decode_livox(good).points) == 200
    assert len(decode_livox(good + b"\0").points) == 200  # with the last point's padding
    assert len(decode_livox(encode_livox(7 * NS, "x", ring()[:0])).points) == 0
    for bad in (good[:-1], good[:40], good[:3], good[:36] + b"\xff\xff" + good[38:]):
        with pytest.raises(WireError):
            decode_livox(bad)


def test_a_silent_lidar_names_the_topics_that_carry_clouds() -> None:
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=only("mid360")))  # type: ignore[arg-type]
    wire.senders = {"rt/livox/lidar_192_168_1_120": "CustomMsg", "rt/utlidar/cloud": "PointCloud2"}
    assert telemetry.lidar_note(HOST) == (
        "the main LiDAR is silent on rt/livox/lidar; clouds are found on rt/livox/lidar_192_168_1_120 (CustomMsg), "
        "rt/utlidar/cloud (PointCloud2)"
    )


def test_clouds_without_times_are_counted() -> None:
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=only("xt16")))  # type: ignore[arg-type]
    points = np.zeros(100, POINT_DTYPE)
    points["x"] = 5.0
    wire.inbox["rt/lidar_points"] = [encode_cloud(k, "lidar", points) for k in (1, 2, 3)]
    telemetry.read(HOST)
    assert telemetry.figures()["lidar_main_untimed"] == 3


def test_a_jolt_is_no_wrong_mount() -> None:
    """The trunk's accelerometer feels 6 m/s2 to the side in the sample at which the mount is judged."""
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=only("l1")))  # type: ignore[arg-type]
    turn = rotation_rpy(*only("l1")[0].mounted().mount.rpy)
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    for k in range(1, 201):
        low = np.zeros(1, LOW_STATE_CDR)
        low[0]["tick"] = 2 * k
        low[0]["imu_state"]["accelerometer"] = (0.0, 6.0 if k > 198 else 0.0, 9.81)
        wire.inbox[LOW_STATE] = [CDR_HEADER + low.tobytes()]
        imu = RawImu(k * NS // 200, upright, np.zeros(3), turn.T @ np.array([0.0, 0.0, 9.81]))
        wire.inbox[L1_IMU] = [encode_imu(imu, "utlidar_imu")]
        telemetry.read(HOST + k * NS // 200)
    assert telemetry.mount_error is not None
    assert telemetry.mount_error < 0.02


def test_a_sweep_whose_stamps_are_not_trusted_ended_when_it_came() -> None:
    """The LiDAR's clock stands still, as that of a publisher that repeats itself does."""
    came = [5 * NS, 5_130_000_000, 5_200_000_000]
    for trusted, wanted in ((True, came[:1]), (False, came)):
        config = LidarConfig(model="l1", trust_stamps=trusted)
        lidar = LidarInput(config, config.mounted(), "cloud")
        scans = [s for now in came for s in lidar.take("cloud", encode_cloud(NS, "", ring()), now)]
        assert [s.stamp + round(float(s.points["time"].max()) * NS) for s in scans] == wanted


@pytest.mark.parametrize("late", [0.08, 0.3, 20.0])
def test_one_late_point_moves_neither_its_sweep_nor_those_that_follow(late: float) -> None:
    config = only("xt16")[0]
    lidar = LidarInput(config, config.mounted(), "cloud")
    ends = []
    for k in range(1, 100):
        points = ring()
        if k == 30:
            points["time"][17] += late + 0.1
        now = k * NS // 10
        scans = lidar.take("cloud", encode_cloud(now - NS // 10, "", points), now + 5_000_000)
        ends += [s.stamp + round(float(s.points["time"].max()) * NS) - now for s in scans]
    assert len(ends) == 99
    np.testing.assert_allclose(ends, 5_000_000, atol=2 * TIME_QUANTUM * NS)


def test_clouds_whose_times_are_none_are_told_with_what_the_field_held() -> None:
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=only("xt16")))  # type: ignore[arg-type]
    for k in range(30):
        points = ring()
        if k > 10:
            points["time"][::3] = -40.0
        wire.inbox["rt/lidar_points"] = [encode_cloud(k * NS // 10, "lidar", points)]
        telemetry.read(HOST + k * NS // 10)
    told = telemetry.lidar_note(HOST + 3 * NS)
    assert told == "the main LiDAR: point field 'time' holds -40 to 0.0924623: not the times of a sweep"
