"""Sweeps of a log as clouds at the poses that its odometry told: motion is taken out along these poses, and nothing is
registered again. A sweep that is not wanted is not unpacked."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hal.rotation import quaternion, rotation, rotation_vector, turn
from hal.types import NO_POINTS, NS, Array, LidarName
from mapping.odometry.deskew import Deskewer
from mapping.odometry.inbox import NEAR_RANGE, SWEEP_PERIOD, SWEEP_SLACK
from mapping.odometry.intake import Sweep, clean_scan
from mapping.odometry.own import OwnFilter
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.log.packed import PackedError, unpack
from rbtrg_robot.wire.convert import LayoutError, lidar_scan, xyz, xyzw
from rbtrg_robot.wire.messages import MessageError, decode, stamp_in, stamp_of

LONGEST_SWEEP = NS // 3
"""A sweep begins no longer before its pose [ns]; two poses that are further apart tell nothing of the way between."""
KNOT_PERIOD = NS // 100
"""Between the knots of the way from pose to pose [ns]."""
KEPT_SWEEPS = 8
"""Of each LiDAR, until their pose comes."""


class Pose(NamedTuple):
    """Where odometry has base_link, and how it moves."""

    stamp: int
    place: Array
    turn: Array
    """(3, 3)"""
    linear: Array
    angular: Array
    """(3,) in base_link [m/s], [rad/s]."""

    @classmethod
    def of(cls, message: msg.Odometry) -> Pose:
        """Of the odometry's message."""
        at, twist = message.pose.pose, message.twist.twist
        q = xyzw(at.orientation)
        turn = rotation(q / np.linalg.norm(q))
        return cls(stamp_of(message), xyz(at.position), turn, xyz(twist.linear), xyz(twist.angular))

    @property
    def matrix(self) -> Array:
        """(4, 4) base_link in `odom`."""
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = self.turn, self.place
        return out


class Swept:
    """Sweeps, poses and their health in the order of the log; out: clouds that belong to a pose."""

    def __init__(self, config: StackConfig) -> None:
        lidars = config.mounted_lidars()
        mounts = {lidar.name: lidar.mount for lidar in lidars}
        self._params = config.odometry
        self._own = OwnFilter(config.own_parts, mounts, (config.facts.body.length, config.facts.body.width))
        self._deskewer = Deskewer(mounts, np.zeros(3))
        self._shift = dict.fromkeys(mounts, 0)
        self._waiting: dict[LidarName, deque[tuple[int, bytes, bool]]] = {
            name: deque(maxlen=KEPT_SWEEPS) for name in mounts
        }
        self._poses: deque[Pose] = deque(maxlen=3)
        self.topics = {t.SWEEPS[name]: name for name in mounts}

    def sweep(self, name: LidarName, payload: bytes, kind: str) -> None:
        """A sweep as it lies in the log, of the message type `kind`. Raises MessageError."""
        self._waiting[name].append((stamp_in(payload, kind), payload, kind != t.POINTS.type))

    def health(self, message: msg.OdometryHealth) -> None:
        """By how much the odometry took the clock of each LiDAR for wrong."""
        for name, applied in zip(message.lidar, message.time_applied.tolist(), strict=False):
            if name in self._shift:
                self._shift[name] = round(applied * NS)  # type: ignore[index]

    def pose(self, message: msg.Odometry) -> Pose:
        """The pose at the end of a sweep."""
        self._poses.append(Pose.of(message))
        return self._poses[-1]

    def clouds(self) -> dict[LidarName, NDArray[np.float32]]:
        """(n, 3) base_link at the newest pose [m], of each LiDAR; none where the sweep of the main one is not there."""
        stamps, track = self._way()
        last = self._poses[-2].stamp if len(self._poses) > 1 else 0
        out: dict[LidarName, NDArray[np.float32]] = {}
        for name in self._waiting:
            after, until = max(stamps[-1] - 2 * SWEEP_PERIOD, last + SWEEP_SLACK), stamps[-1] + SWEEP_SLACK
            if name == "main":
                after = stamps[-1] - SWEEP_SLACK
            parts = []
            for sweep in self._sweeps(name, int(stamps[-1])):
                if sweep.end <= after:
                    break
                if sweep.end <= until:
                    parts.append(self._deskewer.cloud(self._own.take_out(sweep, Counter()), stamps, track))
            out[name] = np.concatenate(parts[::-1]) if parts else NO_POINTS
        return out

    def _sweeps(self, name: LidarName, stamp: int) -> Iterator[Sweep]:
        """Sound ones that began not long before `stamp` [ns], the newest first: unpacking takes most of the time."""
        near, p = self._params.min_range if name == "main" else NEAR_RANGE, self._params
        for began, payload, packed in reversed(self._waiting[name]):
            if not 0 < stamp - began - self._shift[name] < LONGEST_SWEEP:
                continue
            with suppress(MessageError, LayoutError, PackedError):
                scan = lidar_scan(decode(unpack(payload) if packed else payload, t.POINTS.kind), name)
                found = clean_scan(scan, near, p.max_range, p.max_points, Counter())
                if found is not None and not found.problem:
                    shift = self._shift[name]
                    yield replace(found, start=found.start + shift, end=found.end + shift)

    def _way(self) -> tuple[NDArray[np.int64], Array]:
        """Stamps (k,) [ns] and poses (k, 10), as `deskew` wants them, of the way to the newest pose: through the poses
        before it, or by its own speed where there is none."""
        stamps, poses = list[int](), list[Array]()
        newest = self._poses[-1]
        before = [pose for pose in self._poses if 0 < newest.stamp - pose.stamp < LONGEST_SWEEP]
        known = [*before, newest]
        if len(known) == 1:
            known = [_before(newest), newest]
        for a, b in pairwise(known):
            for stamp in range(a.stamp, b.stamp, KNOT_PERIOD):
                stamps.append(stamp)
                poses.append(_between(a, b, stamp))
        return np.array([*stamps, newest.stamp]), np.array(
            [*poses, _between(known[-2], newest, newest.stamp)]
        )


def _before(pose: Pose) -> Pose:
    """Where the robot was at the begin of a sweep, by its speed at the end."""
    q = quaternion(pose.turn)
    turn(q, *(-pose.angular * SWEEP_PERIOD / NS))
    place = pose.place - pose.turn @ pose.linear * SWEEP_PERIOD / NS
    return pose._replace(stamp=pose.stamp - SWEEP_PERIOD, place=place, turn=rotation(q))


def _between(a: Pose, b: Pose, stamp: int) -> Array:
    """(10,) x, y, z, -, -, -, quaternion between two poses: cubic, with the speeds at both ends."""
    seconds = (b.stamp - a.stamp) / NS
    s = (stamp - a.stamp) / (b.stamp - a.stamp)
    there, leaves, arrives = 3 * s**2 - 2 * s**3, seconds * (s - 2 * s**2 + s**3), seconds * (s**3 - s**2)
    out = np.zeros(10)
    out[:3] = (
        a.place + there * (b.place - a.place) + leaves * (a.turn @ a.linear) + arrives * (b.turn @ b.linear)
    )
    out[6:10] = quaternion(a.turn)
    turn(out[6:10], *(there * rotation_vector(a.turn.T @ b.turn) + leaves * a.angular + arrives * b.angular))
    return out
