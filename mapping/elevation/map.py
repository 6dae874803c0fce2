"""The elevation map: deskewed scans in, a world-fixed map of heights with their certainty out.

    fuse(scan) -> project -> one measurement per cell -> two-mode Kalman -> height drift of the odometry
    fuse_ground(wheels) -> support plane where the LiDAR is blind
    clean() -> what rays look through goes; upper bound of unseen cells
    take_patches() -> cells that changed, for `MapMirror`

Same calls, same bytes: no clock, no randomness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hal.kernels import for_reading
from mapping.elevation import fusion as kernels
from mapping.elevation.align import Alignment
from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import FuseReport, MapError, MapPatch
from mapping.elevation.faces import fill_faces
from mapping.elevation.files import MAX_TILES, check, load_into, read_cloud, restore_store, save_store
from mapping.elevation.holes import Crossing
from mapping.elevation.mirror import BLOCK_SIDE, PART_CELLS
from mapping.elevation.plants import HARD, LEAFY, PlantVolume
from mapping.elevation.poses import checked_pose
from mapping.elevation.prior import PriorCheck
from mapping.elevation.read import Box, MapReader
from mapping.elevation.sensor import XT16, Sensor
from mapping.elevation.tiles import (
    AT_ONCE,
    CONTACT,
    FRESH_CELL,
    LIDAR,
    PLANTS,
    PRIOR,
    UNKNOWN,
    Layers,
    TileStore,
)
from mapping.elevation.visibility import judge, trace
from mapping.elevation.wheels_ground import SupportPatch, carried, enter, entered, take_back
from mapping.grid import ElevationGrid
from mapping.thin_cloud import ThinCloud

CLOUD_EVERY = 10
"""Scans of which one goes into the thinned cloud."""
AT_A_TIME = 300_000
"""Cells of changes that are told at once, 6 MB. A prior map of 100 x 100 m in one go, 125 MB, came in half to its
readers."""
_MOST_HITS = 100_000
"""Most cells one clean-up can look through; the rest waits for the next."""
STEEP_RAYS = 2.0
"""[m] along the ground that the rays of the head's LiDAR are followed in each scan. They alone look into holes, few
into each; `clean` takes the rays of one scan in three."""
_BODY_HEIGHTS = -0.50, 0.25
"""z [m] in base_link between which nothing is mapped beside the body."""
FINEST_CELL = 0.03
"""Cells [m] in which plants are looked for."""
UPRIGHT_COSINE = 0.7
"""Cosine of the tilt of a trunk that stands on its wheels."""
CLOCK_BACK, CLOCK_AHEAD = 10**9, 3600 * 10**9
"""Steps of the stamps beyond these [ns] are a clock that was set."""


@dataclass(frozen=True, slots=True)
class Move:
    """What a map moves by while its scans glide after it."""

    offset: tuple[float, float, float]
    """x, y [m], yaw [rad] of the map of before in the one that comes."""
    lift: float
    """How much higher it lies there [m]."""
    begin: int
    end: int
    """Stamps of the glide [ns]: what was seen before it moves by all of this, what was seen at its end not at all."""

    def of(
        self, place: NDArray[np.float64], seen: NDArray[np.int32], begin: int, end: int
    ) -> NDArray[np.float64]:
        """(n, 2) rows and columns [m] by which cells at `place` (n, 2) move that were `seen` (n,) then; begin, end:
        those of the glide, as `seen` is told."""
        x, y, yaw = self.offset
        c, s = math.cos(yaw), math.sin(yaw)
        row, col = place.T
        whole = np.column_stack([y + s * col + c * row - row, x + c * col - s * row - col])
        left = np.clip((end - seen) / max(end - begin, 1), 0.0, 1.0)
        return np.asarray(left[:, None] * whole)


class ElevationMap:
    """A map in the `map` frame. One instance belongs to one thread."""

    def __init__(self, params: ElevationConfig | None = None, crossing: Crossing = Crossing()) -> None:
        """`crossing`: what the robot that reads it crosses."""
        self.params = p = params or ElevationConfig()
        self.store = TileStore(p.tile_cells)
        self.epoch = 0
        self.alignment = Alignment()
        self.cloud = ThinCloud()
        """What the LiDARs saw beyond ground: walls, for whoever must find the robot in this map later."""
        self.stamp = 0
        self.scans = 0
        self._lived = 0
        self._fresh = True
        self._granted: list[SupportPatch] = []
        """Ground that nobody saw: around the start, and under wheels in what came back from a reader."""
        self._rays = self._half = 0
        self._sensor = np.zeros(3)
        self._around: Layers | None = None
        self._prior: PriorCheck | None = None
        self._buffers(1024)
        x, y = (0.5 * size + beside for size, beside in zip(p.body_size, p.beside, strict=True))
        self._body = np.array([-x, x, -y, y, *_BODY_HEIGHTS])
        self._fuse_rule = np.array(
            [
                p.gate, p.gate_min, p.face, p.clearance, p.up_after, p.down_after, p.min_sigma**2,
                p.drift_sigma**2 / 1000.0, p.trust_sigma**2, p.trust_count, 1000.0 * p.conflict_memory,
                p.alone_count,
            ]
        )  # fmt: skip
        self._looks = np.empty(_MOST_HITS, np.int64), np.empty(_MOST_HITS), np.empty(_MOST_HITS, np.int32)
        self._no_looks = self._looks[0][:0], self._looks[1][:0], self._looks[2][:0]
        self._reader = MapReader(self.store, p, crossing)
        # Finer voxels would take 80 MB, and too few rays go through each.
        self._plants = PlantVolume(p.resolution) if p.plants and p.resolution >= FINEST_CELL else None

    def _buffers(self, n: int) -> None:
        self._cell, self._z = np.empty(n, dtype=np.uint32), np.empty(n, dtype=np.float32)
        self._weight, self._shared = np.empty(n, dtype=np.float32), np.empty(n, dtype=np.float32)
        self._which, self._sums = np.empty(n, dtype=np.int64), np.empty((n, 8), dtype=np.float32)
        self._slot, self._ray = np.empty(n, dtype=np.uint32), np.empty(n, dtype=np.uint32)
        self._ends = np.empty((n, 3), dtype=np.float32)

    def warm_up(self) -> None:
        """Compile (or load) every kernel on a throw-away map."""
        other = ElevationMap(self.params)
        other._prior = PriorCheck()
        other.cloud.enter(np.zeros((1, 3), np.float32))
        other.alignment.to(other.store)
        points = np.array([[2.0, 0.1 * k, -0.4 + 0.1 * (k % 2)] for k in range(8)], dtype=np.float32)
        other.fuse_ground(
            np.array([[0.2, 0.2, -0.4], [0.2, -0.2, -0.4], [-0.2, 0.2, -0.4]]), np.zeros(3), (0, 0, 0, 1), 0
        )
        other.fuse(points, np.zeros(3), (0, 0, 0, 1), 0)
        other.clean()
        other.find_plants()
        if other._plants is not None:
            other._plants.warm_up()
        for patch in other.take_patches():
            patch.with_terrain()
            other.restore(patch)

    def put_on(self, folder: Path) -> None:
        """Put far tiles on this disk and bring them back, from before the first scan on. Nothing that is read out
        differs by that."""
        self.store.put_on(folder)

    def _stay_near(self, most: int = AT_ONCE) -> None:
        side = self.params.tile_cells * self.params.resolution
        col, row = (math.floor(x / side) for x in self._sensor[:2].tolist())
        near = math.ceil(self.params.max_range / side) + 1
        self.store.stay_near(row, col, near, 2 * near, most)

    def reset(self) -> None:
        """Forget everything (the pose jumped, the operator asked). Readers see a new epoch."""
        self._reader.walls.clear(self.store)
        self.store.clear()
        self.epoch += 1
        self.alignment = Alignment()
        self.cloud.clear()
        self.scans = 0
        self._rays = 0
        self._prior = None
        self._fresh = True
        self._granted = []
        if self._plants is not None:
            self._plants.rays = None

    def fuse(
        self,
        points: NDArray[np.float32],
        position: ArrayLike,
        orientation: ArrayLike,
        stamp: int,
        sensor: Sensor = XT16,
        attitude_sigma: float | None = None,
        height_sigma: float | None = None,
    ) -> FuseReport:
        """Fuse one scan.

        points (n,3) float32 in base_link, deskewed to `stamp`; position (3,) and orientation (4,) x, y, z, w of
        base_link in `map`; sensor: the LiDAR that made it; sigmas of the pose override the parameters [rad, m].
        Raises MapError for wrong shapes or a pose that is not finite. A stamp up to a second back counts as the last.
        """
        p = self.params
        points = np.asarray(points)
        if points.ndim != 2 or points.shape[1] != 3:
            raise MapError(f"points must be (n, 3), got {points.shape}")
        points = for_reading(points)
        rotation, place = self.alignment.place(*checked_pose(position, orientation))
        origin = np.asarray(sensor.origin, dtype=np.float64)
        now = self._clock(stamp)
        if len(points) > len(self._z):
            self._buffers(2 * len(points))
        noise = np.array(
            [
                sensor.range_sigma,
                sensor.beam_sigma,
                p.attitude_sigma if attitude_sigma is None else attitude_sigma,
                p.height_sigma if height_sigma is None else height_sigma,
            ]
        )
        self._sensor = place + rotation @ origin
        self._stay_near()
        self._reader.walls.fade(self.store, now)
        limits = np.array([p.min_range, p.max_range, p.ceiling, p.ceiling_slope, *sensor.region])
        drops = np.zeros(7, dtype=np.int64)
        absent = np.zeros(2, dtype=np.int64)
        s = self.store
        self._rays = 0  # what a refused scan leaves in the buffers is nobody's
        while not kernels.project(
            points, rotation, place, origin, limits, self._body, noise, p.resolution,
            s.directory, s.first, s.shift,
            self._cell, self._z, self._weight, self._shared, self._ray, self._ends, drops, absent,
        ):  # fmt: skip
            s.allocate(int(absent[0]), int(absent[1]))
        m, rays = int(drops[kernels.USED]), int(drops[kernels.RAYS])
        k, overhangs = kernels.reduce_cells(
            self._cell, self._z, self._weight, self._shared, m, s.mark, p.surface_band, p.clearance,
            self._which, self._slot, self._sums,
        )  # fmt: skip
        k = fill_faces(
            self._z, self._weight, self._shared, self._slot, m, self._ends, self._ray, self._sensor,
            p.surface_band, p.resolution, s.directory, s.first, s.tiles, s.shift, s.cells, s.mark, self._which,
            self._sums, k,
        )  # fmt: skip
        if sensor.levels and self._lay(k):
            return self.fuse(points, position, orientation, stamp, sensor, attitude_sigma, height_sigma)
        out = np.zeros(6, dtype=np.int64)
        residuals = np.zeros(2)
        kernels.fuse(
            self._which, self._sums, k, s.cells, now, self._fuse_rule, out, residuals,
            s.touched, 2 * s.shift,
        )  # fmt: skip
        apart, agreeing = residuals.tolist()
        if sensor.levels and not self.alignment.active and agreeing >= p.drift_min_cells:
            # a dead band, or the estimate would walk: the map follows the corrected scans
            mean = apart / agreeing
            most, free = min(max(mean, -0.05), 0.05), min(max(mean, -p.drift_free), p.drift_free)
            self.alignment.height -= p.drift_gain * (most - free)
        if self.scans % CLOUD_EVERY == 0:
            self.cloud.add(points, rotation, place)
        self._rays = rays
        if self._plants is not None:
            self._plants.add(self._ends, rays, self._sensor, now)
        self._angle = math.hypot(noise[1], noise[2])
        if not sensor.levels:
            self._trace(1, 0, STEEP_RAYS, self._no_looks)
        self.scans += 1
        out[kernels.OVERHANG] += overhangs
        return kernels.report_of(len(points), drops, out, self.alignment.height)

    def _lay(self, k: int) -> bool:
        """Compare the `k` cells of a scan with the prior map. Returns whether the scan has to be placed again."""
        which, sums = self._which[:k], self._sums[:k]
        if self.alignment.active and self.alignment.take(
            self.store, which, sums, self.params.resolution, self.params.drift_gain
        ):
            return True
        if self._prior is not None and not self._prior.done:
            self._prior.take(self.store, which, sums)
        return False

    def fuse_ground(
        self,
        wheel_contacts: ArrayLike,
        position: ArrayLike,
        orientation: ArrayLike,
        stamp: int,
        start: bool | None = None,
    ) -> int:
        """Enter the ground under the wheels at low confidence; LiDAR-seen cells stay, and LiDAR overrides it.

        wheel_contacts (k,3) bottoms of the wheels in contact, base_link. `start`: fill a disc instead of the footprint;
        by default the first time after a reset. Fewer than three tell of their own spots only. Nothing is entered where
        the LiDAR knows better: under a wheel on a kerb or in the air lies another ground. Returns the number of cells
        entered.
        """
        p = self.params
        contacts = np.asarray(wheel_contacts, dtype=np.float64).reshape(-1, 3)
        rotation, place = self.alignment.place(*checked_pose(position, orientation))
        self._clock(stamp)
        start = self._fresh if start is None else start
        half = (p.footprint[0] / 2 + p.footprint_margin, p.footprint[1] / 2 + p.footprint_margin)
        yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
        world = contacts @ rotation.T + place
        stands_on = carried(self.store, p.resolution, world)
        if not stands_on.any() or rotation[2, 2] < UPRIGHT_COSINE:
            return 0
        radius = p.start_radius if start else None
        around = world[stands_on], place[:2], yaw, half, radius, p.contact_sigma, p.resolution
        written = enter(self.store, *around)
        if start:
            self._fresh = self._fresh and len(contacts) < 3
            self._granted = [written]
        return int(written.i.size)

    def touch(self, x: float, y: float, z: float, yaw: float, stamp: int) -> None:
        """The robot touched something no ray tells of, at x, y [m], z of its base_link [m] by the odometry, as it drove
        along `yaw` [rad].

        It reads as a wall until it fades, or until `forget_touched`. Raises MapError for what is no number.
        """
        if not all(map(math.isfinite, (x, y, z, yaw))):
            raise MapError(f"touched at {x}, {y}, {z}")
        place = x, y, z + self.alignment.height
        self._reader.walls.add(self.store, place, yaw, self.params.resolution, self._clock(stamp))

    @property
    def touched(self) -> int:
        """Walls that were touched and not forgotten."""
        return len(self._reader.walls)

    def forget_touched(self) -> int:
        """Forget what was touched; returns how many walls that were."""
        return self._reader.walls.clear(self.store)

    def grant(self, granted: bool) -> None:
        """Whether ground around the wheels that nobody saw counts: the support plane beyond the body at the start, and
        gaps from there to the nearest ring. At first it does. It is right as long as a LiDAR sees that ground before
        the wheels come there."""
        if granted is self._reader.granted:
            return
        self._reader.granted = granted
        if not granted:
            for written in self._granted:
                take_back(self.store, written)
            self._granted = []
        self.store.touch(CONTACT)

    def clean(self) -> int:
        """Look along the rays of the last scan; returns the number of cells removed. Call it at about 3 Hz."""
        p, s = self.params, self.store
        if self._rays == 0:
            return 0
        # neighbouring rays of a dense scan cross the same cells: alternate halves do
        stride = 2 if self._rays > 8000 else 1
        self._half = 1 - self._half if stride == 2 else 0
        n = self._trace(stride, self._half, p.clean_range, self._looks)
        rule = p.clean_passes, int(1000 * p.clean_unseen), p.trust_count, p.clearance, self._clock(self.stamp)
        return int(judge(*self._looks, n, *rule, s.cells, s.touched, 2 * s.shift))

    def _trace(self, stride: int, first: int, reach: float, looks: tuple[NDArray[Any], ...]) -> int:
        """Along every `stride`-th ray of the last scan, from the `first` on, as far as `reach` [m]; into `looks` what
        it passed through, so many."""
        p, s = self.params, self.store
        return trace(
            self._ends, self._rays, stride, first, self._sensor, s.directory, s.first, s.shift,
            p.resolution, reach, p.clean_skip, p.clean_margin, self._angle, p.trust_count,
            s.cells, s.touched, s.mark, *looks,
        )  # fmt: skip

    def find_plants(self) -> int:
        """Take what the rays of the last scans showed to be leaves for ground, and what turned out to be solid among
        them back; returns how many cells changed. Call it at about 3 Hz."""
        if self._plants is None or self.scans == 0:
            return 0
        p, s, reach = self.params, self.store, self._plants.reach
        x, y, _ = self._sensor.tolist()
        corner = round(y / p.resolution) - reach, round(x / p.resolution) - reach
        if self._around is None:
            cells = 2 * reach + 1, 2 * reach + 1
            floats, small = np.empty((3, *cells), np.float32), np.empty((2, *cells), np.uint8)
            self._around = Layers(floats[0], floats[1], floats[2], small[0], small[1])
        layers = self._around
        s.read(*corner, layers)
        now = self._clock(self.stamp)
        found = self._plants.look(
            layers.height,
            layers.points,
            layers.source,
            corner,
            self._sensor,
            p.plants_above,
            p.trust_count,
            now,
        )
        if found is None:
            return 0
        state, ground, tops = found
        row, col = np.nonzero(
            ((state == LEAFY) & (layers.source == LIDAR)) | ((state == HARD) & (layers.source == PLANTS))
        )
        cell = s.locate(row + corner[0], col + corner[1])
        new = s.cells[cell]
        leaves = state[row, col] == LEAFY
        new[~leaves] = FRESH_CELL
        for name, value in (
            ("height", ground[row, col]),
            ("upper", tops[row, col]),
            ("variance", p.trust_sigma**2 / 4),
            ("source", PLANTS),
            ("count", p.alone_count),
            ("alt", np.nan),
            ("below", np.nan),
            ("streak", 0),
            ("passes", 0),
        ):
            new[name] = np.where(leaves, value, new[name])
        s.cells[cell] = new
        s.changed(cell)
        return len(cell)

    def _clock(self, stamp: int) -> int:
        """Milliseconds lived through; never runs backwards. A source clock that is set (a 1970 boot clock) passes no
        time."""
        step = int(stamp) - self.stamp
        if self.stamp == 0 or not -CLOCK_BACK < step < CLOCK_AHEAD:
            self.stamp = int(stamp)
        elif step > 0:
            self.stamp += step
            self._lived += step
        return min(self._lived // 1_000_000, 2**31 - 1)

    # ------------------------------------------------------------------ files

    def save(self, path: Path, areas: str = "") -> None:
        """Write the whole map, its cloud and a text of what was drawn on it as a versioned .npz. Raises OSError."""
        save_store(self.store, path, self.params.resolution, self.cloud.points, areas)

    def load_prior(self, path: Path) -> int:
        """Start from a map file (see `mapping.elevation.files`); returns its known cells. Readers see a new epoch.

        The first scan takes the map's level, the first few tell whether it fits at all: see `warning`.
        Raises MapError and leaves the present map as it is when the file cannot be used.
        """
        store = TileStore(self.params.tile_cells, self.store.folder)
        known = load_into(store, path, self.params.resolution, self.params.alone_count)
        self._start_on(store, read_cloud(path))
        return known

    def begin_on(self, patches: Sequence[MapPatch], cloud: NDArray[np.float32]) -> int:
        """Start anew from a prior map that came as patches and its cloud (n, 3); see `load_prior`. Raises MapError for
        another resolution."""
        store = TileStore(self.params.tile_cells, self.store.folder)
        tiles = sum(patch.layers["elevation"].size for patch in patches) // store.size**2
        store.reserve(min(tiles, MAX_TILES))  # to grow by and by copies what is there each time
        known = sum(restore_store(store, patch, self.params, PRIOR, sent=False) for patch in patches)
        self._start_on(store, cloud)
        return known

    def follow(self, patches: Sequence[MapPatch], cloud: NDArray[np.float32], until: int, move: Move) -> int:
        """Go on, in the same epoch, with another map of the same ground, which came as patches and its cloud (n, 3);
        returns the cells that are known from it. What was seen after `until` [ns] stays where the other map knows
        nothing, moved by `move`. Raises MapError, and stays as it is, for another resolution."""
        for patch in patches:
            check(patch, self.params)
        s, r = self.store, self.params.resolution
        first = s.keys
        if len(first):
            s.bring(*first.min(axis=0).tolist(), *first.max(axis=0).tolist())
        held = s.cells[: s.used * s.size**2]
        new = np.flatnonzero((held["seen"] > self._since(until)) & (held["source"] != UNKNOWN))
        kept, place = held[new], s.where(new) * np.float64(r)
        place += move.of(place, kept["seen"], self._since(move.begin), self._since(move.end))
        for name in ("height", "alt", "below", "upper"):
            kept[name] += move.lift
        held[:], s.touched[: s.used] = FRESH_CELL, 1
        self._reader.walls.clear(s)
        known = sum(restore_store(s, patch, self.params, PRIOR, sent=False) for patch in patches)
        cell = s.locate(*np.rint(place.T / r).astype(np.int64))
        free = s.cells["source"][cell] == UNKNOWN
        s.cells[cell[free]] = kept[free]
        s.changed(cell)
        self.alignment.height += move.lift
        self.cloud.clear()
        self.cloud.enter(cloud)
        self._granted, self._rays = [], 0
        if self._plants is not None:
            self._plants.rays = None
        return known

    def _since(self, stamp: int) -> int:
        """`seen` of a cell that was seen at `stamp` [ns]."""
        return (self._lived + stamp - self.stamp) // 1_000_000

    def _start_on(self, store: TileStore, cloud: NDArray[np.float32]) -> None:
        self.reset()
        self.cloud.enter(cloud)
        self.store = self._reader.store = store
        self._prior = PriorCheck()
        self.alignment.to(store)

    @property
    def warning(self) -> str:
        """Warning for the operator about the map, in plain words; empty when all is well."""
        fits = self._prior.warning if self._prior is not None else ""
        return "; ".join(filter(None, (fits, self.store.shelf.trouble)))

    def expect(self, blocks: int) -> None:
        """Make room for a map that comes back in so many blocks: to grow by and by copies what is there each time."""
        self.store.reserve(min(blocks * BLOCK_SIDE * BLOCK_SIDE, MAX_TILES))

    def restore(self, patch: MapPatch) -> int:
        """Take over what a reader still has of this map after the map itself was lost; returns the known cells.

        Height, variance, trust and upper bounds come back; counts and the memory of what stood there do not. What was
        bridged is bridged again. A reader does not know which ground of the wheels was driven on and which was granted
        at the start: `grant` takes all of it back but what the wheels enter again. Raises MapError for another
        resolution.
        """
        now = self._clock(patch.stamp)
        self._fresh = False
        known = restore_store(self.store, patch, self.params, now)
        self._reader.walls.restore(self.store, patch, now)
        self._granted.append(entered(patch))
        return known

    # ------------------------------------------------------------------ reading

    def window(self, x: float, y: float, half: float) -> MapPatch:
        """The square of half width `half` [m] around (x, y)."""
        r = self.params.resolution
        n = int(np.ceil(half / r))
        box = (round(y / r) - n, round(x / r) - n, 2 * n + 1, 2 * n + 1)
        return self._reader.read(box, self.stamp, self.epoch)

    def full(self) -> MapPatch:
        """The whole map. Raises MapError while it is empty, and where it is too large for one patch."""
        return self._reader.read_all(self.stamp, self.epoch)

    def boxes(self, most: int = PART_CELLS) -> list[Box]:
        """The whole map as few boxes of whole tiles, one if that has at most so many cells. Raises MapError while it is
        empty."""
        return list(self._reader.boxes(most))

    def read(self, box: Box) -> MapPatch:
        """One of `boxes`."""
        patch = self._reader.read(box, self.stamp, self.epoch)
        # What was brought back for this goes again, or the pool grows by all that is read.
        self._stay_near(self.store.used)
        return patch

    def complete(self, box: Box) -> MapPatch:
        """One of `boxes` for people and their tools: with `age` and the layers of `MapPatch.with_terrain`."""
        patch = self._reader.read(box, self.stamp, self.epoch).with_terrain()
        seen = self.store.seen(box)
        self._stay_near(self.store.used)
        age = np.where(seen == PRIOR, np.nan, 1e-3 * (self._clock(self.stamp) - seen))
        patch.layers["age"] = age.astype(np.float32)
        return patch

    def grid(self) -> ElevationGrid:
        """The whole map as a grid, unknown heights NaN."""
        return self.full().grid()

    def take_patches(self, most: int = AT_A_TIME) -> list[MapPatch]:
        """Cells whose height, trust or source changed since the last call: at most one patch per row of tiles. Of a
        block of tiles that is begun after `most` cells the next call tells."""
        return self._reader.take_changes(self.stamp, self.epoch, most)
