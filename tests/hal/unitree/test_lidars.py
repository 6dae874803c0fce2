"""Two LiDARs on the wire: each keeps its name, clock and mount, and one that is silent is named."""

from __future__ import annotations

import numpy as np

from hal.lidar.config import DEFAULT_LIDARS
from hal.types import NS, POINT_DTYPE, LidarScan
from hal.unitree.cloud import encode_cloud
from hal.unitree.config import UnitreeConfig
from hal.unitree.telemetry import Telemetry

HOST = 10**18
"""Host clock at the start [ns]."""
CLOCKS = {"rt/lidar_points": 7 * NS, "rt/utlidar/cloud": 1_600_000_000 * NS}
"""What the LiDARs' own clocks tell then [ns]: one counts from its start, the other is years off."""


class Wire:
    """A link that delivers clouds."""

    def __init__(self) -> None:
        self.inbox: dict[str, list[bytes]] = {}

    def sweep(self, topic: str, end: int) -> None:
        """A ring of 5 m whose last point was measured `end` [ns] after the start."""
        points = np.zeros(100, POINT_DTYPE)
        angle = np.linspace(0.0, 2 * np.pi, 100)
        points["x"], points["y"] = 5.0 * np.cos(angle), 5.0 * np.sin(angle)
        points["time"] = np.linspace(0.0, 0.1, 100)
        self.inbox.setdefault(topic, []).append(encode_cloud(CLOCKS[topic] + end - NS // 10, "lidar", points))

    def take(self, topic: str) -> list[bytes]:
        return self.inbox.pop(topic, [])


def test_each_lidar_keeps_its_name_and_clock_and_a_silent_one_is_named() -> None:
    wire = Wire()
    telemetry = Telemetry(wire, UnitreeConfig(lidars=DEFAULT_LIDARS))  # type: ignore[arg-type]
    scans: list[LidarScan] = []
    for k in range(1, 60):
        now = k * NS // 10
        wire.sweep("rt/lidar_points", now)
        if k <= 20:
            wire.sweep("rt/utlidar/cloud", now - 30_000_000)
        scans += [s for s in telemetry.read(HOST + now) if isinstance(s, LidarScan)]
        assert telemetry.silence(HOST + now) == (
            "" if k <= 40 else "the head LiDAR is silent on rt/utlidar/cloud"
        )
    stamps = {name: np.array([s.stamp for s in scans if s.name == name]) for name in ("main", "head")}
    assert (len(stamps["main"]), len(stamps["head"])) == (59, 20)
    for stamp in stamps.values():  # both on the host clock: what is received now ended now at the latest
        assert (np.diff(stamp) == NS // 10).all()
        assert abs(stamp[0] - HOST) < 1000
    assert [round(float(lidar.mount.translation[0]), 3) for lidar in telemetry.lidars] == [0.163, 0.289]
