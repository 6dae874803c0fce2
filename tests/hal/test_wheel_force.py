"""The ground's force on the wheels, against plain numpy."""

from __future__ import annotations

import numpy as np

from hal.robots.go2w import facts as go2w
from hal.rotation import rotation, up_of
from hal.wheel_force import axle_force, wheel_loads


def test_axle_force_balances_the_joint_torques() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        jacobian = rng.normal(size=(3, 3))
        if abs(np.linalg.det(jacobian)) < 1e-3:
            continue
        force = rng.normal(size=3) * 50.0
        np.testing.assert_allclose(axle_force(jacobian, *(jacobian.T @ force)), force, rtol=1e-6, atol=1e-6)


def test_a_straight_knee_gives_finite_forces() -> None:
    assert np.isfinite(axle_force(np.diag([1.0, 1.0, 0.0]), 1.0, 2.0, 3.0)).all()


def test_wheel_loads_are_the_forces_that_made_the_torques() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        q = go2w.STAND + np.concatenate([rng.normal(scale=0.2, size=12), np.zeros(4)])
        jacobian = go2w.wheel_jacobians(q)
        force = np.column_stack([rng.normal(scale=20.0, size=(4, 2)), rng.uniform(0.0, 120.0, 4)])
        tau = np.zeros(16)
        for leg in range(4):
            tau[3 * leg : 3 * leg + 3] = -jacobian[leg].T @ force[leg]
        up = rng.normal(size=3)
        up /= np.linalg.norm(up)
        np.testing.assert_allclose(wheel_loads(go2w.LIMBS, q, tau, up), force @ up, rtol=1e-6, atol=1e-6)


def test_up_is_the_third_row_of_the_rotation() -> None:
    rng = np.random.default_rng(5)
    for _ in range(100):
        q = rng.normal(size=4)
        q /= np.linalg.norm(q)
        np.testing.assert_allclose(up_of(q), rotation(q[[1, 2, 3, 0]])[2], atol=1e-12)
