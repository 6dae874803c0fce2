"""What a run's LiDARs saw, on disk: millimetres as int16, one scan every few centimetres. A kilometre takes about two
gigabytes while a map is built.

Each scan is the length of its head in four bytes, the head as JSON, and its points: a file that its process left behind
is read again up to the last whole scan.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from hal.types import NS, Array
from mapping.closing.graph import levelled
from mapping.elevation.sensor import Sensor
from mapping.thin_cloud import POINT_REACH

SCAN_SPACING = (0.1, math.radians(5.0), 2 * NS)
"""A scan is kept when the robot moved [m] or turned [rad] so far since the last one, or so long after it [ns]."""
MILLIMETRE = 1000.0
LENGTH_BYTES = 4
"""Of the length of a head."""
POINT_BYTES = 6


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One instant of a run."""

    run: int
    stamp: int
    """[ns]"""
    pose: Array
    """(4, 4) base_link in the `odom` of its run."""
    below: float
    """How far the ground is under base_link [m]."""
    contacts: Array
    """(k, 3) bottoms of the wheels in contact, base_link [m]."""
    along: float
    """Driven since the start of its run [m]."""
    clouds: tuple[tuple[Sensor, int, int], ...]
    """Of each LiDAR, where its points begin in the file, and how many they are."""


class Recording:
    """Scans of one or more runs, in order. Close it: the file goes then."""

    def __init__(self, folder: Path | None = None, path: Path | None = None) -> None:
        """`folder`: where the file lies, which has no name there; None: where temporary files do. `path`: of a file
        that outlives its process; what it holds is there again. Raises OSError."""
        self.scans: list[Scan] = []
        self._path, self._end = path, 0
        self._file: IO[bytes]
        if path is None:
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - lives as long as this object
        else:
            self._file = path.open("r+b" if path.is_file() else "w+b")
            self._read()

    def _read(self) -> None:
        """The scans that are there."""
        size = self._file.seek(0, 2)
        while True:
            self._file.seek(self._end)
            length = int.from_bytes(self._file.read(LENGTH_BYTES), "little")
            begin = self._end + LENGTH_BYTES + length
            if not length or begin > size:
                break
            run, stamp, pose, below, contacts, along, heads = json.loads(self._file.read(length))
            clouds = []
            for (origin, range_sigma, beam_sigma, region, levels), count in heads:
                sensor = Sensor(tuple(origin), range_sigma, beam_sigma, tuple(region), levels)
                clouds.append((sensor, begin, count))
                begin += POINT_BYTES * count
            if begin > size:
                break
            wheels = np.array(contacts).reshape(-1, 3)
            self.scans.append(Scan(run, stamp, np.array(pose), below, wheels, along, tuple(clouds)))
            self._end = begin
        self._file.truncate(self._end)

    def _last(self, run: int) -> Scan | None:
        return self.scans[-1] if self.scans and self.scans[-1].run == run else None

    def wants(self, run: int, stamp: int, pose: Array) -> bool:
        """Whether a scan at this stamp [ns] and pose (4, 4) would be kept."""
        last = self._last(run)
        if last is None:
            return True
        a, b = levelled(last.pose), levelled(pose)
        moved, turned = math.dist(a[:2], b[:2]), abs(wrap(b[3] - a[3]))
        near = moved < SCAN_SPACING[0] and turned < SCAN_SPACING[1]
        return not near or stamp - last.stamp >= SCAN_SPACING[2]

    def add(
        self,
        run: int,
        stamp: int,
        pose: Array,
        clouds: Sequence[tuple[Sensor, NDArray[np.float32]]],
        below: float,
        contacts: Array,
    ) -> bool:
        """One scan of every LiDAR: points (n, 3) in base_link, deskewed to `stamp` [ns]; pose (4, 4) of base_link in
        `odom`, how far the ground is under it [m], bottoms of the wheels (k, 3) in base_link. Returns whether it was
        kept. Raises OSError where the disk is full.
        """
        if not self.wants(run, stamp, pose):
            return False
        last = self._last(run)
        along = 0.0 if last is None else last.along + math.dist(levelled(last.pose)[:2], levelled(pose)[:2])
        # without what is no number
        near = [(sensor, cloud[np.square(cloud).sum(axis=1) < POINT_REACH**2]) for sensor, cloud in clouds]
        heads = [(astuple(sensor), len(cloud)) for sensor, cloud in near]
        head = json.dumps([run, stamp, pose.tolist(), below, contacts.tolist(), along, heads]).encode()
        self._file.seek(self._end)
        self._file.write(len(head).to_bytes(LENGTH_BYTES, "little") + head)
        kept, end = [], self._end + LENGTH_BYTES + len(head)
        for sensor, cloud in near:
            self._file.write(np.rint(cloud * MILLIMETRE).astype("<i2").tobytes())
            kept.append((sensor, end, len(cloud)))
            end += POINT_BYTES * len(cloud)
        self._file.flush()  # the process may die
        self._end = end
        self.scans.append(Scan(run, stamp, np.array(pose), below, np.array(contacts), along, tuple(kept)))
        return True

    def points(self, scan: Scan) -> list[tuple[Sensor, NDArray[np.float32]]]:
        """The clouds (n, 3) [m] of a scan in base_link, to the millimetre."""
        out = []
        for sensor, begin, count in scan.clouds:
            self._file.seek(begin)
            raw = np.frombuffer(self._file.read(POINT_BYTES * count), "<i2").reshape(-1, 3)
            out.append((sensor, (raw / np.float32(MILLIMETRE)).astype(np.float32)))
        return out

    @property
    def nbytes(self) -> int:
        """On disk."""
        return self._end

    def close(self) -> None:
        """Delete the file."""
        self._file.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)
