"""What a sensor cannot tell is refused; what a robot can do is not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.plausible import ImuCheck, impossible_joints, lost_motor
from hal.robots.go2w.facts import MOTORS
from hal.rotation import rotation_rpy
from hal.safety.monitors import (
    ACCELERATION,
    GRAVITY_SIDE,
    GRAVITY_SIZE,
    JOINT_ANGLE,
    JOINT_SPEED,
    JOINT_TORQUE,
    TURN_RATE,
    UPRIGHT,
    taken_out,
)
from hal.types import NS

UP = np.array([0.0, 0.0, 9.81])
STILL = np.zeros(3)


class Imu:
    """Samples at 200 Hz."""

    def __init__(self) -> None:
        self.check = ImuCheck("IMU")
        self.stamp = NS

    def feed(self, seconds: float, accel: np.ndarray = UP, gyro: np.ndarray = STILL) -> list[str]:
        """The reasons of this time."""
        out = []
        for _ in range(round(200 * seconds)):
            self.stamp += NS // 200
            out.append(self.check.impossible(gyro, accel) or self.check.contradicted(self.stamp, gyro, accel))
        return out


@pytest.mark.parametrize("scale", [1 / 9.81, 0.4, 1.6, 9.81])
def test_another_unit_is_refused_within_half_a_second_and_for_as_long_as_it_lasts(scale: float) -> None:
    imu = Imu()
    assert not any(imu.feed(2.0))
    reasons = imu.feed(60.0, scale * UP)
    assert all(reasons[200:])
    assert "its unit is wrong" in reasons[-1]
    assert not any(imu.feed(3.0)[500:])
    assert all(Imu().feed(1.0, scale * UP)), "also from the start"
    with taken_out(GRAVITY_SIZE.name):
        assert not any(Imu().feed(1.0, scale * UP))


@pytest.mark.parametrize("signs", [(-1, -1, -1), (1, 1, -1)])
def test_reversed_signs_are_refused_for_as_long_as_they_last(signs: tuple[int, ...]) -> None:
    imu = Imu()
    imu.feed(2.0)
    reasons = imu.feed(60.0, np.array(signs) * UP)
    assert all(reasons[100:])
    assert reasons[-1] == "IMU: gravity is 180 deg from where its gyro tells: signs or units are wrong"
    assert not any(imu.feed(4.0)[700:])
    with taken_out(GRAVITY_SIDE.name, GRAVITY_SIZE.name):
        imu = Imu()
        assert not any(imu.feed(2.0) + imu.feed(2.0, -UP))


def test_a_robot_that_is_not_upright_at_the_start_is_waited_for() -> None:
    imu = Imu()
    reasons = imu.feed(2.0, -UP)
    assert all("lies on its side or back, tilted by 180 deg" in reason for reason in reasons)
    assert not any(imu.feed(4.0, rotation_rpy(0.3, 0.0, 0.0).T @ UP)[600:])
    with taken_out(UPRIGHT.name):
        assert not any(Imu().feed(1.0, -UP))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_a_robot_that_drives_shakes_turns_and_falls_is_believed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    check, stamp, turn = ImuCheck("IMU"), NS, np.eye(3)
    assert not any(check.contradicted(stamp + k * NS // 200, STILL, UP) for k in range(200))
    stamp += NS
    bias = rng.normal(scale=0.01, size=3)
    for _ in range(20):
        rate = rng.normal(scale=rng.choice([0.1, 1.0, 4.0]), size=3)
        push = rng.normal(scale=0.8, size=3)
        for k in range(100):
            stamp += NS // 200
            small = rate / 200
            angle = float(np.linalg.norm(small)) or 1e-12
            x, y, z = small / angle
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            turn = turn @ (np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)
            shock = rng.normal(scale=5.0, size=3) + (40.0 if k in (50, 51) else 0.0)
            accel = turn.T @ (UP + push) + shock
            assert check.contradicted(stamp, rate + bias, accel) == ""


@pytest.mark.parametrize("wrong", [1e28, -401.0, math.nan, math.inf])
def test_what_is_beyond_the_range_costs_its_sample_alone(wrong: float) -> None:
    imu = Imu()
    imu.feed(1.0)
    assert imu.feed(0.005, np.array([0.0, wrong, 9.81])) == [
        f"IMU: an acceleration of {wrong:.3g} m/s^2, possible are -400 to 400"
    ]
    assert not any(imu.feed(1.0))
    (reason,) = imu.feed(0.005, UP, np.array([0.0, 36.0, 0.0]))
    assert reason == "IMU: a turn rate of 36 rad/s, possible are -35 to 35"
    with taken_out(ACCELERATION.name, TURN_RATE.name):
        assert "acceleration" not in imu.feed(0.005, np.array([0.0, wrong, 9.81]))[0]


def test_speeds_of_joints_are_named() -> None:
    fine, fast = np.zeros(16), np.zeros(16)
    assert impossible_joints(fine, fine, fine) == ""
    fast[13] = -1e9
    assert (
        impossible_joints(fine, fast, fine)
        == f"joints: {MOTORS[13]} tells -1e+09 rad/s, possible are -200 to 200"
    )
    with taken_out(JOINT_SPEED.name):
        assert impossible_joints(fine, fast, fine) == ""


@pytest.mark.parametrize("wrong", [np.nan, -np.inf, 1e3, -1e300])
def test_angles_and_torques_are_named(wrong: float) -> None:
    fine, second = np.zeros(16), np.where(np.arange(16) == 2, wrong, 0.0)
    assert impossible_joints(second, fine, fine).startswith(
        f"joints: {MOTORS[2]} tells an angle of {wrong:.3g} rad"
    )
    assert impossible_joints(fine, fine, second).startswith(f"joints: {MOTORS[2]} tells {wrong:.3g} Nm")
    wheel = np.roll(second, 10)
    assert bool(impossible_joints(wheel, fine, fine)) != np.isfinite(wrong), "wheels turn on and on"
    with taken_out(JOINT_ANGLE.name, JOINT_TORQUE.name):
        assert impossible_joints(second, fine, second) == ""


def test_motors_that_lost_messages_are_named() -> None:
    lost = np.zeros(16, np.uint32)
    assert lost_motor(lost, lost) == ""
    lost[4] = 9999
    assert lost_motor(lost, lost) == f"motor {MOTORS[4]} has lost 9999 messages, error bits 0x270f"
