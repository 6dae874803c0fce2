"""The robot's own parts in what its LiDARs see: the one filter that takes them out, and who notices parts that it does not know.

A part does not move in base_link while everything else does. So it is taken out where each point was measured, before motion compensation
smears it, and all that read clouds (registration, map, guard) never see it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hal.go2w import BODY_LENGTH, BODY_WIDTH
from hal.rotation import rotation_rpy
from hal.safety.monitors import OWN_PARTS
from hal.types import Array, Extrinsics, LidarName
from mapping.odometry.intake import Sweep

Corner = tuple[float, float, float]


class OwnPart(BaseModel):
    """A box of base_link that moves with the robot."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    low: Corner = Field(description="smallest x, y, z [m]")
    high: Corner = Field(description="largest x, y, z [m]")

    @model_validator(mode="after")
    def _is_a_box(self) -> OwnPart:
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise ValueError("`low` must lie below `high` in x, y and z")
        if max(abs(v) for v in (*self.low, *self.high)) > FARTHEST or max(self.size) > LARGEST:
            raise ValueError(
                f"a part of the robot lies within {FARTHEST} m and is no larger than {LARGEST} m: more would blind it"
            )
        return self

    @property
    def size(self) -> tuple[float, ...]:
        """Lengths of its sides [m]."""
        return tuple(b - a for a, b in zip(self.low, self.high, strict=True))

    def __str__(self) -> str:
        low, high = (", ".join(f"{v:.2f}" for v in corner) for corner in (self.low, self.high))
        return f"{{low: [{low}], high: [{high}]}}"


FARTHEST, LARGEST = 1.0, 1.0
"""[m]"""
SPARE = 0.03
"""[m] around a part: noise of the LiDARs, and what it sways."""
BODY = OwnPart(
    low=(-BODY_LENGTH / 2 - SPARE, -BODY_WIDTH / 2 - SPARE, -0.50),
    high=(BODY_LENGTH / 2 + SPARE, BODY_WIDTH / 2 + SPARE, 0.25),
)
"""The robot as it is delivered, its legs and the LiDAR on its back included."""


class OwnFilter:
    """Takes the returns from the robot itself out of sweeps."""

    def __init__(self, parts: Sequence[OwnPart], mounts: Mapping[LidarName, Extrinsics]) -> None:
        """`parts`: boxes beside BODY; `mounts`: each LiDAR in base_link."""
        self._boxes = np.array([(*part.low, *part.high) for part in (BODY, *parts)])
        self._mounts = {
            name: (rotation_rpy(*mount.rpy), np.array(mount.translation)) for name, mount in mounts.items()
        }

    def take_out(self, sweep: Sweep, counters: Counter[str]) -> Sweep:
        """The sweep without what it has of the robot; `counters` tell how much that was."""
        others = self.others(sweep.name, sweep.xyz)
        if others.all():
            return sweep
        counters["scan_points_of_the_robot"] += len(others) - int(others.sum())
        problem = sweep.problem or ("" if others.any() else "scan has no usable points")
        return replace(sweep, xyz=sweep.xyz[others], time=sweep.time[others], problem=problem)

    def others(self, name: LidarName, xyz: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Which points (n, 3) [m] in the frame of the LiDAR `name` are not of the robot."""
        out = np.empty(len(xyz), np.bool_)
        _outside(xyz, *self._mounts[name], self._boxes, out)
        return out

    def in_base(self, name: LidarName, xyz: NDArray[np.float32]) -> Array:
        """Points (n, 3) [m] of a LiDAR in base_link."""
        turn, place = self._mounts[name]
        return xyz.astype(np.float64) @ turn.T + place


@njit(cache=True)
def _outside(xyz, turn, place, boxes, out):  # pragma: no cover - compiled
    """Which points (n, 3) lie in no box (m, 6), once turned (3, 3) and moved (3,)."""
    reach = 0.0  # nothing beyond can be in one
    for b in range(len(boxes)):
        square = 0.0
        for a in range(3):
            square += max(abs(boxes[b, a] - place[a]), abs(boxes[b, a + 3] - place[a])) ** 2
        reach = max(reach, square)
    for i in range(len(xyz)):
        px, py, pz = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        out[i] = True
        if not px * px + py * py + pz * pz < reach:
            continue
        x = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz + place[0]
        y = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz + place[1]
        z = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz + place[2]
        for b in range(len(boxes)):
            low = boxes[b, 0] < x and boxes[b, 1] < y and boxes[b, 2] < z
            if low and x < boxes[b, 3] and y < boxes[b, 4] and z < boxes[b, 5]:
                out[i] = False
                break


VOXEL = 0.04
"""[m]"""
NEAR = 0.8
"""[m] from base_link along each axis: parts stick out no further."""
ABOVE = -0.25
"""[m] below base_link the ground begins to be as near everywhere as a part is."""
DRIVEN = 1.0
"""[m] of driving after which what is still in its place is the robot's,"""
HEADINGS, LEAST_HEADINGS, LEAST_SWEEPS = 12, 9, 3
"""in at least so many of so many headings, the half circle divided, with so many sweeps each: a wall beside the robot is in the same place in one, in its neighbours
at the point where its lines at both headings meet, and a corner in those at right angles."""
SEEN, OFTEN = 0.7, 0.15
"""Share of the sweeps in each of these headings that a part is seen in, and of all sweeps in each of its voxels."""
MOVED, TURNED = 0.04, 0.05
"""[m], [rad] between two sweeps that count: of a robot that stands nothing is told."""


class OwnParts:
    """Notices what stays in its place in base_link while the robot drives and turns: parts of the robot that the filter does not know.

    Voxels around the body count the sweeps that had a return in them, by the heading of the robot. What nearly each sweep of several headings had is no
    part of the scene, which moved by more than its size.
    """

    def __init__(self) -> None:
        self._side = 2 * round(NEAR / VOXEL)
        self._near = np.zeros((HEADINGS, *(self._side,) * 3), np.int16)
        """Sweeps with a return in a voxel or beside it: noise and sway, and a thin part lies on the border of voxels as often as not."""
        self._hits = np.zeros((self._side,) * 3, np.int16)
        """Sweeps with one in the voxel itself."""
        self._sweeps = np.zeros(HEADINGS, np.int64)
        self._last: Array | None = None
        self._driven = 0.0
        self.found: tuple[OwnPart, ...] = ()

    def look(self, points: Array, pose: Array) -> None:
        """A sweep: `points` (n, 3) [m] in base_link as measured, and the robot's `pose` (4, 4) in `odom`."""
        last, self._last = self._last, pose if self._last is None else self._last
        if last is None:
            return
        apart = np.linalg.inv(last) @ pose
        moved, yaw = math.hypot(apart[0, 3], apart[1, 3]), math.atan2(pose[1, 0], pose[0, 0])
        if moved < MOVED and abs(math.atan2(apart[1, 0], apart[0, 0])) < TURNED:
            return
        self._last = pose
        self._driven += moved
        heading = int(yaw % math.pi / math.pi * HEADINGS) % HEADINGS
        self._sweeps[heading] += 1
        near = points[(np.abs(points) < NEAR).all(axis=1) & (points[:, 2] > ABOVE)]
        here = np.zeros(self._hits.shape, np.bool_)
        here[tuple(np.floor((near.T + NEAR) / VOXEL).astype(np.int64).clip(0, self._side - 1))] = True
        self._hits += here
        self._near[heading] += _grown(here)
        told = self._sweeps >= LEAST_SWEEPS
        if self._driven >= DRIVEN and told.sum() >= LEAST_HEADINGS:
            self.found = self._parts(told)
            # The next stretch tells anew: a part may be taken off, or put into the configuration.
            self._near[:] = 0
            self._hits[:] = 0
            self._sweeps[:] = 0
            self._driven = 0.0

    def _parts(self, told: NDArray[np.bool_]) -> tuple[OwnPart, ...]:
        """Boxes around the voxels that were seen nearly all the time in all headings `told`, joined where they are near each other."""
        always = self._hits >= OFTEN * self._sweeps.sum()
        for heading in np.flatnonzero(told).tolist():
            always &= self._near[heading] >= SEEN * self._sweeps[heading]
        left = {(int(i), int(j), int(k)) for i, j, k in np.argwhere(always)}
        boxes = []
        while left:
            group, edge = set(), [left.pop()]
            while edge:
                at = edge.pop()
                group.add(at)
                beside = {o for o in left if max(abs(a - b) for a, b in zip(at, o, strict=True)) <= 2}
                left -= beside
                edge += beside
            low = np.min(list(group), axis=0) * VOXEL - NEAR - SPARE
            high = (np.max(list(group), axis=0) + 1) * VOXEL - NEAR + SPARE
            if max(high - low) <= LARGEST:
                boxes.append(OwnPart(low=_corner(low), high=_corner(high)))
        return tuple(sorted(boxes, key=lambda box: box.low))

    @property
    def words(self) -> str:
        """For the operator; empty where nothing was found."""
        if not self.found or not OWN_PARTS.active:
            return ""
        return OWN_PARTS.tell(parts=", ".join(map(str, self.found)))


def _corner(at: Array) -> Corner:
    x, y, z = np.round(at, 2).tolist()
    return x, y, z


def _grown(here: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Voxels that are set, and those beside them."""
    for axis in range(3):
        here = np.moveaxis(here, axis, 0)
        wide = here.copy()
        wide[1:] |= here[:-1]
        wide[:-1] |= here[1:]
        here = np.moveaxis(wide, 0, axis)
    return here
