"""The facts add up, and the leg kinematics agree with a plain product of rotations."""

from __future__ import annotations

import numpy as np
import pytest

from hal.robots.go2w import facts as go2w


def rot(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    m = np.eye(3)
    m[i, i] = m[j, j] = c
    m[i, j], m[j, i] = -s, s
    return m


def oracle(q: np.ndarray) -> np.ndarray:
    """Wheel centres by chaining the joint transforms one by one."""
    out = []
    for leg in range(4):
        sx, sy = go2w.SIGN_X[leg], go2w.SIGN_Y[leg]
        hip, thigh, calf = q[3 * leg : 3 * leg + 3]
        p = np.array([0.0, go2w.TREAD_Y * sy, -go2w.CALF])
        p = np.array([0.0, 0.0, -go2w.THIGH]) + rot(1, calf) @ p
        p = np.array([0.0, go2w.THIGH_Y * sy, 0.0]) + rot(1, thigh) @ p
        p = np.array([go2w.HIP_X * sx, go2w.HIP_Y * sy, 0.0]) + rot(0, hip) @ p
        out.append(p)
    return np.array(out)


def random_poses(n: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    low, high = go2w.JOINT_RANGE[:12].T
    return np.hstack([rng.uniform(low, high, (n, 12)), rng.uniform(-9, 9, (n, 4))])


def test_total_mass_is_the_urdfs() -> None:
    assert pytest.approx(19.521, abs=1e-3) == go2w.ROBOT_MASS


def test_motor_order_is_the_sdks() -> None:
    assert go2w.MOTORS[:4] == ("FR_hip", "FR_thigh", "FR_calf", "FL_hip")
    assert go2w.MOTORS[12:] == ("FR_wheel", "FL_wheel", "RR_wheel", "RL_wheel")
    assert len(go2w.MOTORS) == len(set(go2w.MOTORS)) == 16


@pytest.mark.parametrize(("name", "height"), [("STAND", 0.408), ("FOLDED_POSE", 0.193)])
def test_stand_heights(name: str, height: float) -> None:
    assert go2w.stand_height(getattr(go2w, name)) == pytest.approx(height, abs=1e-3)


def test_track_and_wheelbase() -> None:
    centres = go2w.wheel_centres(go2w.STAND)
    assert centres[1, 1] - centres[0, 1] == pytest.approx(0.386, abs=1e-3)
    assert centres[0, 0] == pytest.approx(0.1934 - 0.007, abs=1e-3)


def test_centres_match_chained_rotations() -> None:
    for q in random_poses(200):
        np.testing.assert_allclose(go2w.wheel_centres(q), oracle(q), atol=1e-12)


def test_jacobians_match_finite_differences() -> None:
    for q in random_poses(50):
        jacobian = go2w.wheel_jacobians(q)
        for leg in range(4):
            for joint in range(3):
                step = np.zeros(16)
                step[3 * leg + joint] = 1e-6
                slope = (oracle(q + step)[leg] - oracle(q - step)[leg]) / 2e-6
                np.testing.assert_allclose(jacobian[leg, :, joint], slope, atol=1e-8)


def test_the_wheels_own_angle_moves_nothing() -> None:
    q = random_poses(1)[0]
    turned = q.copy()
    turned[go2w.WHEEL_JOINTS] += 1.0
    np.testing.assert_array_equal(go2w.wheel_centres(q), go2w.wheel_centres(turned))


def test_named_poses_are_inside_the_limits() -> None:
    for q in (go2w.STAND, go2w.FOLDED_POSE):
        assert (q >= go2w.JOINT_RANGE[:, 0]).all()
        assert (q <= go2w.JOINT_RANGE[:, 1]).all()


def test_inverse_kinematics_return_to_the_same_wheel_centres() -> None:
    for q in random_poses(200):
        q[0:12:3] *= 0.5  # beyond that the leg may fold through its own hip: two solutions
        centres = go2w.wheel_centres(q)
        if (centres[:, 2] > -0.1).any():
            continue
        np.testing.assert_allclose(go2w.wheel_centres(go2w.leg_angles(centres)), centres, atol=1e-9)


def test_inverse_kinematics_stay_inside_the_limits_when_out_of_reach() -> None:
    far = go2w.wheel_centres(go2w.STAND) + np.array([0.0, 0.0, -0.4])
    q = go2w.leg_angles(far)
    assert (q[:12] >= go2w.JOINT_RANGE[:12, 0]).all()
    assert (q[:12] <= go2w.JOINT_RANGE[:12, 1]).all()
    assert go2w.wheel_centres(q)[:, 2].max() < -0.38
