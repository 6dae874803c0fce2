"""The door: everything a driver can send wrong is stopped, counted and named here."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.types import NS, Array, LidarName, LidarScan

JUMP_BACK = NS
JUMP_AHEAD = 10 * NS
"""A step of a topic's stamps beyond these [ns] is a wrong stamp, or, when the following samples confirm it, a new clock."""


class TopicClock:
    """Lets only ascending stamps through. A clock that jumped (a 1970 boot clock that was set) is followed once it is confirmed."""

    def __init__(self, name: str, confirm: int, counters: Counter[str]) -> None:
        """`confirm`: samples in a row on the new clock before it is believed."""
        self.newest: int | None = None
        self._name, self._confirm, self._counters = name, confirm, counters
        self._strange: int | None = None
        self._run = 0

    def admit(self, stamp: object) -> str:
        """`ok`, `drop`, or `jump`: accepted, and the clock has changed."""
        if isinstance(stamp, bool) or not isinstance(stamp, int | np.integer) or not 0 <= stamp < 2**62:
            self._counters[f"{self._name}_stamp"] += 1
            return "drop"
        stamp = int(stamp)
        if self.newest is None:
            self.newest = stamp
            return "ok"
        step = stamp - self.newest
        if -JUMP_BACK <= step <= JUMP_AHEAD:
            self._strange, self._run = None, 0
            if step <= 0:
                self._counters[f"{self._name}_{'duplicate' if step == 0 else 'backward'}"] += 1
                return "drop"
            self.newest = stamp
            return "ok"
        follows = self._strange is not None and 0 < stamp - self._strange <= NS
        self._run = self._run + 1 if follows else 1
        self._strange = stamp
        if self._run < self._confirm:
            self._counters[f"{self._name}_strange_stamp"] += 1
            return "drop"
        self._counters[f"{self._name}_clock_jump"] += 1
        self.newest, self._strange, self._run = stamp, None, 0
        return "jump"


class SampleBuffer:
    """Samples in stamp order, waiting for the scans that need them."""

    def __init__(self, width: int, limit: int) -> None:
        """Rows of `width` floats; the oldest go when there are more than `limit`."""
        self._stamps: deque[int] = deque(maxlen=limit)
        self._rows: deque[Array] = deque(maxlen=limit)
        self._width = width

    def append(self, stamp: int, row: Array) -> None:
        """Stamps must ascend."""
        self._stamps.append(stamp)
        self._rows.append(row)

    def between(self, after: int, until: int, beyond: int = 0) -> tuple[NDArray[np.int64], Array]:
        """Samples with after < stamp <= until, and up to `beyond` more after them: stamps (n,), rows (n, width)."""
        picked = []
        extra = 0
        for i in range(len(self._stamps) - 1, -1, -1):  # from the newest: only few are ever needed
            if self._stamps[i] <= after:
                break
            picked.append(i)
            extra += self._stamps[i] > until
        picked.reverse()
        picked = picked[: len(picked) - max(extra - beyond, 0)]
        if not picked:
            return np.empty(0, np.int64), np.empty((0, self._width))
        return np.array([self._stamps[i] for i in picked]), np.stack([self._rows[i] for i in picked])

    def forget(self, until: int) -> None:
        """Drop samples with stamp <= until."""
        while self._stamps and self._stamps[0] <= until:
            self._stamps.popleft()
            self._rows.popleft()

    def clear(self) -> None:
        """Drop everything."""
        self._stamps.clear()
        self._rows.clear()


@dataclass(frozen=True, slots=True)
class Sweep:
    """A scan that passed the door."""

    start: int
    end: int
    """[ns]; of the last point."""
    xyz: NDArray[np.float32]
    """(n, 3) [m], frame of the LiDAR, finite, within range."""
    time: Array
    """(n,) [s] since start."""
    problem: str
    """Plain words; empty when the scan is sound."""
    name: LidarName = "main"

    @property
    def untimed(self) -> bool:
        """All points have one time, which no LiDAR that turns gives."""
        return len(self.time) > 1 and float(self.time.min()) == float(self.time.max())


def clean_scan(
    scan: LidarScan,
    min_range: float,
    max_range: float,
    max_points: int,
    max_duration: float,
    counters: Counter[str],
) -> Sweep | None:
    """A scan reduced to usable points; None when its layout cannot be read."""
    points = scan.points
    names = getattr(getattr(points, "dtype", None), "names", None) or ()
    wanted = ("x", "y", "z", "time")
    if getattr(points, "ndim", 0) != 1 or any(
        n not in names or not np.issubdtype(points.dtype[n], np.floating) for n in wanted
    ):
        counters["scan_layout"] += 1
        return None
    start = int(scan.stamp)
    if len(points) > max_points:
        counters["scan_too_many_points"] += 1
        points = points[:: -(-len(points) // max_points)]
    xyz = np.stack([points["x"], points["y"], points["z"]], axis=1).astype(np.float32, copy=False)
    with np.errstate(invalid="ignore"):
        time = points["time"].astype(np.float64)
    finite = np.isfinite(xyz).all(axis=1) & np.isfinite(time)
    if not finite.all():
        counters["scan_points_not_finite"] += int(len(finite) - finite.sum())
    in_time = (time >= 0.0) & (time <= max_duration)
    if not (in_time | ~finite).all():
        counters["scan_points_out_of_time"] += int((finite & ~in_time).sum())
    with np.errstate(invalid="ignore", over="ignore"):
        square = np.einsum("ij,ij->i", xyz, xyz)
        keep = finite & in_time & (square >= min_range**2) & (square <= max_range**2)
    end = start + round(float(time[finite & in_time].max(initial=0.0)) * NS)
    problem = ""
    if not len(points):
        counters["scan_empty"] += 1
        problem = "scan is empty"
    elif not keep.any():
        counters["scan_no_usable_points"] += 1
        problem = "scan has no usable points"
    return Sweep(start, end, xyz[keep], time[keep], problem, scan.name)
