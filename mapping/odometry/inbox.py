"""Samples on their way into the odometry: checked, in stamp order, handed over when every topic has reached the scan's end."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable

import numpy as np

from hal.types import NS, Array, ImuSample, JointSample, LidarScan
from mapping.odometry.intake import SampleBuffer, Sweep, TopicClock, clean_scan
from mapping.odometry.types import OdometryConfig

JOINT_PERIOD = 18_000_000
"""Joint samples that follow faster [ns] are thinned: 50 Hz are enough."""


class Inbox:
    """What has arrived and is not used up. A source clock that is set empties it and calls `on_jump(stamp)`."""

    def __init__(
        self, params: OdometryConfig, counters: Counter[str], on_jump: Callable[[int], None]
    ) -> None:
        self.imu = SampleBuffer(6, 20_000)
        """Rows gyro [rad/s], specific force [m/s^2]."""
        self.joints = SampleBuffer(48, 4_000)
        """Rows position, velocity, effort of 16 motors."""
        self._sweeps: deque[Sweep] = deque()
        self._joint_stamp = -NS
        self._params, self._counters, self._on_jump = params, counters, on_jump
        self._clocks = {
            "imu": TopicClock("imu", 20, counters),
            "joints": TopicClock("joints", 20, counters),
            "scan": TopicClock("scan", 2, counters),
        }

    @property
    def now(self) -> int:
        """Newest stamp of any topic [ns], 0 before the first."""
        return max((c.newest for c in self._clocks.values() if c.newest is not None), default=0)

    def heard(self, topic: str) -> bool:
        """`imu`, `joints` or `scan` has ever spoken."""
        return self._clocks[topic].newest is not None

    def take_imu(self, sample: ImuSample) -> Array | None:
        """The sample as a row (6,); None when it is refused."""
        row = _row((sample.gyro, 3), (sample.accel, 3))
        if row is None or np.abs(row).max() > 1e3:
            self._counters["imu_not_finite"] += 1
            return None
        if not self._admit("imu", sample.stamp):
            return None
        self.imu.append(int(sample.stamp), row)
        return row

    def take_joints(self, sample: JointSample) -> Array | None:
        """The sample as a row (48,); None when it is refused or not needed."""
        row = _row((sample.position, 16), (sample.velocity, 16), (sample.effort, 16))
        if row is None or np.abs(row[16:32]).max() > 1e3:
            self._counters["joints_not_finite"] += 1
            return None
        if not self._admit("joints", sample.stamp):
            return None
        stamp = int(sample.stamp)
        if 0 < stamp - self._joint_stamp < JOINT_PERIOD:
            return None
        self._joint_stamp = stamp
        self.joints.append(stamp, row)
        return row

    def take_scan(self, scan: LidarScan) -> None:
        """Queue a scan, reduced to its usable points."""
        if not self._admit("scan", scan.stamp):
            return
        p = self._params
        sweep = clean_scan(scan, p.min_range, p.max_range, p.max_points, 0.5, self._counters)
        if sweep is not None:
            self._sweeps.append(sweep)

    @property
    def waiting(self) -> bool:
        """A scan is queued."""
        return bool(self._sweeps)

    def next_sweep(self) -> Sweep | None:
        """The oldest scan once IMU and joints have passed its end, or another topic is `patience` ahead of it."""
        if not self._sweeps:
            return None
        end = self._sweeps[0].end
        topics = ["imu", "joints"] if self._params.use_joints else ["imu"]
        stamps = [self._clocks[t].newest for t in topics]
        passed = all(s is not None and s >= end for s in stamps)
        if passed or self.now > end + self._params.patience * NS:
            return self._sweeps.popleft()
        return None

    def forget(self, until: int) -> None:
        """Drop IMU and joint samples with stamp <= until [ns]."""
        self.imu.forget(until)
        self.joints.forget(until)

    def _admit(self, topic: str, stamp: int) -> bool:
        verdict = self._clocks[topic].admit(stamp)
        if verdict == "jump":
            self._follow_clock(topic, int(stamp))
        return verdict != "drop"

    def _follow_clock(self, topic: str, stamp: int) -> None:
        """The source clock was set: the other topics follow without asking."""
        for name, clock in self._clocks.items():
            if name != topic:
                clock.newest = stamp - NS // 2
        self.imu.clear()
        self.joints.clear()
        self._joint_stamp = -NS
        self._sweeps.clear()
        self._on_jump(stamp)


def _row(*parts: tuple[object, int]) -> Array | None:
    """The parts as one float row; None when a part has the wrong size or is not finite."""
    try:
        arrays = [np.asarray(values, np.float64).reshape(-1) for values, _ in parts]
    except (TypeError, ValueError):
        return None
    if any(len(a) != n for a, (_, n) in zip(arrays, parts, strict=True)):
        return None
    row = np.concatenate(arrays)
    return row if np.isfinite(row).all() else None
