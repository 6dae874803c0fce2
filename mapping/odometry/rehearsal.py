"""A second of a robot at rest, so that every kernel is compiled before the first sample counts."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hal.types import GRAVITY, NS, ImuSample, JointSample, LidarScan


class Hearer(Protocol):
    """An odometry."""

    def add_imu(self, sample: ImuSample) -> object:
        """Take an inertial sample."""

    def add_joints(self, sample: JointSample) -> object:
        """Take a joint sample."""

    def add_scan(self, scan: LidarScan) -> None:
        """Take a scan."""

    def poll(self) -> object:
        """Process what is complete."""


def rehearse(odometry: Hearer) -> None:
    """Let `odometry` see a floor for longer than the rest at its start."""
    grid = np.stack(np.meshgrid(np.linspace(-3, 3, 60), np.linspace(-3, 3, 60), [-0.4]), -1).reshape(-1, 3)
    noise = np.random.default_rng(0)  # a stream that repeats itself is refused
    for k in range(12):
        points = np.zeros(len(grid), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f4")])
        points["x"], points["y"], points["z"] = grid.T
        points["z"] += noise.normal(0.0, 0.002, len(points))
        points["time"] = np.linspace(0.0, 0.09, len(points))
        start = NS + k * NS // 10
        odometry.add_scan(LidarScan(start, points))
        for i in range(20):
            stamp = start + 1 + i * 5_000_000
            gyro, accel = noise.normal(0.0, 1e-3, (2, 3))
            odometry.add_imu(ImuSample(stamp, gyro, accel + np.array([0.0, 0.0, GRAVITY])))
            odometry.add_joints(JointSample(stamp, noise.normal(0.0, 1e-4, 16), np.zeros(16), np.zeros(16)))
        odometry.poll()
