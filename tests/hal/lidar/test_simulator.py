"""The LiDAR simulator: patterns, motion, errors, repeatability."""

import numpy as np
import pytest

from hal.lidar.beams import measure, moving_rays, turn_beams, unblocked
from hal.lidar.caster import NumbaCaster, OrientedBox, Surface, cast_onto_boxes, pack_boxes
from hal.lidar.simulator import GO2W_BODY, LidarSimulator, LidarTimeError
from hal.lidar.spec import LIDARS
from hal.rotation import rotation_rpy
from hal.types import NS, POINT_DTYPE, POINT_QUANTUM, TIME_QUANTUM, Extrinsics, LidarScan

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
STEP = 5_000_000


def arena() -> NumbaCaster:
    """12 x 12 m, flat, with walls of 1.2 m around."""
    height = np.zeros((241, 241), np.float32)
    height[:3] = height[-3:] = height[:, :3] = height[:, -3:] = 1.2
    return NumbaCaster(Surface(height, 0.05, (-6.0, -6.0)))


def sweep(simulator: LidarSimulator, start: int = 0, step: int = STEP, speed: float = 0.0) -> list[LidarScan]:
    scans = []
    for stamp in range(start, start + 3 * NS // 10 + 1, step):
        pose = np.array([speed * stamp / NS, 0.0, 0.45])
        scan = simulator.advance(stamp, pose, LEVEL)
        if scan is not None:
            scans.append(scan)
    return scans


def xyz(scan: LidarScan) -> np.ndarray:
    return np.stack([scan.points[k] for k in "xyz"], axis=1).astype(float)


def in_base(scan: LidarScan, mount: Extrinsics) -> np.ndarray:
    return xyz(scan) @ rotation_rpy(*mount.rpy).T + np.asarray(mount.translation)


@pytest.mark.parametrize("name", list(LIDARS))
def test_patterns_are_unit_rays_in_time_order_within_the_field_of_view(name: str) -> None:
    spec = LIDARS[name]
    pattern = spec.pattern(7)
    assert len(pattern.directions) == spec.rays
    assert np.linalg.norm(pattern.directions, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert (np.diff(pattern.time) >= 0).all()
    assert pattern.time[0] >= 0
    assert pattern.time[-1] < spec.period
    elevation = np.arcsin(np.clip(pattern.directions[:, 2], -1, 1))
    low, high = spec.elevation
    assert elevation.min() == pytest.approx(low, abs=0.03)
    assert elevation.max() == pytest.approx(high, abs=0.03)
    azimuth = np.arctan2(pattern.directions[:, 1], pattern.directions[:, 0])
    filled = np.histogram(azimuth, bins=36, range=(-np.pi, np.pi))[0]
    assert (filled > 0).all()


def test_only_the_spinning_lidars_repeat_themselves() -> None:
    for name, spec in LIDARS.items():
        same = np.array_equal(spec.pattern(0).directions, spec.pattern(1).directions)
        assert same == (name in ("xt16", "vlp16")) == spec.repeats


def test_decimation_keeps_every_ring() -> None:
    full, half = LIDARS["xt16"], LIDARS["xt16"].decimated(2)
    assert (full.rays, half.rays) == (32_000, 16_000)
    assert set(half.pattern(0).ring) == set(range(16))
    assert np.array_equal(half.pattern(0).directions[:16], full.pattern(0).directions[:16])
    assert np.array_equal(half.pattern(0).directions[16:32], full.pattern(0).directions[32:48])


@pytest.mark.parametrize("name", list(LIDARS))
def test_returns_lie_on_the_terrain(name: str) -> None:
    spec = LIDARS[name].decimated(4)
    simulator = LidarSimulator(spec, spec.mount, arena(), seed=1, noise=False)
    scan = sweep(simulator)[0]
    world = in_base(scan, spec.mount) + np.array([0.0, 0.0, 0.45])
    inside = (np.abs(world[:, :2]) < 5.8).all(axis=1)
    assert inside.sum() > 100
    assert np.abs(world[inside, 2]).max() < POINT_QUANTUM
    walls = ~inside
    assert walls.sum() > 20 or name == "l1"
    assert (np.abs(world[:, :2]).max(axis=1) < 6.0 + POINT_QUANTUM).all()


def test_range_noise_has_the_specified_spread() -> None:
    spec = LIDARS["xt16"]
    quiet = LidarSimulator(spec, spec.mount, arena(), seed=1, noise=False)
    noisy = LidarSimulator(spec, spec.mount, arena(), seed=1)
    clean, real = sweep(quiet)[0], sweep(noisy)[0]
    key = {(r, t): i for i, (r, t) in enumerate(zip(clean.points["ring"], clean.points["time"], strict=True))}
    pairs = [
        (key[k], i)
        for i, k in enumerate(zip(real.points["ring"], real.points["time"], strict=True))
        if k in key
    ]
    a = np.linalg.norm(xyz(clean)[[p[0] for p in pairs]], axis=1)
    b = np.linalg.norm(xyz(real)[[p[1] for p in pairs]], axis=1)
    error = b - a
    assert np.median(np.abs(error)) / 0.6745 == pytest.approx(spec.range_sigma, rel=0.25)
    lost = 1 - len(pairs) / len(clean.points)
    assert spec.dropout < lost < 0.1


def test_same_seed_same_bytes_and_another_seed_differs() -> None:
    spec = LIDARS["mid360"].decimated(8)
    a, b, c = (sweep(LidarSimulator(spec, spec.mount, arena(), seed=s)) for s in (3, 3, 4))
    assert [s.points.tobytes() for s in a] == [s.points.tobytes() for s in b]
    assert a[0].points.tobytes() != c[0].points.tobytes()


def test_slicing_does_not_matter_at_constant_velocity() -> None:
    spec = LIDARS["xt16"].decimated(8)
    fine, coarse = (
        sweep(LidarSimulator(spec, spec.mount, arena(), seed=3), step=s, speed=0.5) for s in (STEP, 10 * STEP)
    )
    assert len(fine) == len(coarse) == 3
    for a, b in zip(fine, coarse, strict=True):
        assert a.stamp == b.stamp
        assert len(a.points) == pytest.approx(len(b.points), abs=3)
        if len(a.points) == len(b.points):
            assert np.abs(xyz(a) - xyz(b)).max() <= 2 * POINT_QUANTUM


def test_a_moving_sensor_distorts_the_scan() -> None:
    spec = LIDARS["xt16"].decimated(4)
    still, moving = (
        sweep(LidarSimulator(spec, spec.mount, arena(), seed=3, noise=False), speed=v)[0] for v in (0.0, 1.0)
    )
    front = lambda s: in_base(s, spec.mount)[np.abs(in_base(s, spec.mount)[:, 1]) < 0.3]  # noqa: E731
    wall = lambda s: front(s)[:, 0].max()  # noqa: E731
    # Forward rays leave half-way through the sweep (azimuth 0 looks back), when the robot is 0.05 m ahead.
    assert wall(still) - wall(moving) == pytest.approx(0.05, abs=0.01)


def test_coordinates_and_times_are_multiples_of_their_quantum() -> None:
    spec = LIDARS["xt16"].decimated(8)
    scan = sweep(LidarSimulator(spec, spec.mount, arena(), seed=3))[0]
    points, time = xyz(scan), scan.points["time"].astype(float)
    assert np.array_equal(np.round(points / POINT_QUANTUM) * POINT_QUANTUM, points)
    assert np.array_equal(np.round(time / TIME_QUANTUM) * TIME_QUANTUM, time)


def test_no_return_from_the_body_and_the_xt16_sees_the_floor_from_1_7_m() -> None:
    spec = LIDARS["xt16"]
    scan = sweep(LidarSimulator(spec, spec.mount, arena(), seed=3, noise=False))[0]
    base = in_base(scan, spec.mount)
    floor = base[base[:, 2] < -0.4]
    reach = np.linalg.norm(floor[:, :2] - spec.mount.translation[:2], axis=1)
    assert 1.7 < reach.min() < 2.2
    assert np.linalg.norm(base, axis=1).min() > 1.0
    # The trunk hides part of the floor behind the sensor, none in front of it.
    assert (floor[:, 0] > 0).sum() > 1.1 * (floor[:, 0] < 0).sum()


def test_a_part_of_the_robot_is_seen_in_its_place_however_the_robot_drives() -> None:
    spec = LIDARS["xt16"].decimated(4)
    part = OrientedBox((-0.3, 0.4, 0.1), (0.06, 0.06, 0.3))
    seen = []
    for speed in (0.0, 1.0):
        simulator = LidarSimulator(spec, spec.mount, arena(), seed=3, noise=False, parts=[part])
        base = in_base(sweep(simulator, speed=speed)[1], spec.mount)
        seen.append(base[np.linalg.norm(base, axis=1) < 1.0])
    assert len(seen[0]) > 10
    np.testing.assert_array_equal(seen[0], seen[1])
    assert (np.abs(seen[0] - part.centre) < np.array(part.size) / 2 + 0.005).all()


def test_a_moving_box_appears_and_goes() -> None:
    spec = LIDARS["xt16"].decimated(4)
    simulator = LidarSimulator(spec, spec.mount, arena(), seed=3, noise=False)
    simulator.set_boxes([OrientedBox((3.0, 0.0, 0.5), (0.4, 0.4, 1.0))])
    near = lambda s: int((np.linalg.norm(in_base(s, spec.mount) - [2.8, 0.0, 0.0], axis=1) < 0.3).sum())  # noqa: E731
    first = sweep(simulator)
    simulator.set_boxes([])
    second = sweep(simulator, start=3 * NS // 10 + STEP)
    assert near(first[1]) > 20
    assert near(second[-1]) == 0


def test_scans_are_stamped_at_multiples_of_the_period_and_time_must_grow() -> None:
    spec = LIDARS["xt16"].decimated(16)
    simulator = LidarSimulator(spec, spec.mount, arena(), seed=3)
    scans = [
        s
        for t in range(13_000_000, NS, STEP)
        if (s := simulator.advance(t, np.array([0, 0, 0.45]), LEVEL)) is not None
    ]
    assert [s.stamp for s in scans] == [k * NS // 10 for k in range(1, 9)]
    assert all(s.points["time"].max() < 0.1 for s in scans)
    with pytest.raises(LidarTimeError, match="grow"):
        simulator.advance(5, np.zeros(3), LEVEL)
    with pytest.raises(LidarTimeError, match="skips"):
        simulator.advance(9 * NS, np.zeros(3), LEVEL)


def test_measuring_agrees_with_plain_numpy() -> None:
    random = np.random.default_rng(0)
    n, stride = 400, 4
    ranges = random.choice([1.0, 1.3, 2.8, np.inf, 0.05, 50.0], n).astype(np.float32)
    cosine, seen = random.random(n, dtype=np.float32), random.random(n) < 0.9
    nominal = random.normal(size=(n, 3)).astype(np.float32)
    draw, noise = random.random((3, n), dtype=np.float32), random.standard_normal(n, dtype=np.float32)
    limits = np.array([0.1, 40.0, 0.02, 0.1, 0.3, 0.4, 0.1, 1.0])
    time, ring = np.sort(random.integers(0, NS // 10, n)), random.integers(0, 16, n).astype(np.uint16)
    got = np.empty(n, POINT_DTYPE)
    m = measure(ranges, cosine, seen, nominal, time, ring, stride, draw, noise, limits, got)
    true = ranges.astype(float)
    there = np.append(true[stride:], np.full(stride, np.inf))
    with np.errstate(invalid="ignore"):
        gap = there - true
    mixed = (draw[0] < 0.4) & (np.abs(gap) > 0.1) & (np.abs(gap) < 1.0)
    r = true.copy()
    r[mixed] += gap[mixed] * draw[0, mixed] / 0.4
    r += 0.02 * noise
    want = seen & np.isfinite(true) & (draw[1] >= 0.1) & (cosine >= 0.3 * draw[2]) & (r >= 0.1) & (r <= 40.0)
    assert mixed.sum() > 10
    assert m == want.sum()
    assert np.array_equal(got["ring"][:m], ring[want])
    assert np.array_equal(got["time"][:m], np.round(time[want] * 1e-9 / TIME_QUANTUM) * TIME_QUANTUM)
    assert np.array_equal(
        got["intensity"][:m], np.round(100.0 * cosine[want].astype(float)).astype(np.float32)
    )
    xyz = np.stack([got[axis][:m] for axis in "xyz"], axis=1)
    points = np.round(nominal[want] * r[want, None] / POINT_QUANTUM) * POINT_QUANTUM
    assert np.abs(xyz - points).max() <= 1.01 * POINT_QUANTUM
    assert (np.abs(xyz - points) > 1e-6).mean() < 0.01


def test_beams_follow_a_plain_pose_interpolation() -> None:
    random = np.random.default_rng(1)
    beams = random.normal(size=(50, 3)).astype(np.float32)
    beams /= np.linalg.norm(beams, axis=1)[:, None]
    alpha = np.linspace(0.0, 1.0, 50)
    rpy0, rpy1 = np.array([0.05, -0.1, 1.0]), np.array([0.07, -0.08, 1.03])
    p0, p1, mount = np.array([1.0, 2.0, 0.4]), np.array([1.1, 2.0, 0.42]), np.array([0.2, 0.1, 0.1])
    origins, directions = np.empty((50, 3), np.float32), np.empty((50, 3), np.float32)
    # A quaternion and its negative are the same attitude.
    time = np.round(alpha * 1e9).astype(np.int64) + 7
    moving_rays(
        beams, time, 7, 10**9 + 7, p0, wxyz(rpy0), p1, -wxyz(rpy1), mount, origins, directions
    )  # fmt: skip
    for k, a in enumerate(alpha):
        r = rotation_rpy(*((1 - a) * rpy0 + a * rpy1))
        assert directions[k] == pytest.approx(r @ beams[k], abs=1e-3)
        assert origins[k] == pytest.approx((1 - a) * p0 + a * p1 + r @ mount, abs=1e-3)
        assert np.linalg.norm(directions[k]) == pytest.approx(1.0, abs=1e-5)


def wxyz(rpy: np.ndarray) -> np.ndarray:
    r, p, y = 0.5 * rpy
    cr, cp, cy, sr, sp, sy = np.cos(r), np.cos(p), np.cos(y), np.sin(r), np.sin(p), np.sin(y)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def test_what_the_body_blocks_agrees_with_casting_onto_its_boxes() -> None:
    random = np.random.default_rng(4)
    beams = random.normal(size=(4000, 3)).astype(np.float32)
    beams /= np.linalg.norm(beams, axis=1)[:, None]
    boxes = pack_boxes((*GO2W_BODY, OrientedBox((0.5, 0.2, 0.3), (0.3, 0.1, 0.4), 0.6)))
    for origin in ((0.16, 0.0, 0.12), (0.29, 0.0, -0.05), (0.0, 0.0, 0.0)):
        rotation = rotation_rpy(0.1, 2.8, -0.3)
        got = np.empty(len(beams), np.bool_)
        unblocked(boxes, np.array(origin), rotation, beams, got)
        turned = (beams @ rotation.T).astype(np.float32)
        ranges = np.full(len(beams), np.inf, np.float32)
        cast_onto_boxes(boxes, np.tile(np.float32(origin), (len(beams), 1)), turned, ranges)
        assert 0.03 < np.isfinite(ranges).mean() < 0.6
        assert (got != np.isinf(ranges)).sum() <= 2  # rounding at an edge


def test_pointing_errors_have_the_specified_spread() -> None:
    random = np.random.default_rng(2)
    nominal = np.tile(np.array([[0.6, 0.0, 0.8]], np.float32), (20_000, 1))
    rotation = rotation_rpy(0.1, -0.4, 2.0)
    out = np.empty_like(nominal)
    turn_beams(nominal, random.random(nominal.shape, dtype=np.float32), 0.002, rotation, out)
    assert np.linalg.norm(out, axis=1) == pytest.approx(1.0, abs=1e-6)
    back = out @ rotation
    aside, across = back @ [0.0, 1.0, 0.0], back @ [0.8, 0.0, -0.6]
    assert aside.std() == pytest.approx(0.002, rel=0.03)
    assert across.std() == pytest.approx(0.002, rel=0.03)
    assert abs(aside.mean()) < 5e-5
    turn_beams(nominal, nominal, 0.0, rotation, out)
    assert np.abs(out @ rotation - nominal).max() < 1e-6
