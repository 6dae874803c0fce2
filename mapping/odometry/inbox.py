"""Samples on their way into the odometry: checked, in stamp order, released when every topic has reached the scan's
end.

Of several LiDARs the main one sets the pace. A sweep of another LiDAR goes with the first main sweep that ends after
it. If the main LiDAR is silent, repeats itself or tells wrong distances, the other sets the pace."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hal.plausible import ImuCheck, impossible_joints
from hal.safety.monitors import (
    IMU_PART_REPEATS,
    IMU_REPEATS,
    JOINTS_REPEAT,
    LIDAR_REPEATS,
    STAMP_AHEAD,
    SWEEP_CLOCK,
)
from hal.types import NS, Array, ImuSample, JointSample, LidarName, LidarScan
from mapping.odometry.contacts import contacts_of
from mapping.odometry.ground_height import GroundHeight
from mapping.odometry.intake import SampleBuffer, Sweep, SweepClock, TopicClock, clean_scan
from mapping.odometry.own import OwnFilter
from mapping.odometry.repeats import Repeats
from mapping.odometry.types import OdometryConfig

STREAMS = {"imu": "IMU", "joints": "joints"}
"""What operators call them."""
SWEEP_PERIOD = NS // 10
SWEEP_SLACK = 10_000_000
"""Sweeps of two LiDARs that end within this time [ns] belong together."""
SILENT_TIME = NS // 2
"""A LiDAR that has not begun a sweep for this long [ns] is silent; so is a dead one."""
NEAR_RANGE = 0.1
"""A LiDAR that is there for the ground in front of it may see it this near [m]."""
ASKED_WAY = 1.0
"""[m] of the start on which the height of the ground is asked for: then the way of the wheels tells a wrong unit, and
the robot may come onto a plinth."""
JOINT_PERIOD = 18_000_000
"""Joint samples that follow faster [ns] are thinned: 50 Hz are enough."""


class Inbox:
    """Samples that have arrived and are not used yet. A source clock that is set empties it and calls
    `on_jump(stamp)`."""

    def __init__(
        self,
        params: OdometryConfig,
        counters: Counter[str],
        on_jump: Callable[[int], None],
        shift: Mapping[LidarName, int],
        own: OwnFilter,
    ) -> None:
        """`shift`: added to the stamps of each LiDAR [ns]; may change. `own`: removes the robot itself from sweeps."""
        self._own = own
        self.imu = SampleBuffer(6, 20_000)
        """Rows gyro [rad/s], specific force [m/s^2]."""
        self.joints = SampleBuffer(48, 4_000)
        """Rows position, velocity, effort of 16 motors."""
        self._sweeps: dict[LidarName, deque[Sweep]] = {name: deque() for name in shift}
        self._ends: dict[LidarName, int] = {}
        """End of the newest sweep of each LiDAR [ns]."""
        self._first: int | None = None
        self.now = 0
        """Newest stamp of any topic [ns], 0 before the first."""
        self._joint_stamp = -NS
        self._imu_check = ImuCheck("IMU")
        self._refused: dict[str, str] = {}
        """By topic the newest reason for which a sample was refused."""
        self._params, self._counters, self._on_jump, self._shift = params, counters, on_jump, shift
        self._streams: dict[str, Repeats] = {
            "imu": Repeats(IMU_REPEATS),
            "gyro": Repeats(IMU_PART_REPEATS, "gyro", memory=1),
            "accelerometer": Repeats(IMU_PART_REPEATS, "accelerometer", memory=1),
            "joints": Repeats(JOINTS_REPEAT),
            **{name: Repeats(LIDAR_REPEATS, name) for name in self._sweeps},
        }
        self._heights = {name: GroundHeight(name, own.place(name)) for name in self._sweeps}
        self._clocks: dict[str, TopicClock] = {
            "imu": TopicClock("imu", 20, counters),
            "joints": TopicClock("joints", 20, counters),
            **{name: TopicClock("scan", 2, counters, ahead=False) for name in self._sweeps},
        }
        self._agreement = {name: SweepClock() for name in self._sweeps}
        self._imu_samples = 0
        self._way = 0.0
        """That the wheels rolled [m]."""

    def _repeats(self, topic: str, payload: NDArray) -> bool:
        dead = self._streams[topic].dead(payload)
        if dead:
            self._counters[f"{topic}_repeated"] += 1
        return dead

    def dead(self, topic: str) -> str:
        """Why nothing of `imu`, `joints` or a LiDAR is believed, in words; empty where it is."""
        names = ("imu", "gyro", "accelerometer") if topic == "imu" else (topic,)
        words = [self._streams[name].words for name in names]
        words += [self._heights[name].words for name in names if name in self._heights]
        return next(filter(None, words), "")

    def heard(self, topic: str) -> bool:
        """`imu`, `joints` or a LiDAR has ever spoken."""
        return self._clocks[topic].newest is not None

    def take_imu(self, sample: ImuSample) -> Array | None:
        """The sample as a row (6,); None when it is refused."""
        row = _row((sample.gyro, 3), (sample.accel, 3))
        if row is None:
            self._counters["imu_layout"] += 1
            return None
        self._imu_samples += 1
        if self._refuse("imu", self._imu_check.impossible(row[:3], row[3:])):
            return None
        if not self._admit("imu", sample.stamp):
            return None
        dead = (
            self._repeats("imu", row),
            self._repeats("gyro", row[:3]),
            self._repeats("accelerometer", row[3:]),
        )
        if any(dead):
            return None
        if self._refuse("imu", self._imu_check.contradicted(int(sample.stamp), row[:3], row[3:])):
            return None
        self.imu.append(int(sample.stamp), row)
        return row

    def take_joints(self, sample: JointSample) -> Array | None:
        """The sample as a row (48,); None when it is refused or not needed."""
        row = _row((sample.position, 16), (sample.velocity, 16), (sample.effort, 16))
        if row is None:
            self._counters["joints_layout"] += 1
            return None
        if self._refuse("joints", impossible_joints(row[:16], row[16:32], row[32:])):
            return None
        if not self._admit("joints", sample.stamp) or self._repeats("joints", row):
            return None
        stamp = int(sample.stamp)
        if 0 < stamp - self._joint_stamp < JOINT_PERIOD:
            return None
        self._joint_stamp = stamp
        self.joints.append(stamp, row)
        return row

    def _refuse(self, topic: str, reason: str) -> bool:
        """Count and keep the reason for which a sample is refused; whether there is one."""
        if reason:
            self._counters[f"{topic}_impossible"] += 1
            self._refused[topic] = reason
        return bool(reason)

    def refused(self) -> list[str]:
        """Why samples were refused since the last call, in words."""
        out = list(self._refused.values())
        self._refused.clear()
        return out

    def take_scan(self, scan: LidarScan) -> None:
        """Queue a scan, reduced to its usable points."""
        if scan.name not in self._sweeps:
            self._counters["scan_of_unknown_lidar"] += 1
            return
        if not self._admit_sweep(scan.name, scan.stamp):
            return
        p = self._params
        near = p.min_range if scan.name == "main" else NEAR_RANGE
        sweep = clean_scan(scan, near, p.max_range, p.max_points, self._counters)
        if sweep is None:
            return
        stream = self._streams[scan.name]
        dead = self._repeats(scan.name, sweep.xyz)
        if stream.again and not dead:
            self._refuse(scan.name, stream.told)
            return
        clock = self._agreement[scan.name]
        off = clock.off(sweep.start, sweep.end, self._clocks["imu"].newest, self._imu_samples)
        reason = clock.too_long(sweep.end - sweep.start)
        if off:
            reason = SWEEP_CLOCK.tell(name=scan.name, value=off)
        if not self._refuse(scan.name, reason):
            self._note(int(scan.stamp))
            shift = self._shift[scan.name]
            sweep = replace(sweep, start=sweep.start + shift, end=sweep.end + shift)
            sweep = self._own.take_out(sweep, self._counters)
            self._look_down(sweep)
            if told := self.dead(scan.name):
                if scan.name != self.pace:
                    self._ends.pop(scan.name, None)  # it is not waited for
                    return
                sweep = replace(sweep, problem=told)
            self._sweeps[scan.name].append(sweep)
            self._ends[scan.name] = sweep.end

    def rolled(self, way: float) -> None:
        """The wheels rolled `way` [m] since the last call; NaN: nobody knows."""
        self._way += abs(way) if math.isfinite(way) else 0.0

    def _look_down(self, sweep: Sweep) -> None:
        height = self._heights[sweep.name]
        if height.asks and (self._way < ASKED_WAY or height.words):
            joints = self.joints.between(sweep.end - NS // 5, sweep.end)[1]
            contacts = contacts_of(self._params.inertial.limbs, joints)
            height.look(self._own.in_base(sweep.name, sweep.xyz), contacts)

    @property
    def pace(self) -> LidarName:
        """The LiDAR whose sweeps are registered: the main one, unless it is silent and another speaks."""
        others = [name for name in self._sweeps if name != "main" and not self._silent(name)]
        return others[0] if others and self._silent("main") else "main"

    def _silent(self, name: LidarName) -> bool:
        newest = self._clocks[name].newest
        since = newest if newest is not None else self._first
        return since is None or self.now - since > SILENT_TIME or bool(self.dead(name))

    @property
    def waiting(self) -> bool:
        """A scan to be registered is queued."""
        return bool(self._sweeps[self.pace])

    def next_sweep(self) -> Sweep | None:
        """The oldest scan to be registered. It waits until IMU, joints and due sweeps of other LiDARs have passed its
        end, or until another topic is `patience` ahead of it."""
        if not any(self._sweeps.values()):  # most calls: a sample of IMU or joints came
            return None
        queue = self._sweeps[self.pace]
        if not queue:
            return None
        end = queue[0].end
        topics = ["imu", "joints"] if self._params.use_joints else ["imu"]
        stamps = [self._clocks[t].newest for t in topics]
        passed = all(s is not None and s >= end for s in stamps) and not any(
            last + SWEEP_PERIOD <= end + SWEEP_SLACK
            for name, last in self._ends.items()
            if not self._silent(name)
        )
        if passed or self.now > end + self._params.patience * NS:
            return queue.popleft()
        return None

    def beside(self, sweep: Sweep) -> list[Sweep]:
        """Sweeps of the other LiDARs that belong to a registered `sweep`; earlier ones are dropped."""
        out: list[Sweep] = []
        for name, queue in self._sweeps.items():
            while name != sweep.name and queue and queue[0].end <= sweep.end + SWEEP_SLACK:
                out.append(queue.popleft())
        return [other for other in out if other.end > sweep.end - 2 * SWEEP_PERIOD]

    def forget(self, until: int) -> None:
        """Drop IMU and joint samples with stamp <= until [ns]."""
        self.imu.forget(until)
        self.joints.forget(until)

    def _admit(self, topic: str, stamp: int) -> bool:
        clock = self._clocks[topic]
        verdict = clock.admit(stamp)
        if verdict == "ahead":
            self._refuse(topic, STAMP_AHEAD.tell(stream=STREAMS[topic], value=clock.step))
        if verdict == "jump":
            self._follow_clock(topic, int(stamp))
        if verdict == "ok":
            self._note(int(stamp))
        return verdict in ("ok", "jump")

    def _admit_sweep(self, name: LidarName, stamp: int) -> bool:
        """A LiDAR whose clock jumped alone is nobody's clock."""
        verdict = self._clocks[name].admit(stamp)
        if verdict == "jump" and self._clocks["imu"].newest is None:
            self._follow_clock(name, int(stamp))
        elif verdict != "ok":
            self._agreement[name].went_back()
        return verdict in ("ok", "jump")

    def _note(self, stamp: int) -> None:
        self.now = max(self.now, stamp)
        if self._first is None:
            self._first = stamp

    def _follow_clock(self, topic: str, stamp: int) -> None:
        """The source clock was set: the other topics follow without asking."""
        for name, clock in self._clocks.items():
            if name != topic:
                clock.newest = stamp - NS // 2
        self.imu.clear()
        self.joints.clear()
        self._joint_stamp = -NS
        for queue in self._sweeps.values():
            queue.clear()
        self._ends.clear()
        self._first = self.now = stamp
        self._on_jump(stamp)


def _row(*parts: tuple[object, int]) -> Array | None:
    """The parts as one float row; None when a part has the wrong size."""
    arrays = []
    for values, size in parts:
        try:
            array = np.asarray(values, np.float64)
        except (TypeError, ValueError):
            return None
        if array.size != size:
            return None
        arrays.append(array.reshape(-1))
    return np.concatenate(arrays)
