"""The simulated attitude has the errors of an IMU's filter: it follows accelerations, and nothing holds its heading."""

from __future__ import annotations

import numpy as np
import pytest

from hal.lowlevel import LowState
from hal.mujoco.attitude import FILTER_GAIN, AttitudeFilter
from hal.mujoco.backend import MujocoBackend
from hal.mujoco.sensors import ACCEL_SIGMA, GYRO_SIGMA, Sensors
from hal.rotation import rpy_of, up_of
from hal.scenes import load_scene
from hal.types import NS, Array, VelocityCommand

DT = 0.005
G = 9.81
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def state(time: float, quaternion: Array, gyro: Array, accel: Array) -> LowState:
    return LowState(
        time, np.zeros(16), np.zeros(16), np.zeros(16), quaternion.copy(), gyro.copy(), accel.copy()
    )


def matrix(q: Array) -> Array:
    """(3, 3) of w, x, y, z."""
    w, x, y, z = q
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * k + 2.0 * k @ k


def exponential(turn: Array) -> Array:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(turn))
    k = np.cross(np.eye(3), turn / max(angle, 1e-12))
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


def tilts(q: Array) -> tuple[float, float]:
    """Roll and pitch [deg]."""
    roll, pitch, _ = rpy_of(matrix(q))
    return float(np.degrees(roll)), float(np.degrees(pitch))


def test_it_is_mahony_s_filter() -> None:
    """Against eq. 48a on rotation matrices with the exact exponential."""
    rng = np.random.default_rng(4)
    filter_, turned = AttitudeFilter(), np.eye(3)
    for k in range(600):
        t = k * DT
        gyro = np.array([1.5 * np.sin(3.0 * t), np.cos(2.0 * t), 0.8]) + rng.normal(0.0, 0.02, 3)
        accel = np.array([2.0 * np.sin(t), 1.0, G]) + rng.normal(0.0, 3.0, 3)
        told = state(t, LEVEL, gyro, accel)
        filter_.measure(told)
        if k > 0:
            away = np.cross(accel / np.linalg.norm(accel), turned.T @ [0.0, 0.0, 1.0])
            turned = turned @ exponential(DT * (gyro + FILTER_GAIN * away))
        np.testing.assert_allclose(matrix(told.quaternion), turned, atol=2e-3)


def test_at_rest_it_settles_where_accelerometer_and_gyro_say() -> None:
    """Their biases tilt it by bias / g and bias / gain; white noise moves it by much less than that."""
    sensors = Sensors(seed=3, noise=True)
    gyro_bias, accel_bias = sensors._gyro_bias, sensors._accel_bias
    pitch, roll = np.radians(12.0), np.radians(-5.0)
    q = np.array([np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0])
    q = np.array(
        [q[0] * np.cos(roll / 2), q[0] * np.sin(roll / 2), q[2] * np.cos(roll / 2), -q[2] * np.sin(roll / 2)]
    )
    up = np.array(up_of(q))
    away = []
    for k in range(16000):
        told = sensors.measure(state(k * DT, q, np.zeros(3), G * up))
        away.append(np.cross(up_of(told.quaternion), up))
    mean, spread = np.mean(away, axis=0), np.std(away, axis=0)
    expected = np.cross(accel_bias / G, up) + (gyro_bias - gyro_bias @ up * up) / FILTER_GAIN
    np.testing.assert_allclose(mean, expected, atol=4e-4)
    assert 1e-4 < np.linalg.norm(expected) < 0.02
    # A first-order filter lets through half of FILTER_GAIN * DT of the variance of the accelerometer.
    # It integrates that of the gyro.
    white = np.sqrt(0.5 * FILTER_GAIN * DT * (ACCEL_SIGMA / G) ** 2 + 0.5 * DT / FILTER_GAIN * GYRO_SIGMA**2)
    assert spread.max() < 2.0 * white
    assert white < 4e-4


@pytest.mark.parametrize("way", [-1.0, 1.0])
@pytest.mark.parametrize(("push", "least", "most"), [(1.0, 0.3, 0.4), (2.0, 0.6, 0.75), (3.0, 0.9, 1.1)])
def test_braking_and_driving_off_tilt_it(push: float, least: float, most: float, way: float) -> None:
    """For 0.3 s; the tilt fades with 1 / FILTER_GAIN when the push ends."""
    filter_ = AttitudeFilter()
    seen = []
    for k in range(round(4.3 / DT)):
        ahead = way * push if k * DT < 0.3 else 0.0
        told = state(k * DT, LEVEL, np.zeros(3), np.array([ahead, 0.0, G]))
        filter_.measure(told)
        seen.append(tilts(told.quaternion))
    rolls, pitches = np.array(seen).T
    # Driving off feels like a nose that is up: pitch is positive nose down.
    assert least < -way * pitches[round(0.3 / DT)] < most
    assert np.abs(rolls).max() < 1e-9
    assert abs(pitches[-1]) == pytest.approx(np.abs(pitches).max() * np.exp(-4.0 * FILTER_GAIN), rel=0.1)


def test_an_impact_counts_by_its_direction_alone() -> None:
    filter_ = AttitudeFilter()
    filter_.measure(state(0.0, LEVEL, np.zeros(3), np.array([0.0, 0.0, G])))
    hit = state(DT, LEVEL, np.zeros(3), np.array([-500.0, 0.0, G]))
    filter_.measure(hit)
    assert tilts(hit.quaternion)[1] == pytest.approx(np.degrees(FILTER_GAIN * DT), rel=0.01)


def test_the_heading_drifts_by_the_bias_of_the_gyro() -> None:
    bias = np.array([0.0, 0.0, -0.003])
    filter_ = AttitudeFilter(gyro_bias=bias)
    told = [state(k * DT, LEVEL, bias, np.array([0.0, 0.0, G])) for k in range(2001)]
    for one in told:
        filter_.measure(one)
    turned = rpy_of(matrix(told[-1].quaternion))[2] - rpy_of(matrix(told[0].quaternion))[2]
    assert turned == pytest.approx(-0.03, rel=1e-3)
    assert np.abs(tilts(told[-1].quaternion)).max() < 1e-9


def test_a_robot_that_stops_hard_reads_a_tilted_trunk() -> None:
    """In simulated physics: what the controller reads follows the braking; the truth is published apart from it."""
    robot = MujocoBackend(load_scene("flat"), lidars=(), seed=2)
    robot.connect()
    away = []
    for k in range(1, 301):
        now = k * NS // 100
        robot.drive(VelocityCommand(now, vx=0.8 if 1.0 < k / 100 < 2.2 else 0.0))
        robot.read(now)
        told, true = up_of(robot._low.quaternion), robot.simulation.rotation[2]
        away.append(np.degrees(np.cross(told, true)[1]))
    rest, most, least = away[90], max(away), min(away)
    assert abs(rest) < 0.6
    assert 0.4 < most - rest < 3.0 or 0.4 < rest - least < 3.0
    assert most - least > 1.0
