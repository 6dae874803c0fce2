"""The door: everything a driver can send wrong is stopped, counted and named here."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.safety.monitors import POINT_TIMES, STAMP_AHEAD, SWEEP_CLOCK
from hal.sweep_times import TimesError, sweep_times
from hal.types import NS, Array, LidarName, LidarScan

NEAREST_HIT = 0.01
"""A point nearer than this [m] is none: drivers write misses as 0, 0, 0."""
USUAL_SWEEPS = 10
"""Sweeps that tell how far apart they come, and how long before the IMU's samples."""
OVERLAP_SHARE = 1.5
"""Sweeps of one LiDAR follow each other; longer ones than this share of their period are none."""
GAP_ENDS = 3
"""Samples in a row that show that a stream is back after a gap."""
JUMP_BACK = NS
JUMP_AHEAD = 10 * NS
"""A step of a topic's stamps beyond these [ns] is a wrong stamp, or a new clock if the following samples confirm it."""


class TopicClock:
    """Lets only ascending stamps through. A clock that jumped (a 1970 boot clock that was set) is followed once it is
    confirmed; so is a gap."""

    def __init__(self, name: str, confirm: int, counters: Counter[str], ahead: bool = True) -> None:
        """`confirm`: samples in a row on the new clock before it is believed. `ahead`: a stamp that is `STAMP_AHEAD`
        needs followers."""
        self.newest: int | None = None
        self._name, self._confirm, self._counters = name, confirm, counters
        self._ahead = ahead
        self._strange: int | None = None
        self._run = 0
        self.step = 0.0
        """From the last stamp that was believed to the newest [s]."""

    def admit(self, stamp: object) -> str:
        """`ok`, `drop`, `ahead`: dropped until more follow; or `jump`: accepted, and the clock has changed."""
        if isinstance(stamp, bool) or not isinstance(stamp, int | np.integer) or not 0 <= stamp < 2**62:
            self._counters[f"{self._name}_stamp"] += 1
            return "drop"
        stamp = int(stamp)
        if self.newest is None:
            self.newest = stamp
            return "ok"
        step = stamp - self.newest
        self.step = step / NS
        gap = self._ahead and step <= JUMP_AHEAD and STAMP_AHEAD.outside(self.step)
        if -JUMP_BACK <= step <= JUMP_AHEAD and not (gap and not self._goes_on(stamp, GAP_ENDS)):
            self._strange, self._run = None, 0
            if step <= 0:
                self._counters[f"{self._name}_{'duplicate' if step == 0 else 'backward'}"] += 1
                return "drop"
            self.newest = stamp
            return "ok"
        if gap:
            return "ahead"
        if not self._goes_on(stamp, self._confirm):
            return "drop"
        self._counters[f"{self._name}_clock_jump"] += 1
        self.newest, self._strange, self._run = stamp, None, 0
        return "jump"

    def _goes_on(self, stamp: int, confirm: int) -> bool:
        """Whether `confirm` strange stamps came in a row."""
        follows = self._strange is not None and 0 < stamp - self._strange <= NS
        self._run = self._run + 1 if follows else 1
        self._strange = stamp
        if self._run < confirm:
            self._counters[f"{self._name}_strange_stamp"] += 1
        return self._run >= confirm


class SweepClock:
    """Compares the stamps of one LiDAR with those of the IMU, both as they arrive.

    A sweep that ends ahead of the IMU has a wrong stamp. So has one that comes earlier than is usual beside the IMU,
    if a hole in the stamps tells the same step. A late sweep is right, unless its stamps went back first: no delay
    does that. Then its clock was set, and its sweeps are refused until they come as before."""

    def __init__(self) -> None:
        self._lags: deque[int] = deque(maxlen=USUAL_SWEEPS)
        """By how much the newest sweeps that agreed began before the IMU's newest sample [ns]."""
        self._steps: deque[int] = deque(maxlen=USUAL_SWEEPS)
        """From the begin of one sweep to that of the next [ns]."""
        self._start: int | None = None
        self._back = self._hole = False
        """A sweep was stamped into the one before, or beyond the one that was due."""
        self._samples = 0

    def went_back(self) -> None:
        """A sweep was stamped no later than the one before."""
        self._back = True

    @property
    def _period(self) -> float:
        """[ns] from sweep to sweep; infinite before it is known."""
        return float(np.median(self._steps)) if len(self._steps) > 2 else math.inf

    def too_long(self, lasts: int) -> str:
        """That a sweep of `lasts` [ns] goes on while the next ones come, in words; empty where it does not."""
        if not (POINT_TIMES.active and lasts > OVERLAP_SHARE * self._period):
            return ""
        held = f"{lasts / NS:.2f} s of a sweep that comes every {self._period / NS:.2f} s"
        return POINT_TIMES.tell(field="time", held=held)

    def off(self, start: int, end: int, imu: int | None, samples: int) -> float:
        """By how much a sweep from `start` to `end` [ns] is off the clock of the IMU [s], 0 where it agrees.

        `imu`: newest stamp of the IMU [ns]; `samples`: how many it has sent. One that fell silent tells nothing.
        """
        if self._start is not None:
            step = start - self._start
            self._back |= step < (end - start) // 2
            self._hole |= SWEEP_CLOCK.outside((step - self._period) / NS, -math.inf, -SWEEP_CLOCK.low)
            if 0 < step < NS:
                self._steps.append(step)
        self._start = start
        speaks, self._samples = samples >= self._samples + 5, samples
        if imu is None or not speaks:
            return 0.0
        if SWEEP_CLOCK.outside((end - imu) / NS, low=-math.inf):
            return (end - imu) / NS
        lag = imu - start
        early = (min(self._lags, default=lag) - lag) / NS
        late = (lag - max(self._lags, default=lag)) / NS
        if (self._hole or self._back) and SWEEP_CLOCK.outside(early, -math.inf, -SWEEP_CLOCK.low):
            return early
        if self._back and SWEEP_CLOCK.outside(-late):
            return -late
        self._lags.append(lag)
        self._back = self._hole = False
        return 0.0


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
        stamps, rows = [], []
        extra = 0
        for stamp, row in zip(
            reversed(self._stamps), reversed(self._rows), strict=True
        ):  # few are ever needed
            if stamp <= after:
                break
            stamps.append(stamp)
            rows.append(row)
            extra += stamp > until
        last = max(extra - beyond, 0)
        stamps, rows = stamps[last:][::-1], rows[last:][::-1]
        if not stamps:
            return np.empty(0, np.int64), np.empty((0, self._width))
        return np.array(stamps), np.concatenate(rows).reshape(len(rows), self._width)

    def any_between(self, after: int, until: int) -> bool:
        """Whether there is a sample with after < stamp <= until."""
        for stamp in reversed(self._stamps):
            if stamp <= until:
                return stamp > after
        return False

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
    scan: LidarScan, min_range: float, max_range: float, max_points: int, counters: Counter[str]
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
    problem = ""
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = (np.ascontiguousarray(points[axis], np.float32) for axis in "xyz")
        square = x * x + y * y + z * z
        hit = (square >= NEAREST_HIT**2) & (square < np.inf)
        try:
            times = sweep_times(points["time"], hit)
            before = min(times.first, 0)  # where the stamp is that of the end
            start, time = start + before, times.seconds(since_first=before < 0)
        except TimesError as error:
            counters["scan_times"] += 1
            problem = POINT_TIMES.tell(field="time", held=error)
            time = np.full(len(points), np.nan)
    xyz, kept_times = np.empty((len(points), 3), np.float32), np.empty(len(points))
    limits = np.array([min_range**2, max_range**2], np.float32)
    kept, longest = _usable(x, y, z, time, limits, xyz, kept_times)
    finite = np.isfinite(square) & np.isfinite(points["time"])
    if strange := len(points) - int(np.count_nonzero(finite)):
        counters["scan_points_not_finite"] += strange
    if late := int(np.count_nonzero(hit & finite & ~np.isfinite(time))):
        counters["scan_points_out_of_time"] += late
    end = start + round(longest * NS)
    if not len(points):
        counters["scan_empty"] += 1
        problem = "scan is empty"
    elif not kept and not problem:
        counters["scan_no_usable_points"] += 1
        problem = "scan has no usable points"
    return Sweep(start, end, xyz[:kept], kept_times[:kept], problem, scan.name)


@njit(cache=True)
def _usable(x, y, z, time, limits, xyz, times):  # pragma: no cover - compiled
    """Copy the points of squared ranges within `limits` that have a time to the front of `xyz`, `times`.

    Returns their number and the latest time of all that are finite [s].
    """
    kept = 0
    longest = 0.0
    for i in range(len(x)):
        if not (np.isfinite(x[i]) and np.isfinite(y[i]) and np.isfinite(z[i]) and np.isfinite(time[i])):
            continue
        longest = max(longest, time[i])
        square = x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
        if limits[0] <= square <= limits[1]:
            xyz[kept, 0], xyz[kept, 1], xyz[kept, 2] = x[i], y[i], z[i]
            times[kept] = time[i]
            kept += 1
    return kept, longest
