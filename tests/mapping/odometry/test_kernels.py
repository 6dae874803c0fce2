"""Kernels of the odometry against plain-numpy oracles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.robots.go2w.facts import IMU_POSITION, LIMBS, STAND, WHEEL_RADIUS, stand_height, wheel_centres
from hal.rotation import quaternion, rotation, rotation_vector, skew, turn
from hal.types import NS
from mapping.odometry.deskew import deskew, mount_matrix
from mapping.odometry.inertial import InertialConfig, InertialFilter
from mapping.odometry.inertial_kernels import propagate, update_velocity
from mapping.odometry.registration.observability import observed
from mapping.odometry.registration.planes import PLANE_POINTS, SETTLED_POINTS, VoxelPlanes
from mapping.odometry.registration.voxels import voxel_down_sample
from mapping.odometry.wheels import leg_velocity, ways_of_wheels

NOISE = np.array([1e-3, 3e-2, 2e-5, 5e-4])
vectors = st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3).map(np.array)


def exp(v: np.ndarray) -> np.ndarray:
    """Rodrigues."""
    a = np.linalg.norm(v)
    k = skew(v / a) if a > 0 else np.zeros((3, 3))
    return np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * k @ k


@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_rotations_agree_with_rodrigues(a: np.ndarray, b: np.ndarray) -> None:
    q = quaternion(exp(a))
    np.testing.assert_allclose(rotation(q), exp(a), atol=1e-12)
    turn(q, *b)
    np.testing.assert_allclose(rotation(q), exp(a) @ exp(b), atol=1e-12)
    if np.linalg.norm(a) < 3.0:
        np.testing.assert_allclose(rotation_vector(exp(a)), a, atol=1e-7)


@pytest.mark.parametrize(
    ("gap", "wheels", "moved"), [(0.4, False, True), (3.0, False, False), (3.0, True, True)]
)
def test_what_nobody_hears_comes_to_rest(gap: float, wheels: bool, moved: bool) -> None:
    """A body at 0.5 m/s and 0.3 rad/s, whose samples stop for a while; wheels alone let it go on."""
    level = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 9.81])
    state = InertialFilter(InertialConfig())
    state.start(0, np.tile(level, (5, 1)), False, np.array([0.5, 0.0, 0.0]), 0.4)
    there, sigma = state.pose(), np.sqrt(state.p[8, 8])
    stamps = np.array([round((gap + 0.005 * k) * NS) for k in range(3)])
    rolled = np.arange(20_000_000, stamps[0] if wheels else 0, 20_000_000)
    speed = np.tile([0.5, 0.0, 0.0], (len(rolled), 1))
    state.advance(int(stamps[-1]), stamps, np.tile(level, (3, 1)), rolled, speed, 0.1 + 0.0 * speed)
    way = float(np.linalg.norm(state.pose()[:3, 3] - there[:3, 3]))
    if moved:
        assert way > 0.7 * 0.5 * gap
        assert np.linalg.norm(state.x[3:6]) > 0.4
    else:
        assert way < 0.02
        assert np.linalg.norm(state.x[3:6]) < 0.02
        assert np.sqrt(np.diag(state.p)[[0, 8]]) == pytest.approx([0.2, np.hypot(0.2, sigma)], rel=0.2)


def random_state(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    x = rng.normal(size=16)
    x[6:10] /= np.linalg.norm(x[6:10])
    x[10:] *= 0.01
    root = rng.normal(size=(15, 15)) * 0.1
    return x, root @ root.T + 0.01 * np.eye(15)


def boxplus(x: np.ndarray, d: np.ndarray) -> np.ndarray:
    out = x.copy()
    out[:6] += d[:6]
    out[6:10] = quaternion(rotation(x[6:10]) @ exp(d[6:9]))
    out[10:] += d[9:]
    return out


def boxminus(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    turned = rotation_vector(rotation(b[6:10]).T @ rotation(a[6:10]))
    return np.concatenate([a[:6] - b[:6], turned, a[10:] - b[10:]])


def test_covariance_propagates_by_the_jacobian_of_the_mean() -> None:
    """Finite differences through the mean are the oracle of the hand-derived transition matrix."""
    rng = np.random.default_rng(1)
    for _ in range(5):
        x, p = random_state(rng)
        u = np.concatenate([rng.normal(size=3), rng.normal(size=3) + np.array([0, 0, 9.81])])
        dt = 0.004

        def mean(state: np.ndarray, u: np.ndarray = u, dt: float = dt) -> np.ndarray:
            out = state.copy()
            propagate(out, np.zeros((15, 15)), u, dt, NOISE)
            return out

        centre, eps = mean(x), 1e-5
        f = np.empty((15, 15))
        for k in range(15):
            d = np.zeros(15)
            d[k] = eps
            f[:, k] = (boxminus(mean(boxplus(x, d)), centre) - boxminus(mean(boxplus(x, -d)), centre)) / (
                2 * eps
            )
        noise = np.zeros((15, 15))
        propagate(x.copy(), noise, u, dt, NOISE)
        after = p.copy()
        propagate(x.copy(), after, u, dt, NOISE)
        np.testing.assert_allclose(after, f @ p @ f.T + noise, atol=2e-4)


def test_velocity_update_equals_the_textbook_kalman_update() -> None:
    rng = np.random.default_rng(2)
    x, p = random_state(rng)
    sigma = np.array([0.05, 0.08, 0.05])
    rot = rotation(x[6:10])
    measured = rot.T @ x[3:6] + 1e-4 * rng.normal(size=3)
    h = np.zeros((3, 15))
    h[:, 3:6], h[:, 6:9] = rot.T, skew(rot.T @ x[3:6])
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + np.diag(sigma**2))
    expected = boxplus(x, gain @ (measured - rot.T @ x[3:6]))
    got, cov = x.copy(), p.copy()
    assert update_velocity(got, cov, measured, sigma, 5.0) == 3
    np.testing.assert_allclose(boxminus(got, expected), 0.0, atol=1e-6)
    np.testing.assert_allclose(cov, p - gain @ h @ p, atol=1e-5)


def test_velocity_far_off_is_refused() -> None:
    x, p = random_state(np.random.default_rng(3))
    before = x.copy()
    assert update_velocity(x, 1e-4 * p, np.array([30.0, 30.0, 30.0]), np.full(3, 0.05), 5.0) == 0
    np.testing.assert_array_equal(x, before)


def test_pose_update_moves_base_link_to_a_certain_measurement() -> None:
    f = InertialFilter(InertialConfig())
    f.x, f.p = random_state(np.random.default_rng(4))
    f.p *= 0.01
    target = f.pose()
    target[:3, :3] = target[:3, :3] @ exp(np.array([0.004, -0.003, 0.002]))
    target[:3, 3] += (0.02, -0.01, 0.03)
    f.update_pose(target, 1e-10 * np.eye(6))
    np.testing.assert_allclose(f.pose(), target, atol=2e-4)
    assert np.linalg.eigvalsh(f.p)[0] > 0.0


def joints_of(velocity: np.ndarray, omega: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Joint rates (16,) that keep four contact points at rest in the world while the trunk moves: the definition,
    solved per leg."""
    dq = np.zeros(16)
    normal = np.array([0.0, 0.0, 1.0])
    centre = wheel_centres(q)
    for leg in range(4):
        axle = np.array([0.0, np.cos(q[3 * leg]), np.sin(q[3 * leg])])
        down = normal - (normal @ axle) * axle
        contact = -WHEEL_RADIUS * down / np.linalg.norm(down)
        columns = []
        for k in range(3):
            d = q.copy()
            d[3 * leg + k] += 1e-6
            spin = np.array([1.0, 0.0, 0.0]) if k == 0 else axle
            columns.append((wheel_centres(d)[leg] - centre[leg]) / 1e-6 + np.cross(spin, contact))
        columns.append(np.cross(axle, contact))
        wanted = -velocity - np.cross(omega, centre[leg] + contact)
        dq[[3 * leg, 3 * leg + 1, 3 * leg + 2, 12 + leg]] = np.linalg.pinv(np.stack(columns, 1)) @ wanted
    return dq


def test_leg_velocity_inverts_the_rolling_constraint() -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        velocity, omega = rng.normal(size=3), rng.normal(size=3)
        out, sigma, contact = np.empty(3), np.empty(3), np.empty(4, bool)
        dq = joints_of(velocity, omega, STAND)
        height = leg_velocity(LIMBS, STAND, dq, np.zeros(16), omega, np.full(3, 0.05), out, sigma, contact)
        np.testing.assert_allclose(out, velocity, atol=1e-5)
        np.testing.assert_allclose(sigma, 0.05, rtol=1e-6)
        assert contact.all()
        assert height == pytest.approx(stand_height(STAND))


def test_wheels_that_disagree_count_less_and_in_height_a_hundred_times_so() -> None:
    rng = np.random.default_rng(6)
    for _ in range(10):
        each = rng.normal(size=(4, 3))
        dq = np.zeros(16)
        for leg in range(4):
            mine = [3 * leg, 3 * leg + 1, 3 * leg + 2, 12 + leg]
            dq[mine] = joints_of(each[leg], np.zeros(3), STAND)[mine]
        out, sigma, contact = np.empty(3), np.empty(3), np.empty(4, bool)
        leg_velocity(LIMBS, STAND, dq, np.zeros(16), np.zeros(3), np.full(3, 0.05), out, sigma, contact)
        np.testing.assert_allclose(out, each.mean(axis=0), atol=1e-5)
        spread = ((each - each.mean(axis=0)) ** 2).sum(axis=0)
        np.testing.assert_allclose(
            sigma, np.sqrt(0.05**2 + np.array([0.25, 0.25, 100.0]) * spread / 4), rtol=1e-4
        )
        rows = np.tile(np.concatenate([STAND, dq, np.zeros(16)]), (3, 1))
        np.testing.assert_allclose(ways_of_wheels(LIMBS, rows, np.zeros(3), 0.5), 0.5 * each[:, 0], atol=1e-5)


def test_a_wheel_in_the_air_tells_no_way() -> None:
    dq = joints_of(np.array([0.4, 0.0, 0.0]), np.zeros(3), STAND)
    dq[14] += 20.0
    row = np.concatenate([STAND, dq, loaded(48.0, 48.0, 2.0, 48.0)])
    np.testing.assert_allclose(ways_of_wheels(LIMBS, row[None], np.zeros(3), 1.0), 0.4, atol=1e-5)
    row[32:] = loaded(2.0, 2.0, 2.0, 2.0)
    assert np.isnan(ways_of_wheels(LIMBS, row[None], np.zeros(3), 1.0)).all()


def loaded(*forces: float) -> np.ndarray:
    """(16,) torques [Nm] of wheels that carry `forces` [N]."""
    from hal.robots.go2w.facts import wheel_jacobians

    tau = np.zeros(16)
    jacobian = wheel_jacobians(STAND)
    for leg, force in enumerate(forces):
        tau[3 * leg : 3 * leg + 3] = -jacobian[leg].T @ (0.0, 0.0, force)
    return tau


def test_contact_follows_the_ground_force_seen_by_the_joints() -> None:
    tau = loaded(48.0, 48.0, 2.0, 48.0)
    out, sigma, contact = np.empty(3), np.empty(3), np.empty(4, bool)
    leg_velocity(LIMBS, STAND, np.zeros(16), tau, np.zeros(3), np.full(3, 0.05), out, sigma, contact)
    assert contact.tolist() == [True, True, False, True]
    tau[:] = 0.0
    tau[0] = 1e-9
    height = leg_velocity(LIMBS, STAND, np.zeros(16), tau, np.zeros(3), np.full(3, 0.05), out, sigma, contact)
    assert np.isnan(height)
    assert np.isinf(sigma).all()


def test_deskew_moves_points_to_the_end_of_the_sweep() -> None:
    rng = np.random.default_rng(6)
    lever = np.array(IMU_POSITION)
    stamps = NS + np.arange(21) * 5_000_000
    track = np.zeros((21, 10))
    q = quaternion(exp(rng.normal(size=3)))
    omega, velocity = np.array([0.3, -0.8, 0.5]), np.array([0.5, -0.2, 0.1])
    rots, positions = [], []
    for k in range(21):
        rots.append(rotation(q))
        positions.append(velocity * k * 0.005)
        track[k, :3], track[k, 6:10] = positions[-1] + rots[-1] @ lever, q
        turn(q, *(omega * 0.005))
    xyz = rng.uniform(-8, 8, (200, 3)).astype(np.float32)
    time = np.sort(rng.uniform(0, 0.1, 200))
    got = deskew(xyz, time, stamps, track, NS, lever)
    for i in range(200):
        s = time[i] / 0.005
        k = min(int(s), 19)
        rot = rots[k] @ exp(omega * 0.005 * (s - k))
        world = rot @ xyz[i] + velocity * time[i]
        expected = rots[-1].T @ (world - positions[-1])
        np.testing.assert_allclose(got[i], expected, atol=1e-5)


def test_mount_matrix_is_the_fixed_axis_rotation() -> None:
    from hal.types import Extrinsics

    got = mount_matrix(Extrinsics((1.0, 2.0, 3.0), (0.1, 0.2, 0.3)))
    expected = exp(np.array([0, 0, 0.3])) @ exp(np.array([0, 0.2, 0])) @ exp(np.array([0.1, 0, 0]))
    np.testing.assert_allclose(got[:3, :3], expected, atol=1e-12)
    np.testing.assert_allclose(got[:3, 3], (1, 2, 3))


def test_planes_measure_the_distance_and_the_free_direction_of_a_floor() -> None:
    rng = np.random.default_rng(7)
    floor = np.column_stack([rng.uniform(-4, 4, (6000, 2)), np.full(6000, 0.25) + rng.normal(0, 0.002, 6000)])
    planes = VoxelPlanes(0.4, 20.0)
    planes.insert(floor, np.eye(4), settled=True)
    pose = np.eye(4)
    pose[2, 3] = 0.03
    h, b, seen, planar, inliers, total, _ = planes.fit(floor[:500], pose, 0.15, 0.05)
    assert seen > 450
    assert inliers == planar > 400
    assert np.sqrt(total / inliers) == pytest.approx(0.03, abs=0.001)
    assert b[2] / h[2, 2] == pytest.approx(0.03, abs=0.001)
    values, vectors = np.linalg.eigh(h[:3, :3] / inliers)
    assert values[1] < 1e-3
    assert abs(vectors[2, 2]) > 0.999


def test_the_fit_to_planes_equals_numpy() -> None:
    rng = np.random.default_rng(6)
    size, gate, scale = 0.4, 0.15, 0.05
    wall = rng.uniform((-3.0, 2.0, 0.0), (3.0, 2.02, 1.5), (3000, 3))
    floor = rng.uniform((-3.0, -3.0, 0.0), (3.0, 2.0, 0.01), (3000, 3))
    planes = VoxelPlanes(size, 20.0)
    planes.insert(np.vstack([wall, floor]), np.eye(4), settled=True)
    points = np.vstack([wall[::9], floor[::9], rng.uniform(-9.0, 9.0, (300, 3))])
    points += rng.normal(0.0, 0.05, points.shape)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = exp(np.array([0.01, -0.02, 0.03])), (0.02, -0.01, 0.01)
    h, b, *counts = planes.fit(points, pose, gate, scale)

    turned = points @ pose[:3, :3].T
    world = turned + pose[:3, 3]
    cells = [tuple(c) for c in np.floor(np.vstack([wall, floor]) / size).astype(int)]
    want_h, want_b, want = np.zeros((6, 6)), np.zeros(6), [0, 0, 0, 0.0]
    held: dict[tuple[int, ...], list[int]] = {}
    for k, cell in enumerate(cells):
        held.setdefault(cell, []).append(k)
    for at, arm in zip(world, turned, strict=True):
        mine = held.get(tuple(np.floor(at / size).astype(int)), [])[:SETTLED_POINTS]
        want[0] += bool(mine)
        if len(mine) < PLANE_POINTS:
            continue
        inside = np.vstack([wall, floor])[mine]
        values, vectors = np.linalg.eigh(np.cov(inside.T, bias=True))
        if values[1] < 9.0 * max(values[0], 0.0) or values[1] < 1e-4:
            continue
        want[1] += 1
        normal = vectors[:, 0]
        r = float(normal @ (at - inside.mean(axis=0)))
        if abs(r) > gate:
            continue
        w, j = (scale**2 / (scale**2 + r * r)) ** 2, np.concatenate([normal, np.cross(arm, normal)])
        want_h, want_b = want_h + w * np.outer(j, j), want_b + w * j * r
        want[2] += 1
        want[3] += r * r
    assert counts[:3] == want[:3]
    assert want[2] > 300
    assert want[1] < want[0] < len(points)
    assert counts[3] == pytest.approx(want[3], rel=1e-6)
    np.testing.assert_allclose(h, want_h, rtol=1e-6, atol=1e-6 * want_h.max())
    np.testing.assert_allclose(b, want_b, rtol=1e-6, atol=1e-6 * np.abs(want_b).max())


def test_the_back_of_a_thin_wall_is_another_surface() -> None:
    """A wall of 0.12 m in voxels of 0.4 m: its faces are 0.12 m apart, which is within the gate."""
    rng = np.random.default_rng(15)
    planes = VoxelPlanes(0.4, 20.0)
    near, far = np.eye(4), np.eye(4)
    near[1, 3], far[1, 3] = -2.0, 2.2

    def face(y: float, pose: np.ndarray) -> np.ndarray:
        points = np.column_stack(
            [rng.uniform(-1.5, 1.5, 2000), rng.normal(y, 0.003, 2000), rng.uniform(0, 1, 2000)]
        )
        return np.ascontiguousarray(points - pose[:3, 3])

    for _ in range(2):
        planes.insert(face(0.05, near), near, settled=True)
        planes.fit(face(0.05, near), near, 0.15, 0.05)
    _, _, seen, planar, *_ = planes.fit(face(0.17, far), far, 0.15, 0.05)
    assert seen > 1800
    assert planar < 0.02 * seen, "nobody saw the wall from there"
    for _ in range(2):
        planes.insert(face(0.17, far), far, settled=True)
    for pose, y in ((near, 0.05), (far, 0.17)):
        _, b, _, planar, inliers, total, _ = planes.fit(face(y, pose), pose, 0.15, 1e3)
        assert inliers == planar > 1500
        assert np.sqrt(total / inliers) < 0.006
        assert abs(b[1]) / inliers < 0.001, "nothing pulls the robot towards the other face"


@pytest.mark.parametrize(
    ("seen", "weight"),
    [
        ([1] * 30, 1.0),
        ([1] * 5, (5 / 15) ** 2),  # young
        ([1, 0] * 40, 1.0),  # a far wall, every other scan
        ([1] * 6 + [0] * 12 + [1] * 3, (3 / 15) ** 2),  # people who pass one after the other
        ([1] * 20 + [0] * 90 + [1], 1.0),  # a wall that was out of sight
    ],
)
def test_a_surface_earns_its_weight_scan_by_scan(seen: list[int], weight: float) -> None:
    rng = np.random.default_rng(12)
    planes = VoxelPlanes(0.4, 20.0)
    where = np.array([0.05, 0.05, 0.05])
    for there in seen:
        patch = np.column_stack([rng.uniform(0.0, 0.3, (20, 2)), rng.normal(0.0, 0.001, 20)]) + where
        planes.insert(patch if there else patch + 5.0, np.eye(4))
    h, _, _, planar, inliers, *_ = planes.fit(np.tile([0.2, 0.2, 0.05], (50, 1)), np.eye(4), 0.15, 1e3)
    assert planar == inliers == 50
    assert np.trace(h[:3, :3]) / inliers == pytest.approx(weight, rel=1e-3)


def test_a_flat_floor_observes_height_and_tilt_and_nothing_else() -> None:
    """Normals are off by noise: what they pretend about the heading grows with the lever, and must not count."""
    rng = np.random.default_rng(13)
    floor = np.column_stack([rng.uniform(-8, 8, (4000, 2)), np.full(4000, -0.4)])
    normal = np.column_stack([rng.normal(0.0, 0.03, (4000, 2)), np.ones(4000)])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    j = np.concatenate([normal, np.cross(floor, normal)], axis=1)
    seen = observed(j.T @ j / len(j))
    assert np.count_nonzero(seen.facing) == 3
    sigma = np.sqrt(np.diag(seen.covariance(1e-6)))
    assert (sigma[[0, 1, 5]] > 10.0).all()
    known = np.sqrt(1.0 / np.diag(np.linalg.inv(seen.covariance(1e-6))))
    assert (known[[2, 3, 4]] < 0.002).all()
    step = seen.step(np.array([1.0, 1.0, 1.0, 0.0, 0.0, 5.0]))
    assert np.abs(step[[0, 1, 5]]).max() < 0.1 * abs(step[2])
    wall = np.column_stack([rng.uniform(-8, 8, 400), np.full(400, 3.0), rng.uniform(0, 1, 400)])
    face = np.tile([0.0, -1.0, 0.0], (400, 1))
    j = np.concatenate([j, np.concatenate([face, np.cross(wall, face)], axis=1)])
    with_wall = observed(j.T @ j / len(j))
    assert np.count_nonzero(with_wall.facing) == 5
    sigma = np.sqrt(np.diag(with_wall.covariance(1e-6)))
    assert sigma[0] > 50.0
    known = np.sqrt(1.0 / np.diag(np.linalg.inv(with_wall.covariance(1e-6))))
    assert (known[1:] < 0.02).all()


def test_one_post_ties_the_turn_to_the_displacement() -> None:
    """What a post far ahead observes is a mixture: neither the place nor the heading alone is free, and one direction
    of the two is."""
    rng = np.random.default_rng(14)
    floor = np.column_stack([rng.uniform(-8, 8, (4000, 2)), np.full(4000, -0.4)])
    up = np.tile([0.0, 0.0, 1.0], (4000, 1))
    post = np.column_stack([np.full(200, 6.0), rng.uniform(-0.1, 0.1, 200), rng.uniform(0, 1, 200)])
    side = np.tile([0.0, 1.0, 0.0], (200, 1))
    points, normals = np.concatenate([floor, post]), np.concatenate([up, side])
    j = np.concatenate([normals, np.cross(points, normals)], axis=1)
    seen = observed(j.T @ j / len(j))
    covariance = seen.covariance(1e-6)
    at_post = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 6.0])  # how a turn moves it sideways
    assert at_post @ covariance @ at_post < 0.01**2
    assert covariance[1, 1] > 10.0
    assert covariance[5, 5] > 0.1


def test_planes_stay_within_their_memory_and_forget_the_far() -> None:
    planes = VoxelPlanes(0.4, 20.0)
    rng = np.random.default_rng(8)
    for k in range(60):
        pose = np.eye(4)
        pose[0, 3] = 3.0 * k
        planes.insert(rng.uniform(-9, 9, (3000, 3)), pose)
    assert planes._used < 3 * len(planes._keys) // 4 + 1
    assert int((planes._keys != -1).sum()) == planes._used
    floor = rng.uniform(-4, 4, (6000, 3)) * (1, 1, 0) + (0, 0, 0.1)
    planes.insert(floor, pose)
    assert planes.fit(floor, pose, 0.15, 0.05)[2] > 5000
    first = np.eye(4)
    assert planes.fit(rng.uniform(-9, 9, (3000, 3)), first, 0.15, 0.05)[2] == 0


def test_a_faded_surface_is_moved_by_what_comes_now_and_stays_a_surface() -> None:
    random = np.random.default_rng(3)

    def floor(height: float) -> np.ndarray:
        return np.column_stack([random.uniform(0.0, 4.0, (20_000, 2)), np.full(20_000, height)])

    def beside(planes: VoxelPlanes) -> tuple[float, int]:
        _, b, _, planar, inliers, *_ = planes.fit(floor(0.1), np.eye(4), 0.15, 1e3)
        return b[2] / max(inliers, 1), planar

    planes, settled = VoxelPlanes(0.4, 20.0), VoxelPlanes(0.4, 20.0)
    for both in (planes, settled):
        both.insert(floor(0.13), np.eye(4), settled=True)
        assert beside(both) == (pytest.approx(-0.03, abs=1e-3), 20_000)
    planes.fade(0.1)
    assert beside(planes) == (pytest.approx(-0.03, abs=1e-3), 20_000)
    for both in (planes, settled):
        both.insert(floor(0.1), np.eye(4))
    assert beside(planes)[0] == pytest.approx(-0.003, abs=1e-3)
    assert beside(settled)[0] == pytest.approx(-0.03, abs=1e-3), "a settled surface takes no more points"
    planes.fade(0.01)
    assert beside(planes)[1] == 20_000


def test_wheel_scale_learns_slip_and_ignores_spinning_wheels() -> None:
    from mapping.odometry.wheel_scale import WheelScale

    scale = WheelScale()
    rng = np.random.default_rng(9)
    for _ in range(600):
        scale.learn(0.05, 0.05 * (0.93 + 0.05 * rng.normal()), 0.1, 0.002)
    assert scale.value == pytest.approx(0.93, abs=0.01)
    for _ in range(100):
        scale.learn(0.05, 0.0, 0.1, 0.002)
    assert scale.value == pytest.approx(0.93, abs=0.01)
    scale.learn(0.25, 0.4, 0.1, 0.002)
    scale.forget()
    scale.learn(0.25, 0.25, 0.1, 0.002)
    assert scale.value == pytest.approx(0.93, abs=0.01)


def test_wheels_that_slip_are_believed_less_unless_the_scans_are_as_rough() -> None:
    from mapping.odometry.wheel_scale import SLIP_FACTOR, WheelScale

    rng = np.random.default_rng(4)
    for sigma, noisy in ((0.002, False), (0.01, True)):
        scale = WheelScale()
        for _ in range(50):
            scale.learn(0.04, 0.04 + sigma * rng.normal(), 0.1, sigma)
        assert scale.noise < 0.1
        for _ in range(6):
            scale.learn(0.08, 0.04, 0.1, sigma)  # 0.4 m/s too fast
        assert scale.noise == pytest.approx(SLIP_FACTOR * (0.3 if noisy else 0.36), rel=0.15)
        for _ in range(12):
            scale.learn(0.04, 0.04, 0.1, sigma)
        assert scale.noise < 0.1


@pytest.mark.parametrize("size", [0.15, 0.5, 1.5])
def test_a_thinned_cloud_is_that_of_kiss_icp_point_by_point(size: float) -> None:
    """Rings on the ground and a wall: many points fall into one voxel, and many voxels want the same slot."""
    from kiss_icp.voxelization import voxel_down_sample as theirs

    rng = np.random.default_rng(5)
    ground = rng.uniform(-20.0, 20.0, (6000, 3)) * (1.0, 1.0, 0.01)
    wall = rng.uniform(-3.0, 3.0, (3000, 3)) * (0.01, 1.0, 0.3) + (4.0, 0.0, 0.5)
    cloud = np.concatenate([ground, wall, ground[:500]]).astype(np.float32)
    for n in (0, 1, 2, 4096, len(cloud)):
        np.testing.assert_array_equal(
            voxel_down_sample(cloud[:n], size), theirs(cloud[:n].astype(float), size)
        )
