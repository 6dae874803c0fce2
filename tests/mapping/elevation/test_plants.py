"""Leaves are told from what the robot must not touch: kernels against plain numpy, and things under the rays of both
LiDARs."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from hal.lidar import LIDARS, LidarSimulator
from hal.lidar.caster import NumbaCaster, OrientedBox, Surface
from hal.lidar.plants import Clump
from hal.rotation import rotation_rpy
from hal.types import MountedLidar
from mapping.elevation import plants as leaves
from mapping.elevation.config import ElevationConfig
from mapping.elevation.map import ElevationMap
from mapping.elevation.plants import (
    BLOCK_SIDE,
    EMPTY,
    HARD,
    LAYER_COUNT,
    LAYER_HEIGHT,
    LEAFY,
    LOOSE,
    SECTOR_COUNT,
    TALLEST_PLANT,
    PlantVolume,
    add_rays,
    columns,
    drop_thin,
    high_cells,
    sector,
    sectors_of,
    spread,
)
from mapping.elevation.sensor import Sensor
from mapping.elevation.tiles import CONTACT, LIDAR, PLANTS, UNKNOWN
from mapping.grid import ElevationGrid

RES, HEIGHT, PERIOD = 0.04, 0.38, LIDARS["xt16"].period
MESH = -math.log(0.88) / 0.02
"""Leaves per metre of a mesh of 2 cm that stops 12 % of the rays."""


# ------------------------------------------------------------------ kernels


@pytest.mark.parametrize("seed", range(3))
def test_rays_count_as_numpy_counts_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, corner, top = 32, (-10, -14, -3), 0.35
    sensor = np.array([0.03, 0.11, 0.4])
    ends = rng.uniform((-1.5, -1.5, -0.2), (1.5, 1.5, 0.8), (400, 3)).astype(np.float32)
    ends[::40] = np.nan
    near, far = rng.uniform(0.0, 0.3, SECTOR_COUNT), rng.uniform(0.2, 1.2, SECTOR_COUNT)
    near[::7] = np.inf
    shape = n, n, LAYER_COUNT
    way, stops, until = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.int32)
    scratch = (
        np.zeros(shape, np.float32),
        np.zeros(shape, np.float32),
        np.empty(n * n * LAYER_COUNT, np.int32),
    )
    add_rays(
        ends,
        390,
        sensor,
        near,
        far,
        top,
        RES,
        *corner,
        5,
        way,
        stops,
        until,
        *scratch,
    )
    want_way, want_stops = np.zeros(shape), np.zeros(shape)

    def voxel(x: float, y: float, z: float) -> tuple[int, int, int] | None:
        i, j, k = math.floor(y / RES + 0.5), math.floor(x / RES + 0.5), math.floor(z / LAYER_HEIGHT)
        inside = all(0 <= a - b < m for a, b, m in zip((i, j, k), corner, shape, strict=True))
        return (i % n, j % n, k % LAYER_COUNT) if inside else None

    for end in ends[:390].astype(np.float64):
        ray = end - sensor
        away = math.hypot(ray[0], ray[1])
        if not away > RES:
            continue
        s = sector(ray[0], ray[1])
        slope = ray[2] / away
        begin, last = max(near[s], 0.0), min(far[s], away)
        if sensor[2] + slope * begin > top:
            begin = (top - sensor[2]) / slope if slope < 0.0 else math.inf
        if not begin < last:
            continue
        cuts = [begin, last]
        for axis in range(2):
            unit = ray[axis] / away
            lines = (np.arange(-60, 60) - 0.5) * RES
            cuts += [t for t in (lines - sensor[axis]) / unit if begin < t < last]
        for a, b in pairwise(sorted(cuts)):
            at = voxel(*(sensor + ray / away * 0.5 * (a + b)))
            if at is not None:
                want_way[at] += (b - a) * math.hypot(1.0, slope)
        at = voxel(*end)
        if away <= far[s] and at is not None:
            want_stops[at] += 1
    np.testing.assert_allclose(way, want_way, atol=1e-4)
    np.testing.assert_array_equal(stops, want_stops)
    assert (way > 0.0).sum() > 500
    assert stops.sum() > 10
    assert not any(s.any() for s in scratch[:2])
    assert not until.any()


def test_a_voxel_that_stops_all_rays_of_one_scan_is_solid_for_a_while_and_counts_anew() -> None:
    volume = PlantVolume(RES)
    volume.warm_up()
    volume._make()
    sensor = np.array([0.0, 0.0, 0.3])
    volume.rays = leaves.Rays(np.zeros(SECTOR_COUNT), np.full(SECTOR_COUNT, 2.0), 0.6)
    at = 25, 0, 6  # x = 1.0 m, 0.3 m high
    i, j, k = at[1] % len(volume.way), at[0] % len(volume.way), at[2] % LAYER_COUNT
    face = np.tile(np.array([0.985, 0.0, 0.31], np.float32), (12, 1))
    volume.add(face, 6, sensor, 100)  # too few to tell
    assert volume.stops[i, j, k] == 6
    assert volume.until[i, j, k] == 0
    volume.add(face, 12, sensor, 200)
    assert volume.stops[i, j, k] == volume.way[i, j, k] == 0
    assert volume.until[i, j, k] == 200 + leaves.HOLD_TIME


def test_voxels_move_along_and_count_anew_where_the_robot_comes() -> None:
    rng = np.random.default_rng(2)
    volume = PlantVolume(RES)
    volume._make()
    n = volume._shape[0]
    place = np.array([0.3, -0.2, 0.5])
    volume.centre(place)
    held: dict[tuple[int, int, int], float] = {}
    size = volume.way.nbytes
    for _ in range(40):
        place = place + rng.uniform((-0.6, -0.6, -0.12), (0.6, 0.6, 0.12))
        volume.centre(place)
        assert volume._corner is not None
        low = np.array(volume._corner)
        high = low + volume._shape
        held = {at: v for at, v in held.items() if (low <= at).all() and (at < high).all()}
        got = np.argwhere(volume.way > 0.0)
        assert len(got) == len(held)
        for (i, j, k), value in held.items():
            assert volume.way[i % n, j % n, k % LAYER_COUNT] == np.float32(value)
        for at in rng.integers(low, high, (30, 3)):
            i, j, k = (int(v) for v in at)
            held[i, j, k] = float(rng.uniform(0.5, 1.0))
            volume.way[i % n, j % n, k % LAYER_COUNT] = held[i, j, k]
    assert volume.way.nbytes == size
    assert len(held) > 100


def test_high_cells_equal_numpy() -> None:
    rng = np.random.default_rng(4)
    for kind in range(6):
        shape = 45, 52
        height = rng.normal(0.0, 0.005, shape).astype(np.float32)
        height[:, 26:] += (0.0, 0.03, 0.2, 0.0, 0.0, 0.0)[kind]
        height[10:22, 12:20] += 0.3
        height[30:33, 30:33] += 0.6
        source = rng.choice(np.array([LIDAR, LIDAR, CONTACT, UNKNOWN], np.uint8), shape)
        source[12:16, 14:18] = PLANTS if kind == 4 else LIDAR
        if kind == 5:
            source[:] = UNKNOWN
        count = rng.integers(1, 6, shape).astype(np.uint8)
        height[source == UNKNOWN] = np.nan
        ground, high, found = high_cells(height, count, source, 0.1, 3)
        known = (source != UNKNOWN) & ~((source == LIDAR) & (count < 3))
        blocks = [(a, b) for a in range(0, shape[0], BLOCK_SIDE) for b in range(0, shape[1], BLOCK_SIDE)]
        level = {}
        for a, b in blocks:
            near = np.zeros(shape, bool)
            near[max(0, a - BLOCK_SIDE) : a + 2 * BLOCK_SIDE, max(0, b - BLOCK_SIDE) : b + 2 * BLOCK_SIDE] = (
                True
            )
            around = height[near & known]
            around = around[around < around.min(initial=np.inf) + np.float32(leaves.GROUND_BAND)]
            level[a, b] = around.mean(dtype=float) if len(around) >= leaves.GROUND_CELLS else np.nan
        want = np.zeros(shape, bool)
        for r, c in np.ndindex(shape):
            a, b = r // BLOCK_SIDE * BLOCK_SIDE, c // BLOCK_SIDE * BLOCK_SIDE
            g = level[a, b]
            nearby = [
                level.get((a + i, b + j), np.nan)
                for i in (-BLOCK_SIDE, 0, BLOCK_SIDE)
                for j in (-BLOCK_SIDE, 0, BLOCK_SIDE)
            ]
            even = not any(abs(v - g) > leaves.EVEN_RISE for v in nearby)
            high_here = source[r, c] == LIDAR and g + 0.1 < height[r, c] < g + TALLEST_PLANT and even
            want[r, c] = source[r, c] == PLANTS or high_here
            if found:
                expect = height[r, c] if source[r, c] == PLANTS else g
                np.testing.assert_allclose(ground[r, c], expect, atol=1e-5)
        np.testing.assert_array_equal(high, want)
        assert found == want.sum()
        assert (found > 0) == (kind != 5)
    flat = np.zeros((20, 20), np.float32)
    assert (
        high_cells(flat, np.full(flat.shape, 9, np.uint8), np.full(flat.shape, LIDAR, np.uint8), 0.1, 3)[2]
        == 0
    )


def test_rays_past_what_is_thin_are_not_looked_at() -> None:
    rng = np.random.default_rng(8)
    disc = np.add.outer(np.arange(-3, 4) ** 2, np.arange(-3, 4) ** 2) <= 3.75**2
    kept = 0
    for share in (0.3, 0.5, 0.6):
        high = rng.random((40, 50)) < share
        high[:, 20:24] = False
        high[5:35, 22] = True  # a wall
        source = np.where(rng.random(high.shape) < 0.001, PLANTS, LIDAR).astype(np.uint8)
        high |= source == PLANTS
        want = source == PLANTS
        for r in range(34):
            for c in range(44):
                square = np.s_[r : r + 7, c : c + 7]
                if (high[square] & disc).sum() >= 0.5 * disc.sum():
                    want[square] |= high[square] & disc
        got = high.copy()
        assert drop_thin(got, source, 3.75, 0.5) == want.any()
        np.testing.assert_array_equal(got, want)
        kept += want.sum()
    assert kept > 100
    wall = np.zeros((40, 50), np.bool_)
    wall[5:35, 22:24] = True
    assert not drop_thin(wall, np.full(wall.shape, LIDAR, np.uint8), 3.75, 0.5)
    assert not wall.any()


def test_the_rays_to_every_high_cell_are_looked_at_and_few_others() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        high = np.zeros((40, 40), np.bool_)
        a, b = rng.integers(0, 32, 2)
        high[a : a + 6, b : b + 6] = rng.random((6, 6)) < 0.7
        ground = rng.normal(0.0, 0.02, high.shape).astype(np.float32)
        sensor = np.array([*rng.uniform(-1.0, 1.0, 2), 0.5])
        near, far, top = sectors_of(high, ground, -20, -20, sensor, RES)
        angles, reach = [], []
        for r, c in np.argwhere(high):
            dx, dy = (c - 20) * RES - sensor[0], (r - 20) * RES - sensor[1]
            away = math.hypot(dx, dy)
            if away < 2 * RES:
                continue
            for ex, ey in rng.uniform(-0.5 * RES, 0.5 * RES, (20, 2)):
                s = sector(dx + ex, dy + ey)
                assert near[s] <= away - 0.5 * RES
                assert far[s] >= away + 0.5 * RES
            assert top >= ground[r, c] + TALLEST_PLANT
            angles.append(math.atan2(dy, dx))
            reach.append(away)
        for s in np.flatnonzero(far > 0.0):
            t = (s + 0.5) / (SECTOR_COUNT / 4.0)
            a = t if t < 1.0 else 2.0 - t if t < 3.0 else t - 4.0
            middle = math.atan2(a, math.copysign(1.0 - abs(a), abs(t - 2.0) - 1.0))
            apart = [abs(math.remainder(middle - x, math.tau)) for x in angles]
            assert min(apart) < 0.12 + 0.2 / min(reach)
            assert far[s] <= max(reach) + leaves.MOTION_MARGIN + 1e-9


def test_columns_and_their_spread_equal_numpy() -> None:
    rng = np.random.default_rng(6)
    shape, n, corner = (24, 30), 64, (-9, 13, -2)
    met = set()
    for kind in range(8):
        way = rng.choice([0.0, 0.1, 0.5, 4.0], (n, n, LAYER_COUNT), p=[0.04, 0.03, 0.13, 0.8]).astype(
            np.float32
        )
        density = rng.choice([0.2, 3.0, 6.0], (n, n, LAYER_COUNT), p=[0.05, 0.9, 0.05])
        stops = np.round(way * density).astype(np.float32)
        if kind % 2:
            hard = rng.random(way.shape) < 0.003
            stops[hard], way[hard] = 20.0, 0.5
        stops[:, :, rng.integers(7, 10) :] = 0.0  # in the wrapped order of layers
        until = np.where(rng.random(way.shape) < 0.0005, 900, 0).astype(np.int32)
        ground = rng.uniform(-0.06, 0.02, shape).astype(np.float32)
        high = rng.random(shape) < 0.97
        state, tops = columns(high, ground, corner[0], corner[1], corner[2], 500, way, stops, until)
        want = np.zeros(shape, np.uint8)
        for r, c in np.argwhere(high):
            i, j = (corner[0] + r) % n, (corner[1] + c) % n
            first = max(corner[2], math.floor((ground[r, c] + leaves.FOOT_HEIGHT) / LAYER_HEIGHT + 0.5))
            last = min(corner[2] + LAYER_COUNT - 1, math.floor((ground[r, c] + TALLEST_PLANT) / LAYER_HEIGHT))
            ks = np.arange(first, last + 1)
            s, w, u = (v[i, j, ks % LAYER_COUNT].astype(float) for v in (stops, way, until))
            solid = (s >= 4) & (s > leaves.SOLID_DENSITY * w) | (s >= 10) & (s > leaves.LEAF_DENSITY[1] * w)
            hard_here = bool(((u > 500) | solid).any())
            stopped = np.flatnonzero(s >= leaves.LEAST_STOPS)
            top = first + (stopped[-1] if len(stopped) else -1)
            s, w = s[: top + 1 - first], w[: top + 1 - first]
            unknown = w < np.float32(leaves.LEAST_WAY)
            empty = ~unknown & ((s < leaves.LEAST_STOPS) | (s < leaves.LEAF_DENSITY[0] * w))
            leafy = ~unknown & ~empty & (s <= leaves.LEAF_DENSITY[1] * w)
            dense = bool(((s >= 4) & (s > leaves.LEAF_DENSITY[1] * w)).any())
            m = len(s)
            if hard_here:
                want[r, c] = HARD
            elif (
                leafy.sum() >= 2
                and empty.sum() <= leaves.EMPTY_SHARE * m
                and unknown.sum() <= leaves.EMPTY_SHARE * m
            ):
                want[r, c] = LEAFY
            elif m > 0 and not dense and (empty | unknown).sum() < m:
                want[r, c] = LOOSE
            assert tops[r, c] == pytest.approx((top + 1) * LAYER_HEIGHT)
        np.testing.assert_array_equal(state, want)
        met |= set(state.ravel().tolist())

        out = spread(state, 3.75, 0.9)
        disc = np.add.outer(np.arange(-3, 4) ** 2, np.arange(-3, 4) ** 2) <= 3.75**2
        inside = np.zeros(shape, bool)
        for r in range(shape[0] - 6):
            for c in range(shape[1] - 6):
                square = np.s_[r : r + 7, c : c + 7]
                if ((state[square] == LEAFY) & disc).sum() >= 0.9 * disc.sum():
                    inside[square] |= (state[square] == LEAFY) & disc
        for _ in range(leaves.BORDER_RINGS):
            grown = inside.copy()
            for r in range(1, shape[0] - 1):
                for c in range(1, shape[1] - 1):
                    grown[r, c] |= (
                        state[r, c] in (LEAFY, LOOSE) and inside[r - 1 : r + 2, c - 1 : c + 2].any()
                    )
            inside = grown
        expect = np.where(inside, LEAFY, np.where(state == HARD, HARD, EMPTY))
        np.testing.assert_array_equal(out, expect)
        assert not (out[state == HARD] != HARD).any()
    assert met == {EMPTY, LEAFY, HARD, LOOSE}


# ------------------------------------------------------------------ things under the rays


def chair() -> list[OrientedBox]:
    legs = [OrientedBox((a, b, 0.225), (0.03, 0.03, 0.45)) for a in (-0.2, 0.2) for b in (-0.2, 0.2)]
    return [*legs, OrientedBox((0.0, 0.0, 0.435), (0.43, 0.43, 0.03))]


def cylinder(x: float, y: float, width: float, top: float) -> list[OrientedBox]:
    side = width / math.sqrt(2.0)
    return [OrientedBox((x, y, top / 2), (side, side, top), k * math.pi / 8) for k in range(4)]


def rack() -> list[Clump]:
    sides = [Clump((a, 0.0, 0.2), (0.02, 0.8, 0.4), MESH) for a in (-0.15, 0.15)]
    return [*sides, *(Clump((0.0, 0.0, z), (0.27, 0.8, 0.02), MESH) for z in (0.1, 0.2, 0.3))]


THINGS: dict[str, tuple[list[OrientedBox], list[Clump]]] = {
    "chair": (chair(), []),
    "fence": ([], [Clump((0.0, 0.0, 0.25), (0.02, 2.0, 0.5), MESH)]),
    "fence before a wall": (
        [OrientedBox((0.3, 0.0, 0.5), (0.1, 3.0, 1.0))],
        [Clump((0.0, 0.0, 0.2), (0.02, 2.0, 0.4), MESH)],
    ),
    "post": ([OrientedBox((0.0, 0.0, 0.2), (0.05, 0.05, 0.4))], []),
    "row of posts": ([OrientedBox((0.0, 0.15 * k, 0.2), (0.05, 0.05, 0.4)) for k in range(-4, 5)], []),
    "box": ([OrientedBox((0.0, 0.0, 0.15), (0.3, 0.3, 0.3))], []),
    "kerb": ([OrientedBox((0.5, 0.0, 0.075), (1.0, 3.0, 0.15))], []),
    "legs": (cylinder(0.0, -0.12, 0.12, 0.9) + cylinder(0.05, 0.12, 0.12, 0.9), []),
    "stair": (
        [OrientedBox((1.0 + 0.3 * k, 0.0, 0.08 * (k + 1)), (2.0, 2.0, 0.16 * (k + 1))) for k in range(3)],
        [],
    ),
    "rack": ([], rack()),
}
CLUMPS = {
    "small": ([], [Clump((0.0, 0.0, 0.15), (0.35, 0.35, 0.3), 3.0)]),
    "large": ([], [Clump((0.0, 0.0, 0.15), (0.5, 1.0, 0.3), 3.0)]),
    "with a post": (
        [OrientedBox((0.0, 0.1, 0.2), (0.05, 0.05, 0.4))],
        [Clump((0.0, 0.0, 0.15), (0.6, 0.6, 0.3), 3.0)],
    ),
}


class Approach:
    """A robot that drives from 3 m to 1 m before things that stand at the origin, with the true poses; they lie turned
    by `turn` [rad] in the map."""

    def __init__(
        self, things: tuple[list[OrientedBox], list[Clump]], turn: float, seed: int = 1, on: bool = True
    ) -> None:
        boxes, clumps = things
        self.things, self.turn = things, turn
        caster = NumbaCaster(Surface(np.zeros((200, 200), np.float32), 0.05, (-5.0, -5.0)))
        self.map = ElevationMap(ElevationConfig(plants=on))
        self._lidars = [
            (LidarSimulator(LIDARS[n], LIDARS[n].mount, caster, seed=seed, name=name, plants=clumps),
            Sensor.of(MountedLidar(name, n, LIDARS[n].mount)))
            for name, n in (("main", "xt16"), ("head", "l1"))
        ]  # fmt: skip
        self._stamp, self._scans = PERIOD, 0
        self.put(boxes)
        for k in range(21):
            self.look(-3.2 + 0.1 * k)

    def put(self, boxes: list[OrientedBox]) -> None:
        for lidar, _ in self._lidars:
            lidar.set_boxes(boxes)

    def look(self, x: float) -> None:
        """A scan of each LiDAR from x, 0.1 [m]."""
        place, level = np.array([x, 0.1, HEIGHT]), np.array([1.0, 0.0, 0.0, 0.0])
        c, s = math.cos(self.turn), math.sin(self.turn)
        there = np.array([c * x - s * 0.1, s * x + c * 0.1, HEIGHT])
        facing = (0.0, 0.0, math.sin(self.turn / 2), math.cos(self.turn / 2))
        for lidar, sensor in self._lidars:
            scan = None
            for part in (0, PERIOD - 1, PERIOD):  # taken from where the robot is, no distortion to take out
                scan = lidar.advance(self._stamp + part, place, level) or scan
            assert scan is not None
            p, mount = scan.points, lidar.mount
            xyz = np.stack([p["x"], p["y"], p["z"]], axis=1) @ rotation_rpy(*mount.rpy).T + mount.translation
            self.map.fuse(xyz.astype(np.float32), there, facing, self._stamp + PERIOD, sensor)
            if self._scans % 3 == 2:
                self.map.clean()
        if self._scans % 3 == 2:
            self.map.find_plants()
        self._scans += 1
        self._stamp += PERIOD + 1

    def marked(self) -> ElevationGrid:
        return self.map.window(0.0, 0.0, 1.4).grid(filled=True)

    def in_clumps(self) -> np.ndarray:
        """Cells whose middle is in a clump."""
        grid = self.marked()
        rows, cols = grid.shape
        x, y = np.meshgrid(grid.origin[0] + RES * np.arange(cols), grid.origin[1] + RES * np.arange(rows))
        c, s = math.cos(self.turn), math.sin(self.turn)
        u, v = c * x + s * y, c * y - s * x
        out = np.zeros(grid.shape, bool)
        for clump in self.things[1]:
            out |= (abs(u - clump.centre[0]) < clump.size[0] / 2) & (
                abs(v - clump.centre[1]) < clump.size[1] / 2
            )
        return out


@pytest.mark.parametrize("turn", [pytest.param(0.0, marks=pytest.mark.campaign), 0.6])
@pytest.mark.parametrize("name", THINGS)
def test_no_cell_of_a_thing_that_the_robot_must_not_touch_is_taken_for_plants(name: str, turn: float) -> None:
    assert Approach(THINGS[name], turn).marked().plants is None


@pytest.mark.parametrize("turn", [0.0, 0.6])
@pytest.mark.parametrize("name", CLUMPS)
def test_a_clump_becomes_ground_under_leaves(name: str, turn: float) -> None:
    drive = Approach(CLUMPS[name], turn)
    grid, inside = drive.marked(), drive.in_clumps()
    assert grid.plants is not None
    assert (grid.plants & inside).sum() > (0.65 if drive.things[0] else 0.8) * inside.sum()
    assert grid.trusted[grid.plants].all()
    assert np.abs(grid.height[grid.plants]).max() < 0.03
    window = drive.map.window(0.0, 0.0, 1.4).layers
    top = window["upper_bound"][grid.plants]
    assert ((top > 0.2) & (top < 0.36)).mean() > 0.8
    if drive.things[0]:
        c, s = math.cos(turn), math.sin(turn)
        x, y = (round((v - o) / RES) for v, o in zip((-0.1 * s, 0.1 * c), grid.origin, strict=True))
        assert not grid.plants[y, x]
        assert grid.height[y, x] > 0.2


def test_without_the_rule_a_clump_is_a_step() -> None:
    drive = Approach(CLUMPS["small"], 0.0, on=False)
    grid, inside = drive.marked(), drive.in_clumps()
    assert grid.plants is None
    assert (grid.height[inside] > 0.1).mean() > 0.9


def test_a_person_who_steps_into_leaves_is_seen_at_once_and_a_box_soon() -> None:
    for tall, scans in ((0.9, 3), (0.25, 9)):
        drive = Approach(CLUMPS["large"], 0.0)
        before = drive.marked()
        drive.put([OrientedBox((-0.1, 0.1, tall / 2), (0.25, 0.25, tall))])
        for _ in range(scans):
            drive.look(-1.2)
        after = drive.marked()
        row, col = (round((v - o) / RES) for v, o in zip((0.1, -0.2), after.origin[::-1], strict=True))
        # of a low box a LiDAR that stands 1 m before it sees little but the top
        front = np.s_[row - 2 : row + 3, col : col + (1 if tall > 0.5 else 5)]
        assert before.plants is not None
        assert before.plants[front].all()
        assert after.plants is not None
        stands = ~after.plants[front] & (after.height[front] > 0.15)
        assert stands.any(axis=1).all()


def test_what_is_taken_for_plants_outlasts_saving_and_a_reader() -> None:
    from mapping.elevation.mirror import MapMirror

    drive = Approach(CLUMPS["small"], 0.0)
    mirror = MapMirror()
    for patch in drive.map.take_patches():
        mirror.apply(patch)
    want = drive.map.full()
    grid = mirror.grid()
    assert grid.plants is not None
    assert grid.plants.sum() == (want.layers["source"] == PLANTS).sum() > 60
    other = ElevationMap()
    other.restore(want)
    back = other.full().layers
    marked = want.layers["source"] == PLANTS
    np.testing.assert_array_equal(back["source"] == PLANTS, marked)
    for name in ("elevation", "trusted", "upper_bound"):
        np.testing.assert_array_equal(back[name][marked], want.layers[name][marked])
