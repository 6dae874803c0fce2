"""The elevation map as its users see it: scans in, patches and grids out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hal.lidar.config import only
from hal.robots.go2w.facts import L1_MOUNT
from hal.types import MountedLidar
from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import MapError
from mapping.elevation.map import ElevationMap
from mapping.elevation.mirror import MapMirror, window_of
from mapping.elevation.sensor import XT16, Sensor
from mapping.elevation.tiles import BRIDGED, CONTACT, LIDAR
from mapping.elevation.wheels_ground import SupportPatch, behind
from tools.bench.perception.map import Mapper, registered
from tools.synthetic import arena_run

LEVEL = (0.0, 0.0, 0.0, 1.0)
HEIGHT = 0.40
SENSOR = np.array([0.1634, 0.0, 0.116])
WHEELS = np.array([[0.2, 0.2, -HEIGHT], [0.2, -0.2, -HEIGHT], [-0.2, 0.2, -HEIGHT], [-0.2, -0.2, -HEIGHT]])


def flat_scan(rng: np.random.Generator, azimuths: int = 2000, noise: float = 0.01) -> np.ndarray:
    """16 rings on flat ground 0.4 m under base_link, (n,3) float32 base_link."""
    azimuth = np.radians(np.arange(azimuths) * 360.0 / azimuths)
    elevation = np.radians(np.arange(-15.0, 0.0, 2.0))
    a, e = np.meshgrid(azimuth, elevation)
    r = (HEIGHT + SENSOR[2]) / np.sin(-e) + rng.normal(0.0, noise, a.shape)
    points = np.stack([r * np.cos(e) * np.cos(a), r * np.cos(e) * np.sin(a), r * np.sin(e)], axis=-1).reshape(
        -1, 3
    )
    return (points + SENSOR).astype(np.float32)


def drive(elevation: ElevationMap, scans: int, seed: int = 1, speed: float = 0.05) -> MapMirror:
    """Drive along x over flat ground, `speed` metres per scan; returns a mirror fed with every delta."""
    rng = np.random.default_rng(seed)
    mirror = MapMirror()
    for k in range(scans):
        stamp = 10**9 + k * 10**8
        pose = (k * speed, 0.3, HEIGHT)
        elevation.fuse_ground(WHEELS, pose, LEVEL, stamp)
        elevation.fuse(flat_scan(rng), pose, LEVEL, stamp)
        if k % 3 == 2:
            elevation.clean()
        if k % 4 == 3 or k == scans - 1:
            for patch in elevation.take_patches():
                mirror.apply(patch)
    return mirror


def test_flat_ground_is_flat_to_five_millimetres() -> None:
    elevation = ElevationMap()
    drive(elevation, 40)
    patch = elevation.full()
    seen = patch.layers["source"] == LIDAR
    error = patch.layers["elevation"][seen]
    assert seen.sum() > 20_000
    assert np.sqrt(np.mean(error**2)) < 0.005
    near = elevation.window(1.0, 0.3, 2.5).layers
    assert near["trusted"][near["source"] == LIDAR].mean() > 0.98


def test_a_mirror_fed_with_deltas_equals_the_map() -> None:
    elevation = ElevationMap()
    mirror = drive(elevation, 30)
    whole = elevation.full()
    got = mirror.read(window_of(whole)).layers
    for name in ("trusted", "source"):
        assert np.array_equal(got[name], whole.layers[name])
    known = np.isfinite(whole.layers["elevation"])
    assert np.array_equal(np.isfinite(got["elevation"]), known)
    gap = np.abs(got["elevation"][known] - whole.layers["elevation"][known])
    assert gap.max() <= elevation.params.patch_step + 1e-6
    assert elevation.take_patches() == []


def test_the_whole_map_comes_with_filled_heights_slope_step_and_age() -> None:
    elevation = ElevationMap()
    x, y = np.meshgrid(np.arange(0.9825, 3.0, 0.005), np.arange(-1.0175, 1.0, 0.005))
    z = np.where(y > 0.5, 0.3, 0.2 * (x - 1.0)) - HEIGHT  # a ramp of 0.2 beside a block
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()]).astype(np.float32)
    for k in range(3):
        elevation.fuse(points, (0.0, 0.0, HEIGHT), LEVEL, 1 + k * 10**8)
    elevation.fuse(points[y.ravel() < 0.0], (0.0, 0.0, HEIGHT), LEVEL, 1 + 15 * 10**8)
    patch = elevation.complete(elevation.boxes()[0])
    layers = patch.layers
    assert np.isfinite(layers["filled"]).all()
    at = lambda name, px, py: layers[name][  # noqa: E731
        round((py - patch.origin[1]) / patch.resolution), round((px - patch.origin[0]) / patch.resolution)
    ]
    assert at("slope", 2.0, -0.4) == pytest.approx(np.arctan(0.2), abs=0.02)
    assert at("step", 2.0, -0.4) == pytest.approx(0.2 * 0.04, abs=0.003)
    assert at("step", 2.0, 0.52) == pytest.approx(0.1, abs=0.02)
    assert np.isnan(at("slope", 0.9, 0.0))
    assert at("age", 2.0, -0.4) == 0.0
    assert at("age", 2.0, 0.4) == pytest.approx(1.3)
    assert np.isnan(at("age", 0.9, 0.0))


def test_same_calls_give_the_same_bytes() -> None:
    first, second = ElevationMap(), ElevationMap()
    drive(first, 12)
    drive(second, 12)
    for name, layer in first.full().layers.items():
        assert layer.tobytes() == second.full().layers[name].tobytes(), name


def test_cells_lie_on_the_world_lattice() -> None:
    elevation = ElevationMap(ElevationConfig(resolution=0.05))
    point = np.array([[2.0, -1.0, -0.4]] * 6, dtype=np.float32)
    elevation.fuse(point, (0.51, 0.26, 0.4), LEVEL, 1)
    grid = elevation.grid()
    r, c = np.argwhere(np.isfinite(grid.height))[0]
    assert grid.origin[0] + c * 0.05 == pytest.approx(2.51, abs=0.025)
    assert grid.origin[1] + r * 0.05 == pytest.approx(-0.74, abs=0.025)
    assert (grid.origin[0] / 0.05) % 1 == pytest.approx(0.0, abs=1e-9)
    assert grid.height[r, c] == pytest.approx(0.0, abs=1e-6)


def test_wheels_fill_the_ground_the_lidar_cannot_see_and_yield_to_it() -> None:
    elevation = ElevationMap()
    assert elevation.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, 1) > 1000
    patch = elevation.window(0.0, 0.0, 0.5)
    assert (patch.layers["source"] == CONTACT).all()
    assert (patch.layers["trusted"] == 1).all()
    np.testing.assert_allclose(patch.layers["elevation"], 0.0, atol=1e-5)
    raised = np.array([[0.6, 0.0, -0.30]] * 6, dtype=np.float32)
    elevation.fuse(raised, (0.0, 0.0, HEIGHT), LEVEL, 2)
    elevation.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, 3, start=True)
    seen = elevation.window(0.6, 0.0, 0.0)
    assert seen.layers["source"][0, 0] == LIDAR
    assert seen.layers["elevation"][0, 0] == pytest.approx(0.10, abs=1e-3)


def test_what_is_taken_for_granted_around_the_wheels_can_be_taken_back() -> None:
    elevation, mirror, rng = ElevationMap(), MapMirror(), np.random.default_rng(6)
    for k in range(3):
        elevation.fuse(flat_scan(rng), (0.0, 0.0, HEIGHT), LEVEL, k + 1)
        elevation.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, k + 1)

    def trusted(*places: float) -> list[bool]:
        for patch in elevation.take_patches():
            mirror.apply(patch)
        grid = mirror.patch().grid()
        c = [round((x - grid.origin[0]) / grid.resolution) for x in places]
        return grid.trusted[round(-grid.origin[1] / grid.resolution), c].tolist()

    between, disc, gap, ring = 0.1, 0.6, 1.3, 2.09
    assert trusted(between, disc, gap, ring) == [True] * 4
    elevation.grant(False)
    assert trusted(between, disc, gap, ring) == [True, False, False, True]
    elevation.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, 9)
    assert trusted(between, disc) == [True, False]
    elevation.grant(True)
    assert trusted(between, gap, ring) == [True, False, True]  # wider than from the disc on
    elevation.fuse_ground(WHEELS, (0.9, 0.0, HEIGHT), LEVEL, 9)
    assert trusted(gap) == [True]


def test_nothing_is_taken_back_from_an_empty_map() -> None:
    """A robot that starts on stairs of 41 deg has entered no ground when its head LiDAR falls silent."""
    elevation = ElevationMap()
    elevation.grant(False)
    assert elevation.store.used == 0


def test_a_map_that_came_back_from_a_reader_takes_back_what_was_granted_before() -> None:
    first, mirror, rng = ElevationMap(), MapMirror(), np.random.default_rng(6)
    for k in range(3):
        first.fuse(flat_scan(rng), (0.0, 0.0, HEIGHT), LEVEL, k + 1)
        first.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, k + 1)
    for patch in first.take_patches():
        mirror.apply(patch)
    again = ElevationMap(first.params)
    again.restore(mirror.patch())

    def trusted(*places: float) -> list[bool]:
        return [bool(again.window(x, 0.0, 0.0).layers["trusted"][0, 0]) for x in places]

    between, disc, ring = 0.1, 0.6, 2.09
    assert trusted(between, disc, ring) == [True] * 3, "a robot that stands can move"
    again.grant(False)
    again.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, 9, start=False)
    assert trusted(between, disc, ring) == [True, False, True]


def test_wheels_tell_nothing_of_the_ground_under_the_nose() -> None:
    elevation = ElevationMap()
    elevation.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, 1, start=False)
    known = np.isfinite(elevation.window(0.0, 0.0, 0.5).layers["elevation"])
    x = 0.04 * (np.flatnonzero(known.any(axis=0)) - known.shape[1] // 2)
    assert np.abs(x).max() <= 0.2


@pytest.mark.parametrize("rise", [[0.20, 0.09, 0.0, 0.0], [0.10, 0.10, 0.0, 0.0], [0.15, 0.0, 0.15, 0.0]])
def test_wheels_on_a_kerb_or_in_the_air_make_no_ground_where_the_lidar_knows_another(
    rise: list[float],
) -> None:
    elevation = ElevationMap()
    x, y = np.meshgrid(np.arange(-0.6, 0.2, 0.02), np.arange(-0.6, 0.6, 0.02))
    behind = np.stack([x + 3.0, y, np.full_like(x, -HEIGHT)], axis=-1).reshape(-1, 3).astype(np.float32)
    for k in range(3):
        elevation.fuse(behind, (-3.0, 0.0, HEIGHT), LEVEL, k + 1)
    raised = WHEELS + np.column_stack([np.zeros((4, 2)), rise])
    elevation.fuse_ground(raised, (0.0, 0.0, HEIGHT), LEVEL, 4, start=False)
    assert np.nanmax(elevation.window(0.3, 0.0, 0.4).layers["elevation"]) < 0.01
    edge = WHEELS[[0, 2]] + [
        [0.08, 0.0, rise[0]],
        [0.0, 0.0, 0.0],
    ]  # of two, one hangs over the far side of the edge
    elevation.fuse_ground(edge, (0.0, 0.0, HEIGHT), LEVEL, 4, start=False)
    assert np.nanmax(elevation.window(0.3, 0.0, 0.4).layers["elevation"]) < 0.01
    assert elevation.fuse_ground(WHEELS, (0.2, 0.0, HEIGHT), LEVEL, 5, start=False) > 25


def test_wheels_on_a_kerb_the_lidar_knows_make_no_ramp_behind_it() -> None:
    elevation = ElevationMap()
    x, y = np.meshgrid(np.arange(-0.6, 0.26, 0.02), np.arange(-0.6, 0.6, 0.02))
    z = np.where(x > 0.15, 0.1, 0.0) - HEIGHT
    kerb = np.stack([x + 3.0, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    for k in range(3):
        elevation.fuse(kerb, (-3.0, 0.0, HEIGHT), LEVEL, k + 1)
    raised = WHEELS + np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.1], [0.0] * 3, [0.0] * 3])
    assert elevation.fuse_ground(raised, (0.0, 0.0, HEIGHT), LEVEL, 4, start=False) < 10, (
        "the wheels' own spots"
    )
    around = elevation.window(0.3, 0.0, 0.4).layers["elevation"]
    assert np.nanmax(around) < 0.11
    known = around[np.isfinite(around)]
    assert (np.minimum(np.abs(known), np.abs(known - 0.1)) < 0.01).all(), "no ramp"


def test_three_wheels_on_rubble_tell_of_their_own_spots_where_the_lidar_contradicts_their_plane() -> None:
    elevation = ElevationMap()
    x, y = np.meshgrid(np.arange(-0.08, 0.08, 0.01), np.arange(-0.08, 0.08, 0.01))
    pit = np.stack([x + 3.0, y, np.full_like(x, -0.15 - HEIGHT)], axis=-1).reshape(-1, 3).astype(np.float32)
    for k in range(3):
        elevation.fuse(pit, (-3.0, 0.0, HEIGHT), LEVEL, k + 1)
    entered = elevation.fuse_ground(WHEELS[:3], (0.0, 0.0, HEIGHT), LEVEL, 4)
    assert 30 < entered < 80, "three discs of 0.1 m, not the ground around the robot"
    layers = elevation.window(0.0, 0.0, 0.8).layers
    spots = layers["source"] == CONTACT
    np.testing.assert_allclose(layers["elevation"][spots], 0.0, atol=1e-5)
    assert np.nanmin(elevation.window(0.0, 0.0, 0.05).layers["elevation"]) == pytest.approx(-0.15, abs=0.01)


def test_wheels_on_a_tile_that_nobody_saw_find_the_pool_of_tiles_full() -> None:
    elevation = ElevationMap()
    store = elevation.store
    far = 1 + int(20.0 / elevation.params.resolution) >> store.shift
    while store.used < store.touched.size:
        store.allocate(far, far + store.used)
    assert elevation.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, 1) > 1000


def test_two_wheels_on_the_ground_tell_of_their_own_spots_only() -> None:
    elevation = ElevationMap()
    raised = WHEELS[[0, 3]] + [[0.0, 0.0, 0.1], [0.0, 0.0, 0.0]]
    entered = elevation.fuse_ground(raised, (0.0, 0.0, HEIGHT), LEVEL, 1)
    assert 20 < entered < 50
    layers = elevation.window(0.0, 0.0, 0.8).layers
    known = layers["source"] == CONTACT
    assert known.sum() == entered
    assert set(np.round(layers["elevation"][known], 3)) == {np.float32(0.0), np.float32(0.1)}
    assert elevation.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), LEVEL, 2) > 1000  # still the start
    lying = ElevationMap()
    assert lying.fuse_ground(WHEELS, (0.0, 0.0, HEIGHT), (0.7071, 0.0, 0.0, 0.7071), 1) == 0


def test_a_standing_robot_trusts_the_ground_between_the_rings() -> None:
    elevation = ElevationMap()
    drive(elevation, 20, speed=0.0)
    patch = elevation.window(0.0, 0.3, 1.6)
    assert (patch.layers["source"] == BRIDGED).any()
    assert patch.layers["trusted"].mean() > 0.9
    assert np.nanmax(np.abs(patch.layers["elevation"])) < 0.03


@pytest.mark.parametrize(
    ("points", "position", "orientation"),
    [
        (np.zeros((3, 4)), (0, 0, 0), LEVEL),
        (np.zeros(3), (0, 0, 0), LEVEL),
        (np.zeros((3, 3)), (np.nan, 0, 0), LEVEL),
        (np.zeros((3, 3)), (0, 0, 0), (0, 0, 0, 0)),
    ],
)
def test_wrong_input_is_refused_by_name(points, position, orientation) -> None:
    with pytest.raises(MapError):
        ElevationMap().fuse(points, position, orientation, 1)


def test_hostile_points_are_counted_and_survived() -> None:
    points = np.array(
        [
            [np.nan, 0, 0],
            [2, np.inf, 0],
            [0.1, 0.0, 0.0],
            [50, 0, 0],
            [0.35, 0.29, -0.3],
            [2, 0, 3.0],
            [2, 0, -0.4],
        ],
        dtype=np.float32,
    )
    elevation = ElevationMap()
    report = elevation.fuse(points, (0, 0, 0.4), LEVEL, -5)
    assert (report.invalid, report.out_of_range, report.body, report.ceiling, report.used) == (2, 2, 1, 1, 1)
    assert elevation.fuse(np.zeros((0, 3), np.float32), (0, 0, 0.4), LEVEL, -9).cells == 0


def test_a_reset_starts_a_new_epoch_for_readers() -> None:
    elevation = ElevationMap()
    mirror = drive(elevation, 4)
    before = mirror.epoch
    elevation.reset()
    elevation.fuse(np.array([[2.0, 0, -0.4]] * 6, dtype=np.float32), (0, 0, HEIGHT), LEVEL, 10**10)
    for patch in elevation.take_patches():
        mirror.apply(patch)
    assert mirror.epoch == before + 1
    assert np.isfinite(mirror.patch().layers["elevation"]).sum() == 1


def test_a_lost_map_comes_back_from_a_reader() -> None:
    run = arena_run("xt16", duration=4.0)
    mapper = Mapper(run)
    mirror = MapMirror()
    for scan in registered(run):
        mapper.take(scan)
        for patch in mapper.map.take_patches():
            mirror.apply(patch)
    lost = mapper.map.full()
    again = ElevationMap(mapper.map.params)
    assert again.restore(mirror.patch()) > 5000
    for patch in again.take_patches():  # what reads differently after all goes to the reader again
        mirror.apply(patch)
    found = again.full()
    assert found.layers["elevation"].shape == lost.layers["elevation"].shape
    was, now = lost.layers["trusted"] > 0.5, found.layers["trusted"] > 0.5
    assert (was & now).sum() > 0.97 * was.sum()
    both = was & now
    off = np.abs(found.layers["elevation"][both] - lost.layers["elevation"][both])
    assert np.quantile(off, 0.999) < 0.005  # a bridge may run the other way
    with pytest.raises(MapError, match=r"0\.04 m, the map 0\.05 m"):
        ElevationMap(ElevationConfig(resolution=0.05)).restore(lost)
    for name, wrong in (("source", np.nan), ("source", 8.0), ("trusted", -1.0)):
        layer = lost.layers[name].copy()
        layer[3, 4] = wrong
        with pytest.raises(MapError, match=name):
            ElevationMap().restore(replace(lost, layers=lost.layers | {name: layer}))


def test_the_noise_is_that_of_the_lidar() -> None:
    steep = np.array([[0.5, 0.0, -0.4]] * 6, np.float32)
    variance = []
    for model in ("xt16", "mid360"):
        (lidar,) = only(model)
        sensor = Sensor.of(lidar.mounted())
        assert (sensor.range_sigma, sensor.origin) == (lidar.spec.range_sigma, lidar.spec.mount.translation)
        elevation = ElevationMap(ElevationConfig(min_sigma=1e-4))
        elevation.fuse(steep, np.zeros(3), (0, 0, 0, 1), 0, sensor)
        variance.append(np.nanmin(elevation.full().layers["variance"]))
    assert variance[1] > 1.5 * variance[0]


def test_the_head_lidar_maps_the_ground_ahead_alone_and_tells_no_drift() -> None:
    head = Sensor.of(MountedLidar("head", "l1", L1_MOUNT))
    ahead, aside, far = [1.0, 0.0, -0.4], [1.0, 1.5, -0.4], [2.5, 0.0, -0.4]
    elevation = ElevationMap()
    report = elevation.fuse(np.array([ahead, aside, far] * 3, np.float32), np.zeros(3), (0, 0, 0, 1), 0, head)
    assert (report.used, report.out_of_range) == (3, 6)
    grid = np.stack(np.meshgrid(np.linspace(0.6, 1.7, 40), np.linspace(-1, 1, 60), [-0.4]), -1).reshape(-1, 3)
    for sensor, drifts in ((head, False), (XT16, True)):
        elevation = ElevationMap()
        for k in range(4):
            elevation.fuse(grid.astype(np.float32), (0, 0, 0.01 * (k == 3)), (0, 0, 0, 1), k * 10**8, sensor)
        assert (elevation.alignment.height != 0.0) == drifts


def test_a_robot_that_starts_in_a_lane_or_before_an_edge_stands_on_ground_on_its_side_alone() -> None:
    wheels = np.array([[0.2, 0.2, -0.4], [0.2, -0.2, -0.4], [-0.2, 0.2, -0.4], [-0.2, -0.2, -0.4]])
    side = np.stack(np.meshgrid(np.linspace(-2, 2, 101), [0.6, 0.64], [0.1]), -1).reshape(-1, 3)
    lane = np.concatenate([side, side * (1, -1, 1)]).astype(np.float32)
    floor = np.stack(np.meshgrid(np.linspace(0.55, 2, 37), np.linspace(-1, 1, 51), [-0.7]), -1).reshape(-1, 3)
    for seen, across in ((lane, 1), (floor.astype(np.float32), 0)):
        elevation = ElevationMap()
        for k in range(4):
            elevation.fuse(seen, (0, 0, 0.4), LEVEL, 1 + k * 10**8)
            elevation.fuse_ground(wheels, (0, 0, 0.4), LEVEL, 1 + k * 10**8)
        patch = elevation.full()
        r, c = np.nonzero(patch.layers["source"] == CONTACT)
        far = ((patch.origin[0] + 0.04 * c), np.abs(patch.origin[1] + 0.04 * r))[across]
        assert len(far) > 400
        assert far.max() < (0.58 if across else 0.54)


def test_wheel_ground_that_a_ray_passes_under_is_none() -> None:
    wheels = np.array([[0.2, 0.2, -0.4], [0.2, -0.2, -0.4], [-0.2, 0.2, -0.4], [-0.2, -0.2, -0.4]])
    elevation = ElevationMap()
    elevation.fuse_ground(wheels, (0, 0, 0.4), LEVEL, 1)

    def stood_on(x0: float, x1: float) -> int:
        """Trusted wheel cells there."""
        patch = elevation.full()
        r, c = np.nonzero((patch.layers["trusted"] > 0) & (patch.layers["source"] == CONTACT))
        x, y = patch.origin[0] + 0.04 * c, patch.origin[1] + 0.04 * r
        return np.count_nonzero((x > x0) & (x < x1) & (np.abs(y) < 0.1))

    assert stood_on(0.7, 0.85) >= 10
    beside = stood_on(-0.8, 0.3)
    below = np.stack(np.meshgrid(np.linspace(1.5, 3, 60), np.linspace(-0.3, 0.3, 60), [-1.4]), -1).reshape(
        -1, 3
    )
    head = Sensor.of(MountedLidar("head", "l1", L1_MOUNT))  # the rays pass an edge 0.5 m ahead
    elevation.fuse(below.astype(np.float32), (0, 0, 0.4), LEVEL, 2, head)
    elevation.clean()
    assert stood_on(0.7, 0.85) == 0
    assert stood_on(-0.8, 0.3) == beside


def test_ground_on_one_side_of_the_robot_is_continued_up_to_what_stands_there() -> None:
    """The robot's own cell may lie outside the patch: cells were dropped on that side."""
    i, j = np.meshgrid(np.arange(3, 8), np.arange(-7, -2), indexing="ij")
    zero = np.zeros(25, np.float32)
    patch = SupportPatch(i.ravel(), j.ravel(), zero, zero, np.ones(25, bool))
    wall = (patch.j == -5) & (patch.i == 5)
    hidden = behind(patch, wall, np.array([0.0, 0.2]), 0.04)
    assert hidden[(patch.i == 5) & (patch.j == -6)].all()
    assert not hidden[patch.j > -5].any()
    assert not behind(patch, np.zeros(25, bool), np.array([0.0, 0.0]), 0.04).any()


def square() -> np.ndarray:
    """A square of ground around the robot, in base_link."""
    x, y = np.meshgrid(np.linspace(-3.0, 3.0, 150), np.linspace(-3.0, 3.0, 150))
    return np.stack([x, y, np.full_like(x, -0.4)], -1).reshape(-1, 3).astype(np.float32)


@pytest.mark.parametrize("place", [5e6, -1e9, 1e38, 90_000.0])
def test_a_pose_too_far_from_the_map_is_refused_and_costs_no_memory(place: float) -> None:
    elevation = ElevationMap()
    elevation.fuse(square(), (0.0, 0.0, 0.4), LEVEL, 1)
    before, held = elevation.full(), elevation.store.nbytes
    with pytest.raises(MapError, match=r"tiles away|km from the origin"):
        elevation.fuse(square(), (place, 0.0, 0.4), LEVEL, 2)
    with pytest.raises(MapError, match=r"tiles away|km from the origin"):
        elevation.fuse_ground(np.full((4, 3), -0.4), (0.0, place, 0.4), LEVEL, 2)
    assert elevation.store.nbytes == held
    after = elevation.full()
    assert after.cell == before.cell
    np.testing.assert_array_equal(after.layers["elevation"], before.layers["elevation"])


@pytest.mark.parametrize("far", [3e38, 2e38, 1e30, np.inf])
def test_a_point_beyond_all_distances_has_no_ray(far: float) -> None:
    """Its end is infinite in single precision, and the clean-up never came to it."""
    elevation = ElevationMap()
    points = np.concatenate([square(), np.array([[far, far, 0.5], [far, -far, -far]], np.float32)])
    report = elevation.fuse(points, (0.0, 0.0, 0.4), (0.0, 0.0, np.sin(0.4), np.cos(0.4)), 1)
    assert report.invalid == 2
    assert np.isfinite(elevation._ends[: elevation._rays]).all()
    elevation.clean()


def test_a_refused_scan_leaves_no_rays_behind() -> None:
    elevation = ElevationMap()
    elevation.fuse(square(), (0.0, 0.0, 0.4), LEVEL, 1)
    with pytest.raises(MapError):
        elevation.fuse(square(), (90_000.0, 0.0, 0.4), LEVEL, 2)
    assert elevation._rays == 0
    assert elevation.clean() == 0


def test_a_map_that_begins_far_from_the_origin_is_the_same_map_and_no_larger() -> None:
    here, there = ElevationMap(), ElevationMap()
    shift = 48_000.0
    for elevation, x in ((here, 0.0), (there, shift)):
        elevation.fuse(square(), (x, -x, 0.4), LEVEL, 1)
    assert there.store.nbytes <= here.store.nbytes
    known, heights = zip(*(cells_seen(elevation) for elevation in (here, there)), strict=True)
    assert known[0] > 1000
    assert known[1] == pytest.approx(known[0], rel=0.02)
    assert max(np.abs(h).max() for h in heights) < 0.01


def cells_seen(elevation: ElevationMap) -> tuple[int, np.ndarray]:
    """How many cells the LiDAR has seen, and their heights."""
    seen = elevation.store.cells[elevation.store.cells["source"] == LIDAR]
    return len(seen), seen["height"]


def test_a_map_too_large_to_be_read_as_a_whole_says_so() -> None:
    elevation = ElevationMap()
    for x in (0.0, 1500.0):
        elevation.fuse(square(), (x, x, 0.4), LEVEL, 1)
    with pytest.raises(MapError, match="too large"):
        elevation.full()
    assert elevation.window(1500.0, 1500.0, 4.0).layers["elevation"].size > 100


def test_what_a_map_says_does_not_hang_on_how_much_is_unseen_around_it() -> None:
    """Reads go no further than the tiles reach: with tiles of nothing far around they go over all of it."""
    near, far = ElevationMap(), ElevationMap()
    for row in (-12, 12):
        for col in (-12, 12):
            far.store.allocate(row, col)
    wide = [mirror.patch() for mirror in (drive(near, 7), drive(far, 7))]
    for name, layer in wide[0].layers.items():
        np.testing.assert_array_equal(layer, wide[1].layers[name])
    for x, half in ((0.0, 2.8), (11.0, 2.8), (60.0, 0.5)):
        one, other = near.window(x, 0.3, half), far.window(x, 0.3, half)
        assert (one.origin, one.shape) == (other.origin, other.shape)
        for name, layer in one.layers.items():
            np.testing.assert_array_equal(layer, other.layers[name])
