"""A LiDAR on a moving robot: rays leave in firing order from where the sensor is at that instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos

import numpy as np
from numpy.typing import NDArray

from hal.lidar.beams import measure, moving_rays, turn_beams, unblocked
from hal.lidar.caster import OrientedBox, TerrainCaster, cast_onto_boxes, pack_boxes
from hal.lidar.plants import Clump, cast_clumps, pack_clumps
from hal.lidar.spec import LidarSpec
from hal.rotation import rotation_rpy
from hal.types import POINT_DTYPE, Array, Extrinsics, LidarName, LidarScan

PLANT_SEED = 0x9A55
"""Of the seed that leaves are drawn with."""
MIXED_GAP = (0.10, 1.0)
"""Depth edges [m] at which one pulse sees both sides; beyond the upper one the echoes separate."""


def _leg(x: float, y: float) -> tuple[OrientedBox, OrientedBox]:
    return (
        OrientedBox((x, y, -0.15), (0.22, 0.08, 0.28)),
        OrientedBox((x, y + (0.04 if y > 0 else -0.04), -0.32), (0.24, 0.09, 0.20)),
    )


GO2W_BODY: tuple[OrientedBox, ...] = (
    OrientedBox((0.0, 0.0, 0.0), (0.40, 0.20, 0.114)),
    OrientedBox((0.285, 0.0, 0.02), (0.11, 0.10, 0.08)),
    *_leg(0.193, 0.142),
    *_leg(0.193, -0.142),
    *_leg(-0.193, 0.142),
    *_leg(-0.193, -0.142),
)
"""The default robot as boxes in `base_link`, standing: rays into them are blocked."""


class LidarTimeError(ValueError):
    """`advance` was called with a stamp that is not after the last one or skips a whole sweep."""


@dataclass(slots=True)
class _Sweep:
    """Everything about the sweep in progress; all arrays have one row per ray."""

    start: int
    fired: int
    """Rays cast so far."""
    nominal: NDArray[np.float32]
    """(n, 3) directions the sensor reports, `lidar` frame."""
    time: NDArray[np.int64]
    ring: NDArray[np.uint16]
    beams: NDArray[np.float32]
    """(n, 3) directions the rays really take, `base_link` axes."""
    seen: NDArray[np.bool_]
    """False where the body blocks the ray."""
    ranges: NDArray[np.float32]
    cosine: NDArray[np.float32]
    random: np.random.Generator
    leaves: NDArray[np.float32]
    """(m, n) uniform draws, one for each clump and ray."""


class LidarSimulator:
    """Makes LidarScans from the true base pose. Same seed and poses, same bytes; no ray depends on how `advance` is
    sliced except through the interpolation between the poses it was given.
    """

    def __init__(
        self,
        spec: LidarSpec,
        mount: Extrinsics,
        caster: TerrainCaster,
        seed: int,
        *,
        blocks: Sequence[OrientedBox] = GO2W_BODY,
        noise: bool = True,
        name: LidarName = "main",
        plants: Sequence[Clump] = (),
        parts: Sequence[OrientedBox] = (),
    ) -> None:
        """`blocks`: the robot itself as boxes in base_link, which stop rays; `parts`: boxes that are mounted on it, and
        that the rays hit."""
        self.spec = spec
        self.name = name
        self.mount = mount
        self.caster = caster
        self._seed = (seed,) if name == "main" else (seed, *name.encode())
        """Two LiDARs of a robot make unlike errors."""
        self._noise = noise
        self._rotation = rotation_rpy(*mount.rpy)
        self._offset = np.asarray(mount.translation, np.float64)
        self._body = pack_boxes(tuple(blocks))
        self._boxes = pack_boxes(())
        self._plants = pack_clumps(plants)
        self._parts = pack_boxes(tuple(parts))
        self._pattern: (
            tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.uint16], NDArray[np.bool_]] | None
        )
        self._pattern = None
        self._sweep: _Sweep | None = None
        self._last: tuple[int, Array, Array] | None = None
        self._warm_up()

    def _warm_up(self) -> None:
        """Load or compile every kernel now: the first sweep must not stall the physics."""
        level = np.array([1.0, 0.0, 0.0, 0.0])
        boxes, self._boxes = self._boxes, pack_boxes((OrientedBox((9.0, 0.0, 0.0), (1.0, 1.0, 1.0)),))
        for stamp in (0, self.spec.period):
            self.advance(stamp, np.zeros(3), level)
        self._boxes, self._last, self._sweep, self._pattern = boxes, None, None, None

    def set_boxes(self, boxes: Sequence[OrientedBox]) -> None:
        """Moving obstacles in the world from now on."""
        self._boxes = pack_boxes(tuple(boxes))

    def advance(self, stamp: int, position: Array, quaternion: Array) -> LidarScan | None:
        """Fire all rays due in (last stamp, `stamp`]; returns the finished scan if its sweep ended, else None.

        `stamp` [ns]; `position` (3,) of base_link in the world [m]; `quaternion` (4,) w, x, y, z, world <- base_link.
        Both are kept until the next call. Sweeps start at multiples of the period; the first one at or after the
        first stamp."""
        where = np.ascontiguousarray(position, np.float64), np.ascontiguousarray(quaternion, np.float64)
        pose = (int(stamp), *where)
        if self._last is None:
            self._last = (pose[0] - 1, pose[1], pose[2])
            self._sweep = self._open(-(-pose[0] // self.spec.period) * self.spec.period)
        assert self._sweep is not None
        if pose[0] <= self._last[0]:
            raise LidarTimeError(f"advance to {pose[0]} ns after {self._last[0]} ns: stamps must grow")
        if pose[0] >= self._sweep.start + 2 * self.spec.period:
            raise LidarTimeError(f"advance by {pose[0] - self._last[0]} ns skips a sweep: call it more often")
        scan = None
        self._fire(self._sweep, pose)
        if pose[0] >= self._sweep.start + self.spec.period:
            scan = self._finish(self._sweep)
            self._sweep = self._open(self._sweep.start + self.spec.period)
            self._fire(self._sweep, pose)
        self._last = pose
        return scan

    def _open(self, start: int) -> _Sweep:
        number = start // self.spec.period
        if self._pattern is None or not self.spec.repeats:
            pattern = self.spec.pattern(number)
            self._pattern = (
                pattern.directions,
                pattern.time,
                pattern.ring,
                self._unblocked(pattern.directions),
            )
        nominal, time, ring, seen = self._pattern
        random = np.random.Generator(np.random.SFC64([*self._seed, number]))
        n = len(nominal)
        leaves = np.empty((0, n), np.float32)
        if len(self._plants):  # a generator of its own: what a scene without plants draws stays the same
            own = np.random.Generator(np.random.SFC64([*self._seed, number, PLANT_SEED]))
            leaves = own.random((len(self._plants), n), dtype=np.float32)
        beams = np.empty_like(nominal)
        if self._noise and self.spec.angle_sigma > 0.0:
            error = random.random(nominal.shape, dtype=np.float32)
            turn_beams(nominal, error, self.spec.angle_sigma, self._rotation, beams)
        else:
            turn_beams(nominal, nominal, 0.0, self._rotation, beams)
        return _Sweep(
            start=start,
            fired=0,
            nominal=nominal,
            time=time,
            ring=ring,
            beams=beams,
            seen=seen,
            ranges=np.full(n, np.inf, np.float32),
            cosine=np.zeros(n, np.float32),
            random=random,
            leaves=leaves,
        )

    def _unblocked(self, nominal: NDArray[np.float32]) -> NDArray[np.bool_]:
        seen = np.empty(len(nominal), np.bool_)
        unblocked(self._body, self._offset, self._rotation, nominal, seen)
        return seen

    def _fire(self, sweep: _Sweep, pose: tuple[int, Array, Array]) -> None:
        """Cast the rays of `sweep` that are due by `pose`."""
        assert self._last is not None
        last, p0, q0 = self._last
        first = sweep.fired
        until = int(sweep.time.searchsorted(pose[0] - sweep.start, side="right"))
        if until <= first:
            return
        sweep.fired = until
        due = slice(first, until)
        origins = np.empty((until - first, 3), np.float32)
        directions = np.empty_like(origins)
        begin, end = last - sweep.start, pose[0] - sweep.start
        moving_rays(
            sweep.beams[due], sweep.time[due], begin, end, p0, q0, pose[1], pose[2], self._offset, origins, directions
        )  # fmt: skip
        ranges, sweep.cosine[due] = self.caster.returns(origins, directions)
        if len(self._boxes):
            terrain = ranges.copy()
            cast_onto_boxes(self._boxes, origins, directions, ranges)
            sweep.cosine[due][ranges < terrain] = 1.0
        if len(self._parts):
            scene = ranges.copy()
            here = np.ascontiguousarray(np.broadcast_to(self._offset.astype(np.float32), origins.shape))
            cast_onto_boxes(self._parts, here, np.ascontiguousarray(sweep.beams[due]), ranges)
            sweep.cosine[due][ranges < scene] = 1.0
        if len(self._plants):
            leaf = np.zeros(len(ranges), np.bool_)
            cast_clumps(self._plants, origins, directions, sweep.leaves[:, due], ranges, leaf)
            sweep.cosine[due][leaf] = 1.0
        sweep.ranges[due] = ranges

    def _finish(self, sweep: _Sweep) -> LidarScan:
        """Sensor errors and limits on a complete sweep; misses and body returns are left out."""
        spec, n = self.spec, len(sweep.ranges)
        errors = (spec.range_sigma, spec.dropout, cos(spec.grazing), spec.mixed)
        if self._noise:
            draw = sweep.random.random((3, n), dtype=np.float32)
            noise = sweep.random.standard_normal(n, dtype=np.float32)
        else:
            draw, noise = np.ones((3, n), np.float32), np.zeros(n, np.float32)
            errors = (0.0, 0.0, 0.0, 0.0)
        limits = np.array([spec.min_range, spec.max_range, *errors, *MIXED_GAP])
        points = np.empty(n, POINT_DTYPE)
        m = measure(
            sweep.ranges, sweep.cosine, sweep.seen, sweep.nominal, sweep.time, sweep.ring, spec.rings, draw, noise,
            limits, points
        )  # fmt: skip
        return LidarScan(sweep.start, points[:m], self.name)
