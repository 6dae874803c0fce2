"""The synthetic run agrees with itself: inertial, leg and wheel readings follow from the true motion."""

from dataclasses import replace
from itertools import islice
from math import radians

import numpy as np
import pytest

from hal.robots.go2w.facts import JOINT_RANGE, LIMBS, WHEEL_RADIUS, wheel_centres
from hal.rotation import rotation_rpy
from hal.types import NS, GroundTruth, ImuSample, JointSample, LidarScan
from mapping.odometry.wheels import leg_velocity
from tools.synthetic import SensorNoise, arena_run, clearing_run, feature_run, soak_run
from tools.synthetic_motion import Motion, leg_angles, legs, quaternions
from tools.synthetic_scenes import FEATURES, OBSTACLE

QUIET = SensorNoise(*[0.0] * 8)


def quiet_run(duration: float = 6.0):
    run = arena_run("l1", duration=duration)
    return replace(run, noise=QUIET, lidar=run.lidar.decimated(8))


def test_the_benchmark_run_has_the_documented_size() -> None:
    run = arena_run()
    t = np.linspace(0.0, 60.0, 6001)
    roll, pitch, height = run.motion.attitude(t)
    assert run.path_length() == pytest.approx(24.0, abs=1.0)
    assert np.abs(pitch).max() == pytest.approx(radians(10.0), rel=0.01)
    assert np.abs(roll).max() == pytest.approx(radians(4.0), rel=0.01)
    assert np.ptp(height) == pytest.approx(0.04, rel=0.01)
    x, y, _ = run.motion.planar(t)
    assert all(abs(run.scene.z(a, b)) < 1e-6 for a, b in zip(x, y, strict=True))


def test_leg_angles_invert_the_kinematics() -> None:
    random = np.random.default_rng(0)
    q = random.uniform([-0.3, 0.2, -2.2] * 4, [0.3, 1.3, -1.0] * 4, (50, 12))
    centres = np.array([wheel_centres(np.append(row, np.zeros(4))) for row in q])
    assert leg_angles(centres) == pytest.approx(q, abs=1e-9)
    with pytest.raises(ValueError, match="reach"):
        leg_angles(centres - [0.0, 0.0, 0.5])


def test_quaternions_turn_like_the_matrix() -> None:
    random = np.random.default_rng(1)
    r = rotation_rpy(*random.uniform([[-0.4], [-0.4], [-3.14]], [[0.4], [0.4], [3.14]], (3, 200)))
    x, y, z, w = quaternions(r).T
    assert 1 - 2 * (y * y + z * z) == pytest.approx(r[:, 0, 0], abs=1e-9)
    assert 2 * (x * y - z * w) == pytest.approx(r[:, 0, 1], abs=1e-9)
    assert 2 * (x * z + y * w) == pytest.approx(r[:, 0, 2], abs=1e-9)
    assert 2 * (y * z - x * w) == pytest.approx(r[:, 1, 2], abs=1e-9)


def test_wheels_stand_on_the_ground_within_joint_limits() -> None:
    motion = Motion()
    t = np.linspace(0.0, 60.0, 3001)
    state = legs(motion, t)
    limits = JOINT_RANGE[:12]
    assert (state.position > limits[:, 0]).all()
    assert (state.position < limits[:, 1]).all()
    position, rotation = motion.pose(t)
    for i in range(0, len(t), 100):
        centres = position[i] + wheel_centres(np.append(state.position[i], np.zeros(4))) @ rotation[i].T
        assert centres[:, 2] == pytest.approx(WHEEL_RADIUS, abs=2e-3)


def test_gyro_integrates_to_the_true_attitude_and_accel_to_the_true_velocity() -> None:
    run = quiet_run()
    attitude, velocity, last = None, None, None
    for sample in run.samples():
        if isinstance(sample, GroundTruth) and attitude is None:
            attitude, velocity = run.motion.pose(run.seconds(sample.stamp))[1][0], np.zeros(3)
        if isinstance(sample, ImuSample):
            if last is not None and attitude is not None:
                dt = (sample.stamp - last.stamp) / NS
                rate = 0.5 * (sample.gyro + last.gyro) * dt
                velocity = velocity + dt * (attitude @ (0.5 * (sample.accel + last.accel)) - [0.0, 0.0, 9.81])
                angle = np.linalg.norm(rate) + 1e-15
                k = np.cross(np.eye(3), rate / angle)
                attitude = attitude @ (np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)
            last = sample
    assert last is not None
    end = run.seconds(last.stamp)
    assert attitude == pytest.approx(run.motion.pose(end)[1][0], abs=2e-3)
    lever = np.array([-0.02557, 0.0, 0.04232])
    linear, angular = run.motion.twist(end)
    want = run.motion.pose(end)[1][0] @ (linear[0] + np.cross(angular[0], lever))
    assert velocity == pytest.approx(want, abs=0.02)


def test_wheel_speeds_and_leg_rates_give_the_true_velocity() -> None:
    run = quiet_run(8.0)
    truth = {s.stamp: s for s in run.samples() if isinstance(s, GroundTruth)}
    joints = [s for s in run.samples() if isinstance(s, JointSample)]
    out, sigma, contact = np.zeros(3), np.zeros(3), np.zeros(4, np.bool_)
    errors = []
    for s in joints[50:]:
        true = truth[s.stamp]
        height = leg_velocity(
            LIMBS, s.position, s.velocity, s.effort, true.angular, np.full(3, 0.01), out, sigma, contact
        )
        assert contact.all()
        assert height == pytest.approx(true.position[2], abs=0.012)  # above the tilted plane of the wheels
        errors.append(out - true.linear)
    error = np.array(errors)
    assert np.abs(error[:, 0]).max() < 0.02
    assert np.sqrt((error**2).mean(axis=0)) == pytest.approx(0.0, abs=0.015)


def test_same_seed_same_samples_and_stamps_ascend() -> None:
    def first(seed: int) -> list:
        run = replace(arena_run("mid360", seed=seed), duration=1.0)
        return list(replace(run, lidar=run.lidar.decimated(20)).samples())

    a, b, c = first(1), first(1), first(2)
    scans = [s for s in a if isinstance(s, LidarScan)]
    assert len(scans) == 10
    assert [s.points.tobytes() for s in scans] == [s.points.tobytes() for s in b if isinstance(s, LidarScan)]
    gyro = [[s.gyro for s in run if isinstance(s, ImuSample)] for run in (a, b, c)]
    assert np.array_equal(gyro[0], gyro[1])
    assert not np.array_equal(gyro[0], gyro[2])
    stamps = [s.stamp for s in a if not isinstance(s, LidarScan)]
    assert stamps == sorted(stamps)
    assert len([s for s in a if isinstance(s, ImuSample)]) == 201
    assert len([s for s in a if isinstance(s, JointSample)]) == 51


def test_scan_gaps_leave_scans_out() -> None:
    run = quiet_run(2.0)
    stamps = [
        (s.stamp - run.start_stamp) / NS
        for s in replace(run, gaps=((0.5, 1.2),)).samples()
        if isinstance(s, LidarScan)
    ]
    assert stamps == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9])


def test_the_obstacle_is_seen_until_it_is_taken_away() -> None:
    run = clearing_run(removed_at=2.0, duration=4.0)
    run = replace(run, lidar=run.lidar.decimated(4))
    counts = []
    for scan in (s for s in run.samples() if isinstance(s, LidarScan)):
        points = world_points(run, scan)
        box = OBSTACLE
        inside = np.abs(points[:, :2] - box.centre[:2]).max(axis=1) < 0.25
        counts.append(int((inside & (points[:, 2] > 0.1)).sum()))
    assert min(counts[:20]) > 10
    assert max(counts[21:]) == 0


def world_points(run, scan: LidarScan) -> np.ndarray:
    stamps = scan.stamp + np.round(scan.points["time"].astype(float) * NS).astype(np.int64)
    position, rotation = run.motion.pose(run.seconds(stamps))
    mount = run.extrinsics
    r = rotation_rpy(*mount.rpy)
    base = np.stack([scan.points[k] for k in "xyz"], axis=1).astype(float) @ r.T + mount.translation
    return position + np.einsum("nij,nj->ni", rotation, base)


@pytest.mark.parametrize("name", list(FEATURES))
def test_the_robot_rests_two_metres_before_the_feature(name: str) -> None:
    run = feature_run(name)
    end, _ = run.truth(run.start_stamp + int(run.duration * NS))
    feature = FEATURES[name]
    assert feature.face - end[0, 0] == pytest.approx(2.0, abs=1e-6)
    x0, x1, y0, y1 = feature.rect
    centre = run.scene.z(0.5 * (x0 + x1), 0.5 * (y0 + y1))
    assert centre == pytest.approx(0.0 if name == "pole" else feature.top, abs=1e-6)
    assert len(run.boxes) == (name == "pole")


def test_points_on_true_poses_lie_on_the_terrain() -> None:
    run = replace(arena_run("xt16"), duration=3.0)
    run = replace(run, lidar=run.lidar.decimated(8))
    scan = [s for s in run.samples() if isinstance(s, LidarScan)][-1]
    points = world_points(run, scan)
    floor = points[(np.abs(points[:, :2]) < 3.0).all(axis=1) & (points[:, 2] < 0.1)]
    assert len(floor) > 100
    flat = np.array([abs(run.scene.z(x, y)) < 1e-6 for x, y in floor[:, :2]])
    assert np.sqrt((floor[flat, 2] ** 2).mean()) < 0.01


def test_the_soak_streams() -> None:
    run = soak_run("l1", minutes=1.0, straight=True)
    assert len(list(islice(run.samples(), 2000))) == 2000
    assert run.scene.extent[2] > 20.0
