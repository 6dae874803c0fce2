"""A controller of ours at the motors of the simulated robot: the contract, and what goes wrong."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.contract import BackendError
from hal.lowlevel import LowCommand, LowState
from hal.mujoco.sim import Simulation
from hal.postures.motion import damped
from hal.robots.go2w import facts as go2w
from hal.rotation import quaternion, rotation_rpy, up_of
from hal.scenes import Scene
from hal.types import NS, ModeRequest, Phase, PostureCommand, VelocityCommand
from hal.unitree.api import MotionSwitcher, Sport, WireError
from hal.unitree.layout import LOW_STATE_CDR, crc32
from hal.unitree.link import LOW_STATE
from hal.unitree.low.limits import SOFT_START, STIFFEST_JOINT, Limits
from hal.unitree.low.loop import STATE_SILENT, Order, Report
from hal.unitree.low.wire import L2, B, Packer, low_state
from tests.hal.contract_suite import ContractSuite, Rig
from tests.hal.unitree.low.robot import LOW, LowWorld
from tests.hal.unitree.test_wire import _flat

C_LOW_CMD = "<4B4IH2x" + 20 * "B3x5f3I" + "4B" + "40B12B2BB x2I".replace(" ", "")
"""LowCmd as the robot's C compiler lays it out."""


class LowRig(Rig):
    """After `connect` the robot lies, since its motion service was released."""

    def ready(self) -> None:
        self.backend.connect()
        self.backend.request(ModeRequest.STAND)
        self.until(Phase.READY, seconds=30.0)


@pytest.mark.campaign
class TestLow(ContractSuite):
    @pytest.fixture
    def rig(self) -> Iterator[Rig]:
        world = LowWorld()

        def tick() -> int:
            world.advance(0.01)
            return world.elapsed

        def hinder(on: bool) -> None:
            world.robot.stuck = on

        yield LowRig(world.backend, tick, world.body.throw_over, hinder)
        world.backend.close()

    def test_unless_connected_requests_are_errors_and_velocities_nothing(self, rig: Rig) -> None:
        """As in the suite, but for the request to stand: after `connect` this robot lies."""

        def refused() -> None:
            for mode in ModeRequest:
                with pytest.raises(BackendError, match="not connected"):
                    rig.backend.request(mode)
            with pytest.raises(BackendError, match="not connected"):
                rig.backend.posture(PostureCommand(0, roll=0.1))
            rig.backend.drive(VelocityCommand(0, vx=0.5))

        refused()
        rig.ready()
        assert abs(rig.travelled(rig.run(1.0))) < 0.02, "what was asked for before does not count"
        rig.backend.close()
        refused()


def standing(**options: Any) -> LowWorld:
    world = LowWorld(**options)
    world.backend.connect()
    world.backend.request(ModeRequest.STAND)
    world.until(Phase.READY)
    return world


# --- whose motors they are --------------------------------------------------------------------------------------------


def test_a_standing_robot_lies_down_before_its_motors_are_taken_and_has_them_back_at_the_end() -> None:
    world = LowWorld(standing=True)
    world.backend.connect()
    asked = [number for service, number in world.requests if service == "sport"]
    assert asked[-1] == Sport.STAND_DOWN
    assert world.requests.index(("sport", Sport.STAND_DOWN)) < world.requests.index(
        ("motion_switcher", MotionSwitcher.RELEASE_MODE)
    )
    assert world.phase is Phase.SITTING
    world.run(0.5)
    world.backend.close()
    assert world.robot.motion == "ai-w"
    assert world.robot.fought == world.robot.broken == 0
    assert world.robot.commands > 200


def test_nobody_else_may_send_to_the_motors() -> None:
    world = LowWorld()
    world.others = 1
    with pytest.raises(BackendError, match="1 other programs send rt/lowcmd"):
        world.backend.connect()
    assert world.robot.motion == "ai-w"
    assert world.loops == []


def test_a_motion_service_that_does_not_go_is_told() -> None:
    world = LowWorld(options=LOW.model_copy(update={"busy_timeout": 1.0}))
    world.robot.release = lambda _now: None  # type: ignore[method-assign]
    with pytest.raises(BackendError, match="motion service 'ai-w' does not go"):
        world.backend.connect()
    assert world.loops == []
    assert world.backend.state().phase is Phase.DISCONNECTED


def test_once_the_motion_service_is_back_nothing_is_sent_any_more() -> None:
    """The app can select it at any time; two commanders would shake the robot."""
    world = standing()
    world.run(1.5)
    world.robot.motion = "ai-w"
    world.run(0.3)
    fought = world.robot.fought
    assert fought < 50
    world.run(1.0, vx=0.3)
    assert world.robot.fought == fought
    assert world.phase is Phase.FAULT
    assert "has the motors again" in world.cause


# --- what makes it soft, and what only stops it
# -------------------------------------------------------------------------


def test_a_motor_that_is_not_well_makes_the_robot_soft_until_recover() -> None:
    world = standing()
    world.run(0.5, vx=0.3)
    write = world.robot._write_low

    def hot() -> None:
        write()
        world.robot._low[0]["motor_state"]["temperature"][5] = 91

    world.robot._write_low = hot  # type: ignore[method-assign]
    world.run(0.1, vx=0.3)
    assert not world.body.stiff
    assert world.phase is Phase.FAULT
    assert "motor FL_calf has 91 deg C" in world.cause
    world.robot._write_low = write  # type: ignore[method-assign]
    world.run(1.0)
    world.backend.request(ModeRequest.RECOVER)
    world.until(Phase.READY, 20.0)


@pytest.mark.parametrize("kind", ["hot", "lost", "fast", "far", "nan", "well"])
def test_what_motors_must_not_do_is_told_after_five_messages_at_most(kind: str) -> None:
    low = np.zeros(1, LOW_STATE_CDR)[0]
    motors = low["motor_state"]
    motors["q"][:16] = go2w.STAND
    if kind == "hot":
        motors["temperature"][5] = 91
    elif kind == "lost":
        motors["lost"][5], motors["reserve"][5, 0] = 5000, 4
    elif kind == "fast":
        motors["dq"][13] = 60.0
    elif kind == "far":
        motors["q"][2] = -3.2
    elif kind == "nan":
        low["imu_state"]["gyroscope"][1] = math.nan
    guard = Limits()
    told = [guard.trouble(low_state(low, 0.002 * k), low) for k in range(5)][-1]
    words = {
        "hot": "motor FL_calf has 91 deg C",
        "lost": "FL_calf",
        "fast": "motor FL_wheel turns at 60 rad/s",
        "far": "joint FR_calf reads -3.20 rad",
        "nan": "not a number",
        "well": "",
    }
    assert words[kind] in told
    assert (told == "") == (kind == "well")


def test_without_low_state_the_motors_go_soft() -> None:
    world = standing()
    world.run(0.5, vx=0.3)
    world.cut = True
    world.advance(STATE_SILENT + 0.01)
    assert not world.body.stiff
    world.run(0.5)
    assert "no LowState" in world.loop.loop.report().cause
    world.cut = False
    world.run(0.5)
    assert world.phase is Phase.FAULT, "until somebody has looked"


def test_a_controller_that_fails_leaves_soft_motors() -> None:
    world = standing()
    controller = world.loop.loop._controller

    def fails(*_: object) -> LowCommand:
        raise ZeroDivisionError("float division by zero")

    controller.step = fails  # type: ignore[method-assign]
    world.run(0.05, vx=0.3)
    assert not world.body.stiff
    assert world.phase is Phase.FAULT
    assert "ZeroDivisionError" in world.cause


def test_what_is_not_a_number_is_no_command() -> None:
    state = LowState(10.0, go2w.STAND.copy(), np.zeros(16), *np.zeros((4, 16)))
    for number in range(5):
        values = np.zeros((5, 16))
        values[number, 7] = math.nan
        assert Limits().apply(LowCommand(*values), state) is None


def test_the_robots_own_remote_stands_above_all() -> None:
    world = standing()
    world.run(1.0, vx=0.3)
    world.faults.remote = (0.0, 0.0, 0.0, 0.0, 0.6)
    world.run(1.0, vx=0.3)
    assert abs(world.body.v) < 0.05
    assert world.backend.state().remote
    assert "moves a stick" in world.cause
    world.faults.remote = (0.0, 0.0, 0.0, 0.0, 0.0)
    world.run(1.0, vx=0.3)
    assert world.body.v > 0.2
    keys = L2 | B
    world.robot._low[0]["wireless_remote"][2:4] = (keys & 0xFF, keys >> 8)
    world.run(0.1, vx=0.3)
    assert world.phase is Phase.DAMPED
    assert not world.body.stiff
    assert "L2 + B" in world.cause


def test_a_host_that_falls_silent_stops_the_robot_and_one_that_goes_lays_it_down() -> None:
    world = standing()
    world.run(1.0, vx=0.4)
    world.advance(2.0)
    assert abs(world.body.v) < 0.05
    assert world.loop.loop.report().phase in (Phase.READY, Phase.MOVING), "it balances on"
    world.run(1.0, vx=0.4)
    assert world.body.v > 0.3
    began = world.elapsed
    while not world.loop.loop.finished:
        world.loop.loop.leave(world.elapsed / NS)
        world.advance(0.002)
        assert world.elapsed - began < 9 * NS
    assert world.loop.loop.report().phase is Phase.DAMPED
    assert (world.body.q[2:12:3] < -2.2).all(), "it lies on its folded legs"
    world.advance(1.0)
    assert abs(world.body.v) < 0.05


def test_a_loop_that_died_is_a_fault_and_recover_starts_another() -> None:
    world = standing()
    world.loop.died = "the process of the motor loop ended"
    world.body.switch.command = damped()  # its watchdog
    world.run(1.0, vx=0.3)
    assert world.phase is Phase.FAULT
    assert "recover starts it again" in world.cause
    world.backend.request(ModeRequest.RECOVER)
    world.until(Phase.READY, 20.0)
    assert len(world.loops) == 2


def test_a_controller_that_was_not_tried_here_has_little_torque_and_speed() -> None:
    world = LowWorld(options=LOW.model_copy(update={"tried": ()}))
    world.backend.connect()
    world.run(0.2)
    assert "hang it with its wheels off the ground" in world.cause
    world.backend.request(ModeRequest.STAND)
    world.run(2.0, vx=0.8)
    command = world.body.switch.command
    assert command is not None
    torque = command.tau + command.kp * (command.q - world.body.q) + command.kd * (command.dq - world.body.dq)
    assert (np.abs(torque) <= 1.05 * go2w.TORQUE_LIMIT / 3).all()


def test_it_drives_though_messages_are_lost_and_late() -> None:
    """A tenth of LowState and of LowCmd is lost, and what comes is 4 ms late."""
    rng = np.random.default_rng(0)
    world = LowWorld()
    hear, follow = world.robot._put, world.robot.low_cmd
    way: list[bytes] = []

    def put(topic: str, data: bytes) -> None:
        if topic != LOW_STATE or rng.random() > 0.1:
            hear(topic, data)

    def low_cmd(data: bytes) -> None:
        if rng.random() > 0.1:
            way.append(data)
        if len(way) > 2:
            follow(way.pop(0))

    world.robot._put, world.robot.low_cmd = put, low_cmd  # type: ignore[method-assign]
    world.backend.connect()
    world.backend.request(ModeRequest.STAND)
    world.until(Phase.READY)
    x = world.body.x
    world.run(3.0, vx=0.4)
    assert world.body.x - x > 0.8
    assert world.phase is Phase.MOVING


@pytest.mark.campaign
def test_the_hybrid_controller_climbs_a_step_of_15_cm() -> None:
    height = np.zeros((121, 241), np.float32)
    height[:, 140:] = 0.15
    scene = Scene("step", height, 0.05, (-6.0, -3.0), (-0.6, 0.0, 0.0), {})
    world = standing(controller="hybrid", scene=scene)
    x = world.body.x
    for _ in range(12):
        world.run(0.5, vx=0.5)
        if world.body.x - x > 2.4:
            break
    assert world.phase in (Phase.MOVING, Phase.READY), world.cause
    assert world.body.x > 1.5
    assert world.body.simulation.position[2] > 0.15 + 0.3
    world.run(1.0)
    world.backend.close()


# --- bytes and limits
# -----------------------------------------------------------------------------------------------------


def test_low_cmd_is_what_the_library_writes_and_its_checksum_that_of_the_c_struct() -> None:
    pytest.importorskip("cyclonedds", reason="the unitree extra is not installed")
    from hal.unitree import idl

    values = np.random.default_rng(3).normal(size=(5, 16)).astype(np.float32).astype(np.float64)
    data = Packer().pack(LowCommand(*values))
    message = idl.LowCmd.__idl__.deserialize(data)
    assert (tuple(message.head), message.level_flag) == ((0xFE, 0xEF), 0xFF)
    assert [motor.mode for motor in message.motor_cmd] == [1] * 16 + [0] * 4
    for name, row in zip(("q", "dq", "tau", "kp", "kd"), values, strict=True):
        assert [getattr(motor, name) for motor in message.motor_cmd] == [*row.tolist(), 0.0, 0.0, 0.0, 0.0]
    body = struct.pack(C_LOW_CMD, *_flat(message))
    assert len(body) == 812
    words = np.frombuffer(body, "<u4")
    assert crc32(words[:-1]) == words[-1] == message.crc


@given(yaw=st.floats(-3.1, 3.1), seed=st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_an_imu_that_is_turned_tells_the_same_of_the_trunk(yaw: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    roll, pitch, heading = rng.uniform(-0.5, 0.5, 3)
    trunk = rotation_rpy(roll, pitch, heading)
    low = np.zeros(1, LOW_STATE_CDR)[0]
    turned = trunk @ rotation_rpy(0.0, 0.0, yaw)
    x, y, z, w = quaternion(turned)
    low["imu_state"]["quaternion"] = (w, x, y, z)
    gyro = rng.normal(size=3)
    low["imu_state"]["gyroscope"] = rotation_rpy(0.0, 0.0, yaw).T @ gyro
    state = low_state(low, 0.0, yaw)
    assert np.allclose(state.gyro, gyro, atol=1e-6)
    assert np.allclose(up_of(state.quaternion), trunk[2], atol=1e-6)


@given(seed=st.integers(0, 10_000), share=st.floats(0.1, 1.0), since=st.floats(0.0, 2.0))
@settings(max_examples=100, deadline=None)
def test_no_command_asks_for_more_than_the_limits(seed: int, share: float, since: float) -> None:
    rng = np.random.default_rng(seed)
    q, dq, tau, kp, kd = rng.normal(size=(5, 16)) * np.array([[3.0], [30.0], [60.0], [300.0], [20.0]])
    state = LowState(since, rng.normal(size=16), rng.normal(size=16) * 10.0, *np.zeros((4, 16)))
    guard = Limits(share)
    guard.begin(0.0)
    out = guard.apply(LowCommand(q, dq, tau, kp, kd), state)
    assert out is not None
    assert (out.q >= go2w.JOINT_RANGE[:, 0]).all()
    assert (out.q <= go2w.JOINT_RANGE[:, 1]).all()
    assert (out.kp >= 0.0).all()
    assert (out.kd >= 0.0).all()
    assert (out.kp <= STIFFEST_JOINT * min(1.0, since / SOFT_START) + 1e-9).all()
    torque = out.tau + out.kp * (out.q - state.q) + out.kd * (out.dq - state.dq)
    assert (np.abs(torque) <= share * go2w.TORQUE_LIMIT + 1e-6).all()


def test_a_command_within_the_limits_is_not_changed() -> None:
    state = LowState(10.0, go2w.STAND.copy(), np.zeros(16), *np.zeros((4, 16)))
    command = LowCommand(
        go2w.STAND + 0.02, np.zeros(16), np.full(16, 1.0), np.full(16, 70.0), np.full(16, 5.0)
    )
    out = Limits().apply(command, state)
    assert out is not None
    for name in ("q", "dq", "tau", "kp", "kd"):
        assert np.allclose(getattr(out, name), getattr(command, name))


@pytest.mark.parametrize("pose", [go2w.STAND, go2w.FOLDED_POSE], ids=["stands", "lies"])
def test_no_damping_rings_that_comes_as_late_as_it_was_told(pose: np.ndarray) -> None:
    """x'' = -d x' with a speed one period old is stable while d times the period is below 1."""
    age = 0.012
    sim = Simulation(np.zeros((9, 9), np.float32), 0.5, (-2.0, -2.0))
    where = [sim.model.joint(motor) for motor in go2w.MOTORS]
    sim.data.qpos[[int(joint.qposadr[0]) for joint in where]] = pose
    mujoco.mj_forward(sim.model, sim.data)
    inverse = np.zeros((sim.model.nv, sim.model.nv))
    mujoco.mj_solveM(sim.model, sim.data, inverse, np.eye(sim.model.nv))
    motors = [int(joint.dofadr[0]) for joint in where]
    mobility = inverse[np.ix_(motors, motors)]
    state = LowState(10.0, pose, np.zeros(16), *np.zeros((4, 16)))
    out = Limits(law_age=age).apply(LowCommand(pose, *np.zeros((3, 16)), np.full(16, 8.0)), state)
    assert out is not None
    for kind in ([0, 3, 6, 9], [1, 4, 7, 10], [2, 5, 8, 11], [12, 13, 14, 15]):
        fastest = np.linalg.eigvals(mobility[np.ix_(kind, kind)] * out.kd[kind]).real.max()
        assert 0.4 < age * fastest <= 1.02, "neither rings nor is held back more than need be"


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None)
def test_a_line_that_is_no_order_and_no_report_is_refused(line: bytes) -> None:
    for kind in (Order, Report):
        with pytest.raises(WireError):
            kind.unpack(line)


@pytest.mark.parametrize(
    "line",
    [b'{"vx": NaN, "requests": []}', b'{"vx": "a", "requests": []}', b"[]", b'{"requests": [[1, "fly"]]}'],
)
def test_an_order_with_what_cannot_be_is_refused(line: bytes) -> None:
    with pytest.raises(WireError):
        Order.unpack(line)


def test_orders_and_reports_come_through() -> None:
    order = Order(0.1, 0.0, -0.2, 0.01, 0.02, 0.3, False, False, [(1, "stand"), (2, "stop")])
    assert Order.unpack(order.pack()) == order
    report = Report(Phase.FAULT, "größe", 3, 0.004)
    assert Report.unpack(report.pack()) == report
