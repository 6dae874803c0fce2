"""One LiDAR on the wire: its clouds, its clock, its mount."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hal.lidar.config import LidarConfig
from hal.rotation import rotation_rpy
from hal.safety.monitors import CLOCK_STEP, SWEEP_LATE
from hal.types import NS, POINT_DTYPE, LidarScan, MountedLidar
from hal.unitree.api import WireError
from hal.unitree.clock import RemoteClock
from hal.unitree.cloud import Limits, RawCloud, decode_cloud, sweep
from hal.unitree.link import CUSTOM, Link
from hal.unitree.livox import decode_livox

SILENT_AFTER = 2 * NS
"""Without a cloud for this long [ns] a LiDAR counts as silent."""
UNREAD_AFTER = NS // 2
"""[ns] without a usable cloud, after which the reason is told."""
STEP_TOLD = 10 * NS
"""[ns] for which a step of a clock is told."""
CLOUD = "cloud"
"""The stream of a LiDAR's clock beside its IMU."""
SEARCH_PERIOD = NS
"""[ns] between two looks at who sends clouds, while one is silent."""


class LidarInput:
    """Turns the clouds of one LiDAR into scans on the host clock."""

    def __init__(self, lidar: LidarConfig, mounted: MountedLidar, topic: str) -> None:
        self.name = lidar.name
        self.model = lidar.model
        self.topic = topic
        self.inputs: dict[str, Callable[[bytes], RawCloud]] = {topic: decode_cloud}
        """How what comes on a topic of the link is read."""
        if lidar.model == "mid360":
            self.inputs[topic + CUSTOM] = decode_livox
        self.clock = RemoteClock()
        """The LiDAR's own clock; its IMU has the same."""
        self.mount = mounted.mount
        self.rotation = rotation_rpy(*mounted.mount.rpy)
        """(3, 3) base_link <- its frame."""
        self._limits = Limits()
        self.heard_at: int | None = None
        """When the last cloud with points came [ns, host clock]."""
        self.empty = 0
        """Clouds without a point that can be used."""
        self.missed = 0
        """Sweeps that never came, by the gaps between the stamps of those that did."""
        self.frozen = 0
        """Clouds with the stamp of the one before: a publisher that repeats itself is silent."""
        self.untimed = 0
        """Clouds without a time per point: they cannot be deskewed."""
        self.refused = 0
        """Clouds whose stamps no delay explains."""
        self._unread = ""
        """Why the newest cloud could not be used; empty when it was."""
        self._unit: float | None = None
        """[s] of the times of its points, once it is known."""
        self._start: int | None = None
        self._offset = round(lidar.time_offset * NS)
        self._trusted = lidar.trust_stamps
        self._last: int | None = None

    def warm_up(self) -> None:
        """Compile the cloud kernel before the first sweep has to wait for it."""
        sweep(RawCloud(0, "", np.zeros(1, POINT_DTYPE)), self._limits)

    def take(self, topic: str, data: bytes, now: int) -> list[LidarScan]:
        """The scan in a message of one of `inputs`, received by `now` [ns]; none without points. Raises WireError."""
        try:
            start, points, self._unit = sweep(self.inputs[topic](data), self._limits, self._unit)
        except WireError as error:
            self._unread = str(error)
            raise
        if not len(points):
            self.empty += 1
            return []
        if self._trusted and start == self._start:
            self.frozen += 1
            return []
        # The end of the sweep is what was just received; its start lies a sweep earlier.
        duration = round(float(points["time"].max()) * NS)
        self.untimed += duration == 0
        if not self._trusted:
            start = now - duration
        elif not self.clock.hear(start + duration, now, CLOUD, max(duration // 2, 1)):
            self.refused += 1
            return []
        self.heard_at, self._unread = now, ""
        self._count_missed(start, duration)
        end = min((self.clock.date(start + duration, now) if self._trusted else now) + self._offset, now)
        stamp = end - duration
        if self._last is not None and self._last - NS < stamp <= self._last:
            stamp = self._last + 1  # a better clock offset must not turn time back
        self._last = stamp
        return [LidarScan(stamp, points, self.name)]

    def note(self, now: int) -> str:
        """What is wrong with its stamps, in words; empty when they are right. `now` [ns, host clock]."""
        if self._unread and now - (self.heard_at or 0) > UNREAD_AFTER:
            return f"the {self.name} LiDAR: {self._unread}"
        late, since = self.clock.late(CLOUD), self.clock.stepped_at
        if SWEEP_LATE.outside(late):
            return SWEEP_LATE.tell(name=self.name, late=late)
        if since is not None and now - since < STEP_TOLD:
            return CLOCK_STEP.tell(source=f"the {self.name} LiDAR", step=self.clock.step / NS)
        return ""

    def _count_missed(self, start: int, duration: int) -> None:
        """`start`, `duration` [ns] of a sweep; one follows the other. Beyond a gap of 2 s it was silent or its clock
        was set."""
        if self._start is not None and duration > 0 and 0 < (gap := start - self._start) < 2 * NS:
            self.missed += max(0, round(gap / duration) - 1)
        self._start = start


class Silence:
    """Says which LiDAR does not speak, and on which topics somebody sends clouds instead."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._found: dict[str, str] = {}
        self._searched = 0

    def words(self, lidars: list[LidarInput], now: int) -> str:
        """At `now` [ns, host clock]; empty when all speak."""
        silent = [lidar for lidar in lidars if now - (lidar.heard_at or 0) > SILENT_AFTER]
        if not silent:
            return ""
        if now - self._searched >= SEARCH_PERIOD:
            self._searched, self._found = now, self._link.clouds()
        heard = {lidar.topic for lidar in lidars if lidar not in silent}
        found = [f"{topic} ({kind})" for topic, kind in sorted(self._found.items()) if topic not in heard]
        words = ", ".join(f"the {lidar.name} LiDAR is silent on {lidar.topic}" for lidar in silent)
        return f"{words}; clouds are found on {', '.join(found)}" if found else words
