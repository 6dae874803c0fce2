"""The robot's own parts in what its LiDARs see: the one filter that takes them out, and who notices parts that it does
not know.

A part does not move in base_link while everything else does. So it is taken out where each point was measured, before
motion compensation smears it, and all that read clouds (registration, map, guard) never see it.
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

from hal.robots import describe
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
        return self

    @property
    def size(self) -> tuple[float, ...]:
        """Lengths of its sides [m]."""
        return tuple(b - a for a, b in zip(self.low, self.high, strict=True))

    def holds(self, place: Array) -> bool:
        """Whether `place` (3,) [m] lies in it."""
        return bool((place > self.low).all() and (place < self.high).all())

    def __str__(self) -> str:
        low, high = (", ".join(f"{v:.3f}" for v in corner) for corner in (self.low, self.high))
        return f"{{low: [{low}], high: [{high}]}}"


PART_MARGIN = 0.03
"""[m] around a part: noise of the LiDARs, and what it sways."""


def outline(length: float, width: float) -> Array:
    """(3,) [m] from base_link along each axis: parts of a robot of this size [m] stick out no further."""
    return np.array([length / 2 + 0.3, width / 2 + 0.3, 1.0])


def too_far(parts: Sequence[OwnPart], length: float, width: float) -> str:
    """Why some of `parts` are none of a robot of this size [m], in words; empty where all may be."""
    most = outline(length, width)
    if all((np.abs([part.low, part.high]) <= most).all() for part in parts):
        return ""
    x, y, z = most.tolist()
    return (
        f"a part of the robot lies within {x:.2f} m ahead and behind, {y:.2f} m aside, {z:.2f} m above and below: "
        "more would blind it"
    )


def body_boxes(length: float, width: float) -> tuple[OwnPart, OwnPart]:
    """A robot of this size [m] as it is delivered: the trunk with the LiDAR on its back, and its legs. Not a centimetre
    more of the trunk: what stands there the guard must see."""
    x, y = length / 2, width / 2
    return (
        OwnPart(low=(-x, -y, -0.10), high=(x, y, 0.25)),
        OwnPart(low=(-x, -y - PART_MARGIN, -0.50), high=(x, y + PART_MARGIN, -0.10)),
    )


class OwnFilter:
    """Takes the returns from the robot itself out of sweeps."""

    def __init__(
        self,
        parts: Sequence[OwnPart],
        mounts: Mapping[LidarName, Extrinsics],
        size: tuple[float, float] | None = None,
    ) -> None:
        """`parts`: boxes beside the body; `mounts`: each LiDAR in base_link; `size`: length and width of the body [m],
        None: of the default robot."""
        size = size or (describe().body.length, describe().body.width)
        body, self.outline = body_boxes(*size), outline(*size)
        self._boxes = np.array([(*part.low, *part.high) for part in (*body, *parts)])
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

    def place(self, name: LidarName) -> Array:
        """(3,) of a LiDAR in base_link [m]."""
        return self._mounts[name][1]


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


VOXEL_SIDE = 0.04
"""[m]"""
VOXEL_REACH = 1.0
"""[m] from base_link along each axis to the end of the voxels."""
LOWEST_PART = -0.25
"""[m] above base_link; below, the ground is as near everywhere as a part is."""
LEAST_MOVE, LEAST_TURN = 0.1, 0.1
"""[m], [rad] between two sweeps that are looked at: a robot that stands is told nothing."""
STRETCH_SWEEPS = 20
"""Sweeps after which parts are told, and the next stretch begins: at most 2 m."""
SEEN_SHARE, HIT_SHARE = 0.8, 0.15
"""Share of these sweeps in which a part is seen in a voxel or beside it (noise and sway), and in the voxel itself."""
BIN_ANGLE = math.radians(1.0)
"""[rad] Directions in which rays count as one; 2 cm at `LOOK_RANGE`, from which a LiDAR tells whether a place is empty
[m]."""
LOOK_RANGE = 1.5
GONE_DISTANCE, EMPTY_BEYOND, TAKEN_WITHIN = 0.3, 0.5, 0.1
"""[m] A place is asked about once the robot's part would be so far from it. It is empty where the nearest ray in its
direction ends so far beyond it, and taken where one ends so near it: a ray along a wall tells nothing."""
ENOUGH_ANSWERS, TAKEN_SHARE = 50, 0.05
"""Answers that are needed, and the share of them that may say that something stands there: grass and fences let only
some rays through."""


class OwnParts:
    """Notices parts of the robot that the filter does not know: what stays in its place in base_link while the robot
    moves, although each place in the world where it was is seen to be empty later. Walls along the way stay in their
    place, too, and no ray looks through them.
    """

    def __init__(self, outline: Array) -> None:
        """`outline`: (3,) [m] from base_link, how far parts stick out at most."""
        self._outline = np.minimum(outline, VOXEL_REACH)
        self._side = (2 * round(VOXEL_REACH / VOXEL_SIDE),) * 3
        self._last: Array | None = None
        self.found: tuple[OwnPart, ...] = ()
        self._begin()

    def _begin(self) -> None:
        """A new stretch: a part may be taken off, or put into the configuration."""
        self._sweeps = 0
        self._near = np.zeros(self._side, np.int16)
        """Sweeps with a return in a voxel or beside it,"""
        self._hits = np.zeros(self._side, np.int16)
        """and in the voxel itself."""
        self._empty = np.zeros(self._side, np.int32)
        """Answers of later rays about places of returns in a voxel: a ray passed,"""
        self._taken = np.zeros(self._side, np.int32)
        """or ended there."""
        self._low = np.full((*self._side, 3), np.inf)
        """Of the returns in a voxel [m], base_link."""
        self._high = -self._low
        self._places: list[tuple[Array, NDArray[np.int64], Array]] = []
        """Of each sweep: places of near returns (n, 3) in `odom`, their voxels (n,), the pose (4, 4)."""

    def warm_up(self) -> None:
        """Compile the kernel."""
        _label(self._near > 0, np.zeros(self._side, np.int32))

    def due(self, pose: Array) -> bool:
        """Whether the robot at `pose` (4, 4) in `odom` has moved since the last look."""
        if self._last is None:
            return True
        apart = np.linalg.inv(self._last) @ pose
        moved, turned = math.hypot(apart[0, 3], apart[1, 3]), math.atan2(apart[1, 0], apart[0, 0])
        return moved >= LEAST_MOVE or abs(turned) >= LEAST_TURN

    def look(self, sweeps: Sequence[tuple[Array, NDArray[np.float32], Array]], pose: Array) -> None:
        """A sweep of each LiDAR: points (n, 3) in base_link as measured, the same (n, 3) at the end of the sweep,
        place of the LiDAR (3,), [m]; and the robot's `pose` (4, 4) in `odom` at the end of the sweep."""
        self._last = pose
        self._sweeps += 1
        here = np.zeros(self._side, np.bool_)
        for measured, moved, lidar in sweeps:
            self._ask(moved, lidar, pose)
            near = np.flatnonzero(
                (np.abs(measured) < self._outline).all(axis=1) & (measured[:, 2] > LOWEST_PART)
            )
            points = measured[near]
            at = np.floor((points + VOXEL_REACH) / VOXEL_SIDE).astype(np.int64).clip(0, self._side[0] - 1)
            voxels = np.ravel_multi_index((at[:, 0], at[:, 1], at[:, 2]), self._side)
            here.flat[voxels] = True
            np.minimum.at(self._low.reshape(-1, 3), voxels, points)
            np.maximum.at(self._high.reshape(-1, 3), voxels, points)
            voxels, one = np.unique(voxels, return_index=True)
            self._places.append((moved[near[one]] @ pose[:3, :3].T + pose[:3, 3], voxels, pose))
        self._hits += here
        self._near += _grown(here)
        if self._sweeps == STRETCH_SWEEPS:
            self.found = self._parts()
            self._begin()

    def _ask(self, points: NDArray[np.float32], lidar: Array, pose: Array) -> None:
        """What rays from `lidar` (3,) to `points` (n, 3) [m], base_link, tell of the places that were noted before."""
        if not self._places:
            return
        rays, reach = _directions(points - lidar)
        nearest = np.full(_BIN_COUNT, np.inf)
        np.minimum.at(nearest, rays, reach)
        back = np.linalg.inv(pose)
        for places, voxels, then in self._places:
            now = places @ back[:3, :3].T + back[:3, 3]
            own = (places - then[:3, 3]) @ then[:3, :3]
            bins, away = _directions(now - lidar)
            ends = nearest[bins]
            asked = (
                (np.linalg.norm(now - own, axis=1) > GONE_DISTANCE) & (away < LOOK_RANGE) & np.isfinite(ends)
            )
            np.add.at(self._empty.reshape(-1), voxels[asked & (ends > away + EMPTY_BEYOND)], 1)
            np.add.at(self._taken.reshape(-1), voxels[asked & (np.abs(ends - away) <= TAKEN_WITHIN)], 1)

    def _parts(self) -> tuple[OwnPart, ...]:
        """Boxes around voxels that were seen nearly all the time, joined where they are near each other."""
        always = (self._near >= SEEN_SHARE * self._sweeps) & (self._hits >= HIT_SHARE * self._sweeps)
        label = np.zeros(self._side, np.int32)
        boxes = []
        for group in range(1, _label(always, label) + 1):
            those = label == group
            empty, taken = int(self._empty[those].sum()), int(self._taken[those].sum())
            low, high = (
                self._low[those].min(axis=0) - PART_MARGIN,
                self._high[those].max(axis=0) + PART_MARGIN,
            )
            shown = empty >= ENOUGH_ANSWERS or any(part.holds(0.5 * (low + high)) for part in self.found)
            if shown and taken <= TAKEN_SHARE * empty:
                low, high = np.maximum(low, -self._outline), np.minimum(high, self._outline)
                boxes.append(OwnPart(low=_corner(low), high=_corner(high)))
        return tuple(sorted(boxes, key=lambda box: box.low))

    @property
    def words(self) -> str:
        """For the operator; empty where nothing was found."""
        if not self.found or not OWN_PARTS.active:
            return ""
        return OWN_PARTS.tell(parts=", ".join(map(str, self.found)))


@njit(cache=True)
def _label(marked, label):  # pragma: no cover - compiled
    """Number from 1 into `label` (n, n, n) the groups of voxels that are `marked`, with at most one between neighbours;
    returns how many."""
    n = 0
    side = marked.shape[0]
    edge = [(0, 0, 0) for _ in range(0)]
    for at in range(side**3):
        seed = at // side**2, at // side % side, at % side
        if not marked[seed] or label[seed]:
            continue
        n += 1
        label[seed] = n
        edge.append(seed)
        while len(edge):
            x, y, z = edge.pop()
            for i in range(max(x - 2, 0), min(x + 3, side)):
                for j in range(max(y - 2, 0), min(y + 3, side)):
                    for k in range(max(z - 2, 0), min(z + 3, side)):
                        if marked[i, j, k] and not label[i, j, k]:
                            label[i, j, k] = n
                            edge.append((i, j, k))
    return n


_TURN_BINS = round(2.0 * math.pi / BIN_ANGLE)
_BIN_COUNT = _TURN_BINS * (_TURN_BINS // 2 + 1)


def _directions(rays: Array) -> tuple[NDArray[np.int64], Array]:
    """The bin (n,) and the length (n,) [m] of rays (n, 3)."""
    flat = np.hypot(rays[:, 0], rays[:, 1])
    around = (
        np.floor((np.arctan2(rays[:, 1], rays[:, 0]) + math.pi) / BIN_ANGLE).astype(np.int64) % _TURN_BINS
    )
    up = np.floor((np.arctan2(rays[:, 2], flat) + 0.5 * math.pi) / BIN_ANGLE).astype(np.int64)
    return up * _TURN_BINS + around, np.hypot(flat, rays[:, 2])


def _corner(at: Array) -> Corner:
    x, y, z = np.round(at, 3).tolist()
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
