"""A robot that says yes and rolls on: rest is what counts, not the answer."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.robots.go2w import facts as go2w
from hal.rotation import rotation_rpy
from hal.safety.monitors import ROLLS_ON, taken_out
from hal.safety.slope import CREEP_SLOPE, CREEP_SPEED
from hal.types import ModeRequest, Phase
from hal.unitree import api, motion
from hal.unitree.api import Response, Sport
from hal.unitree.guardian import Order
from hal.unitree.layout import CDR_HEADER, LOW_STATE_CDR, SPORT_MODE_STATE_CDR
from hal.unitree.link import LOW_STATE, SPORT_STATE
from hal.unitree.motion import (
    DAMP_PATIENCE,
    FASTEST_DAMP,
    GO2W_WHEELS,
    INSIST_TIME,
    ROLLING_WAY,
    STEEPEST_DAMP,
    Halt,
    Motion,
)
from hal.unitree.sentry import Sentry
from tests.hal.unitree.robot import Faults
from tests.hal.unitree.world import World

BESIDE = motion.GO2W_WHEELS.half_track * np.array([1.0, -1.0, 1.0, -1.0])
"""[m] of the wheels FR, FL, RR, RL to the right."""


def low(speed: float, wz: float = 0.0, pitch: float = 0.0, tick: int = 0, bias: float = 0.0) -> np.ndarray:
    """A LowState of a robot that rolls [m/s], turns [rad/s] and has its nose down [rad]; `bias` [rad/s] of its gyro."""
    out = np.zeros(1, LOW_STATE_CDR)
    out[0]["motor_state"]["dq"][12:16] = (speed + wz * BESIDE) / go2w.WHEEL_RADIUS
    out[0]["imu_state"]["gyroscope"] = (0.0, 0.0, wz + bias)
    out[0]["imu_state"]["quaternion"] = (math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0)
    out[0]["tick"] = tick
    return out


def sport(speed: float, stamp: int = 0) -> np.ndarray:
    out = np.zeros(1, SPORT_MODE_STATE_CDR)
    out[0]["velocity"] = (speed, 0.0, 0.0)
    out[0]["stamp"]["sec"] = stamp
    return out


class Rolling:
    """A halt and a robot that goes on as told; what was sent, and when [s]."""

    def __init__(self) -> None:
        self.halt, self.motion, self.now = Halt(), Motion(), 0.0
        self.sent: list[tuple[float, Sport]] = []

    def run(
        self,
        seconds: float,
        speed: float,
        estimate: float | None = None,
        wz: float = 0.0,
        pitch: float = 0.0,
        bias: float = 0.0,
    ) -> None:
        for _ in range(round(seconds / 0.02)):
            self.now += 0.02
            if estimate is not None:
                self.motion.hear_sport(sport(estimate)[0], self.now)
            self.motion.hear_low(low(speed, wz, pitch, bias=bias)[0], self.now)
            order = self.halt.due(self.now, self.motion)
            if order is not None:
                self.sent.append((self.now, order))

    def stop(self) -> None:
        self.halt.begin(Sport.STOP_MOVE, self.now)

    @property
    def soft(self) -> float:
        """When Damp was sent [s]; infinite where it was not."""
        return min((at for at, order in self.sent if order is Sport.DAMP), default=math.inf)


def test_the_wheels_are_those_of_the_robot() -> None:
    assert motion.WHEEL_SLOTS == go2w.WHEEL_JOINTS
    assert motion.GO2W_WHEELS.radius == go2w.WHEEL_RADIUS
    assert pytest.approx(go2w.HIP_Y + go2w.THIGH_Y + go2w.TREAD_Y, abs=1e-3) == motion.GO2W_WHEELS.half_track


def test_a_robot_on_feet_is_judged_by_its_own_estimate_and_gyro() -> None:
    feet = Motion(None)
    for k in range(20):
        feet.hear_low(low(3.0)[0], 0.02 * k)  # what stands in the wheels' slots tells nothing
    assert feet.speed(0.38) is None, "silence is no rest"
    for k in range(20, 60):
        feet.hear_sport(sport(0.4, k)[0], 0.02 * k)
        feet.hear_low(low(0.0)[0], 0.02 * k)
    assert feet.speed(1.18) == pytest.approx(0.4)
    for k in range(60, 100):
        feet.hear_sport(sport(0.4, k)[0], 0.02 * k)
        feet.hear_low(low(0.0, wz=0.0, bias=0.8)[0], 0.02 * k)
    assert feet.speed(1.98) == pytest.approx(0.4), "half the yaw rate"


def test_a_robot_on_feet_that_walks_on_after_a_stop_is_made_soft() -> None:
    halt, feet, sent = Halt(), Motion(None), []
    halt.begin(Sport.STOP_MOVE, 0.0)
    halt.answered()
    for k in range(150):
        feet.hear_sport(sport(0.4, k)[0], 0.02 * k)
        feet.hear_low(low(0.0)[0], 0.02 * k)
        if (order := halt.due(0.02 * k, feet)) is not None:
            sent.append(order)
    assert sent[0] is Sport.STOP_MOVE
    assert sent[-1] is Sport.DAMP


@given(roll=st.floats(-0.6, 0.6), pitch=st.floats(-0.6, 0.6), speed=st.sampled_from([-0.2, 0.2]))
@settings(max_examples=50, deadline=None)
def test_slope_and_downhill_are_gravitys(roll: float, pitch: float, speed: float) -> None:
    moves, turned = Motion(), rotation_rpy(roll, pitch, 0.0)
    sample = low(speed)
    c, s = np.cos(np.array([roll, pitch]) / 2), np.sin(np.array([roll, pitch]) / 2)
    sample[0]["imu_state"]["quaternion"] = (c[0] * c[1], s[0] * c[1], c[0] * s[1], -s[0] * s[1])
    moves.hear_low(sample[0], 1.0)
    assert moves.slope == pytest.approx(math.acos(turned[2, 2]), abs=1e-3)
    falls = speed * turned[2, 0] < 0.0  # the height that a step ahead brings
    if moves.slope > 1.1 * CREEP_SLOPE and abs(turned[2, 0]) > 1e-3:
        assert moves.downhill == falls


@pytest.mark.parametrize("speed", [0.06, 0.12, 0.3, 0.6, 1.2, -0.3])
def test_a_robot_that_answers_and_rolls_on_is_told_again_and_made_soft(speed: float) -> None:
    robot = Rolling()
    robot.run(1.0, speed)
    robot.stop()
    robot.halt.answered()
    began = robot.now
    robot.run(10.0, speed)
    assert robot.soft - began == pytest.approx(max(DAMP_PATIENCE, ROLLING_WAY / abs(speed)), abs=0.1)
    told = [at for at, order in robot.sent if order is Sport.STOP_MOVE]
    assert np.diff(told).max() < 0.15
    assert f"{abs(speed):.2f} m/s" in robot.halt.damped


def test_without_the_monitor_the_answer_counts() -> None:
    robot = Rolling()
    robot.run(1.0, 0.5)
    robot.stop()
    robot.halt.answered()
    with taken_out(ROLLS_ON.name):
        robot.run(10.0, 0.5)
    assert robot.sent == []


@pytest.mark.parametrize(
    ("speed", "pitch", "soft"),
    [
        (FASTEST_DAMP + 0.1, 0.0, False),  # it could go head over heels
        (0.5, STEEPEST_DAMP + 0.02, False),  # it would slide on
        (0.5, -STEEPEST_DAMP - 0.02, False),
        (0.5, 0.15, True),
        (CREEP_SPEED - 0.1, 0.15, False),  # nose down, forward: it creeps downhill
        (-CREEP_SPEED + 0.1, -0.15, False),  # nose up, backward
        (-CREEP_SPEED + 0.1, 0.15, True),  # uphill: a motor does that
        (CREEP_SPEED - 0.1, 0.02, True),
    ],
)
def test_speed_and_slope_decide_whether_damp_is_safer(speed: float, pitch: float, soft: bool) -> None:
    robot = Rolling()
    robot.run(1.0, speed, pitch=pitch)
    robot.stop()
    robot.run(20.0, speed, pitch=pitch)
    assert math.isfinite(robot.soft) == soft
    assert robot.sent[-1][0] > 10.0 or soft, "it is told as long as it moves"


def test_what_turns_on_the_spot_is_told_again() -> None:
    robot = Rolling()
    robot.stop()
    robot.halt.answered()
    robot.run(4.0, 0.0, wz=0.5)
    assert math.isfinite(robot.soft)


@pytest.mark.parametrize(
    "case", ["brakes", "sways", "wheel spins", "estimate drifts", "gyro drifts", "remote", "lifted"]
)
def test_what_is_no_rolling_on_ends_the_order(case: str) -> None:
    robot = Rolling()
    robot.run(1.0, 0.8, 0.8)
    robot.stop()
    robot.halt.answered()
    if case == "brakes":
        for k in range(27):
            robot.run(0.02, 0.8 - 0.03 * k, 0.8 - 0.03 * k)
        robot.run(5.0, 0.0, 0.01)
    elif case == "sways":
        for k in range(250):
            robot.run(0.02, 0.15 * math.cos(2 * math.pi * k / 15), 0.15)
    elif case == "gyro drifts":
        robot.run(5.0, 0.0, 0.0, bias=0.3)
    elif case == "wheel spins":
        robot.run(5.0, 0.4, 0.02)
    elif case == "estimate drifts":
        robot.run(5.0, 0.0, 0.2)
    elif case == "remote":
        robot.motion.remote = True
        assert robot.halt.due(robot.now, robot.motion) is None
    else:
        robot.run(0.4, 0.8, 0.8)
        robot.run(5.0, 0.0, 0.0)
    assert robot.halt.order is None
    assert robot.soft == math.inf


def test_a_robot_whose_motion_is_not_heard_is_told_until_it_answers_for_a_second_at_most() -> None:
    halt, deaf = Halt(), Motion()
    for answers in (True, False):
        halt.begin(Sport.STOP_MOVE, 10.0)
        told = []
        for k in range(100):
            if answers and k == 10:
                halt.answered()
            if halt.due(10.0 + 0.02 * k, deaf) is not None:
                told.append(0.02 * k)
        assert told[-1] == pytest.approx(0.2 if answers else 1.0, abs=0.1)


def test_damp_is_insisted_on_where_the_motion_falls_silent() -> None:
    """The order was as old as the stop before it: it ended unsaid after the first Damp, which can get lost."""
    robot = Rolling()
    robot.run(1.0, 0.5)
    robot.stop()
    while not robot.halt.damped:
        robot.run(0.02, 0.5)
    robot.sent.clear()
    for _ in range(100):
        robot.now += 0.02
        order = robot.halt.due(robot.now, robot.motion)
        if order is not None:
            robot.sent.append((robot.now, order))
    assert robot.sent[-1][0] - robot.sent[0][0] == pytest.approx(INSIST_TIME, abs=0.1)
    assert {order for _, order in robot.sent} == {Sport.DAMP}
    assert robot.halt.order is None, "not for ever"


# --- the driver -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["zero", "stop"])
def test_the_driver_repeats_stop_move_and_makes_soft(how: str) -> None:
    world = World(Faults(rolls=True))
    world.backend.connect()
    world.until(Phase.READY, 5.0)
    world.run(2.0, vx=0.5)
    x, before = world.body.x, len(world.sent)
    if how == "stop":
        world.backend.request(ModeRequest.STOP)
    world.run(1.2)
    assert "StopMove is not followed: 0.4" in world.cause
    assert world.apis()[-100:].count(Sport.STOP_MOVE) >= 5
    assert Sport.DAMP not in world.apis()
    world.run(3.0)
    assert Sport.DAMP in [r.api for _, s, r in world.sent[before:] if s == "sport"]
    assert world.phase is Phase.FAULT
    assert "made soft" in world.cause
    assert abs(world.body.v) < 0.05
    assert world.body.x - x < 1.1, "9 m in 20 s before"
    quiet = len(world.sent)
    world.run(2.0)
    assert len(world.sent) == quiet
    world.faults.rolls = False
    world.backend.request(ModeRequest.RESUME)
    world.backend.request(ModeRequest.RECOVER)
    world.until(Phase.READY, 10.0)


def test_whoever_drives_by_the_remote_is_left_alone() -> None:
    world = World(Faults(rolls=True))
    world.backend.connect()
    world.until(Phase.READY, 5.0)
    world.run(2.0, vx=0.5)
    world.faults.remote = (0.0, 0.0, 0.0, 0.0, 0.5)
    world.run(5.0)
    assert Sport.DAMP not in world.apis()
    assert world.apis().count(Sport.STOP_MOVE) <= 3


def test_motion_that_is_wanted_again_ends_the_order() -> None:
    world = World(Faults(rolls=True))
    world.backend.connect()
    world.until(Phase.READY, 5.0)
    world.run(1.0, vx=0.5)
    world.run(1.0)
    world.run(5.0, vx=0.5)
    assert Sport.DAMP not in world.apis()
    assert world.phase is Phase.MOVING


# --- guardian and sentry --------------------------------------------------------------------------------------------


class Wire:
    """A link to a robot that answers at once and does as it likes: `speed` [m/s]."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self.sent: list[api.Request] = []
        self._answers: list[Response] = []
        self._tick = 0

    def send(self, service: str, request: api.Request) -> None:
        assert service == api.SPORT
        self.sent.append(request)
        if request.api == Sport.DAMP:
            self.speed = 0.0
        self._answers.append(Response(request.id, request.api, 0))

    def responses(self, _service: str) -> list[Response]:
        out, self._answers = self._answers, []
        return out

    def take(self, topic: str) -> list[bytes]:
        self._tick += 1
        message = {LOW_STATE: low, SPORT_STATE: sport}[topic]
        made = message(self.speed, tick=self._tick) if message is low else sport(self.speed, self._tick)
        return [CDR_HEADER + made.tobytes()]


@pytest.mark.parametrize("who", ["guardian", "sentry"])
@pytest.mark.parametrize("speed", [0.1, 0.5])
def test_the_watches_insist_on_rest_too(who: str, speed: float) -> None:
    wire = Wire(speed)
    order, now = Order(wire, avoid=False, wheels=GO2W_WHEELS), 100.0  # type: ignore[arg-type]
    sentry = Sentry(order)
    for _ in range(50):
        order.pump(now)
        now += 0.02
    if who == "guardian":
        order.give(Sport.STOP_MOVE, now)
    else:
        sentry.step(
            now, [(api.SPORT, api.Request(1, Sport.MOVE, api.compact({"x": 0.5, "y": 0, "z": 0}), True))]
        )
    began = now
    for _ in range(300):
        now += 0.02
        sentry.step(now, []) if who == "sentry" else order.pump(now)
    told = [request.api for request in wire.sent]
    assert told.count(Sport.STOP_MOVE) > 8
    assert told[-1] == Sport.DAMP
    assert wire.speed == 0.0
    assert order.halt.order is None
    assert now - began < 10.0


def test_a_lowstate_that_repeats_itself_tells_no_rest() -> None:
    """A frozen publisher of a robot at rest: the answer counts then, and the order ends within a second."""
    wire = Wire(0.0)
    wire.take = lambda topic: [
        CDR_HEADER + (low(0.0, tick=7) if topic == LOW_STATE else sport(0.0, 7)).tobytes()
    ]  # type: ignore[method-assign]
    order = Order(wire, avoid=False, wheels=GO2W_WHEELS)  # type: ignore[arg-type]
    order.pump(0.0)
    order.give(Sport.STOP_MOVE, 2.0)
    assert order.pump(2.0)
    assert not order.pump(2.1)
