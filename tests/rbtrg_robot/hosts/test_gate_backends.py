"""The safety gate in front of each robot: every condition stops it, and `status` says so in plain words."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from hal.contract import Backend
from hal.lidar.config import only
from hal.mujoco.backend import MujocoBackend
from hal.safety.gate import GateConfig, SafetyGate
from hal.safety.geofence import Fence
from hal.safety.tilt import TiltFilter
from hal.scenes import Scene
from hal.types import NS, ImuSample, LidarScan, ModeRequest, Phase, RobotState, Sample
from hal.unitree.config import UnitreeConfig
from rbtrg_robot import topics as t
from rbtrg_robot.orders.words import robot_line
from rbtrg_robot.process.health import Health
from rbtrg_robot.stages.robot import STEP_PERIOD, RobotStage
from rbtrg_robot.wire.messages import decode, encode, header
from tests.hal.unitree.world import World
from tests.rbtrg_robot.hearsay import all_clear, map_offset

CRUISE = 0.3
"""[m/s]"""
REST = 0.05
"""[m/s]"""


def simulated() -> tuple[Backend, Callable[[], float]]:
    """The MuJoCo robot on a floor, and its true speed."""
    scene = Scene("floor", np.zeros((101, 101), np.float32), 0.1, (-5.0, -5.0), (0.0, 0.0, 0.0), {})
    backend = MujocoBackend(scene, lidar_step=40)
    return backend, lambda: float(backend.simulation.linear_velocity[0])


class Wired:
    """The Unitree backend; reading lets the robot on the other side of the wire live on."""

    def __init__(self) -> None:
        self.world = World(options=UnitreeConfig(lidars=only("xt16")), epoch=0)
        self._backend = self.world.backend

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)

    def connect(self) -> None:
        self._backend.connect()
        self.world.begin()

    def read(self, now: int) -> list[Sample]:
        self.world.advance(max(now - self.world.now, 0) / NS)
        return self._backend.read(now)


def wired() -> tuple[Backend, Callable[[], float]]:
    """The Unitree backend on the robot's side of its wire, and the true speed of that robot."""
    robot = Wired()
    return robot, lambda: float(robot.world.body.v)  # type: ignore[return-value]


class Bent:
    """A backend with something wrong in what it tells."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self.state_as: Callable[[RobotState], RobotState] = lambda state: state
        self.sample_as: Callable[[Sample], Sample | None] = lambda sample: sample

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)

    def state(self) -> RobotState:
        return self.state_as(self._backend.state())

    def read(self, now: int) -> list[Sample]:
        bent = (self.sample_as(sample) for sample in self._backend.read(now))
        return [sample for sample in bent if sample is not None]


class Rig:
    """Robot stage and gate in front of a backend, told to drive ahead 50 times a second."""

    def __init__(self, make_backend: Callable[[], tuple[Backend, Callable[[], float]]]) -> None:
        backend, self.speed = make_backend()
        self.robot = Bent(backend)
        fence = Fence.of([(-50, -50), (50, -50), (50, 50), (-50, 50)])
        self.gate = SafetyGate(backend.capabilities, GateConfig(not_moving_stop=3.0), fence)
        self.stage = RobotStage(self.robot, self.gate, simulated=True, watched=frozenset({"navigator"}))  # type: ignore[arg-type]
        self.health = Health(simulated=True)
        self.now = 0
        self.way = -1.0
        self.stage.warm_up()
        self.stage.on(t.TF_STATIC, map_offset())
        self.stage.alive("navigator", True)
        self.heal()

    def heal(self) -> None:
        """Nothing is wrong any more; the next drive goes the other way, or the floor would end."""
        self.way = -self.way
        self.vx: float | None = CRUISE
        self.frame = "base_link"
        self.measured: float | None = None
        """Speed that odometry tells [m/s]; None: the true one."""
        self.silent = False
        """Odometry tells nothing new."""
        self.x = 0.0
        self.robot.state_as = lambda state: state
        self.robot.sample_as = lambda sample: sample
        self.stage._tilt = TiltFilter()  # it forgets a fall slowly
        self.order(ModeRequest.RESUME)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * NS / STEP_PERIOD)):
            self.now += STEP_PERIOD
            if self.now % (4 * STEP_PERIOD) == 0:
                stamp = header(0 if self.silent else self.now, "odom")
                pose = t.POSE.kind(header=stamp)
                pose.pose.pose.position.x, pose.pose.pose.orientation.w = self.x, 1.0
                pose.twist.twist.linear.x = self.speed() if self.measured is None else self.measured
                self.stage.on(t.POSE, pose)
                self.stage.on(t.MOTION_LIMITS, all_clear(self.now))
                if self.vx is not None:
                    command = t.CMD_VEL.kind(header=header(self.now, self.frame))
                    command.twist.linear.x = self.way * self.vx
                    self.stage.on(t.CMD_VEL, command)
            for topic, message in self.stage.tick(self.now):
                if topic is t.ROBOT_STATE:
                    self.health.take(topic, decode(encode(message), topic.kind))

    def cruise(self) -> None:
        for _ in range(60):
            self.run(0.1)
            if self.way * self.speed() > 0.7 * CRUISE:
                return
        raise AssertionError(f"does not drive: {self.line()}")

    def line(self) -> str:
        """The robot's line of `status`."""
        return robot_line(self.health.robot_row())

    def order(self, mode: ModeRequest) -> None:
        latch = self.stage._commands.latch(self.stage.now)
        order = t.ROBOT_COMMAND.kind(mode=mode.value, cause="by hand", latch=latch)
        self.stage.on(t.ROBOT_COMMAND, order)


@dataclass(frozen=True)
class Case:
    """What goes wrong, the words for it, and whether it needs `resume`."""

    bend: Callable[[Rig], None]
    words: str
    latched: bool = False
    seconds: float = 0.8


def _set(**values: Any) -> Callable[[Rig], None]:
    def bend(rig: Rig) -> None:
        for name, value in values.items():
            setattr(rig, name, value)

    return bend


def _state(**changes: Any) -> Callable[[Rig], None]:
    def bend(rig: Rig) -> None:
        rig.robot.state_as = lambda state: replace(state, **changes)

    return bend


def _without(kind: type) -> Callable[[Rig], None]:
    def bend(rig: Rig) -> None:
        rig.robot.sample_as = lambda sample: None if isinstance(sample, kind) else sample

    return bend


def _frozen_state(rig: Rig) -> None:
    last = rig.robot.state()
    rig.robot.state_as = lambda _state: last


def _tipped(rig: Rig) -> None:
    side = 9.81 * np.array([0.0, math.sin(1.0), math.cos(1.0)])
    rig.robot.sample_as = lambda s: replace(s, accel=side) if isinstance(s, ImuSample) else s


def _at_the_fence(rig: Rig) -> None:
    rig.x = 49.8 * rig.way


def _stop(rig: Rig) -> None:
    rig.order(ModeRequest.STOP)


CASES = {
    "deadman": Case(_set(vx=None), "held (no fresh command)"),
    "not finite": Case(_set(vx=math.nan), "held (command refused, not finite: vx, vy, wz = (nan, 0.0, 0.0))"),
    "over the limit": Case(_set(vx=4.0), "held (command refused, over limit: vx "),
    "wrong frame": Case(
        _set(frame="map"), "held (command refused, wrong frame: expected base_link, got 'map')"
    ),
    "emergency stop": Case(_stop, "E-STOP (emergency stop: by hand)", latched=True),
    "tilt": Case(_tipped, "E-STOP (tilt: 4", latched=True, seconds=3.5),
    "battery": Case(_state(battery=0.05), "E-STOP (battery low: 5 %, limit 10 %)", latched=True),
    "motor": Case(
        _state(motor_temperature=97.0), "E-STOP (motor too hot: 97 deg C, limit 90 deg C)", latched=True
    ),
    "fault": Case(_state(phase=Phase.FAULT, cause="fallen"), "E-STOP (robot fault: fallen)", latched=True),
    "stale imu": Case(_without(ImuSample), "held (imu is "),
    "stale lidar": Case(_without(LidarScan), "held (lidar is ", seconds=1.6),
    "stale state": Case(_frozen_state, "held (state is "),
    "not ready": Case(
        _state(phase=Phase.DISCONNECTED, cause="no LowState"), "held (robot is disconnected: no LowState)"
    ),
    "geofence": Case(_at_the_fence, "held (geofence: the edge of the allowed area)"),
}


@pytest.fixture(scope="module", params=[simulated, wired])
def shared(request: pytest.FixtureRequest) -> Rig:
    """One robot for all that leaves no trace."""
    return Rig(request.param)


@pytest.fixture
def rig(shared: Rig) -> Rig:
    """A healthy robot."""
    shared.heal()
    return shared


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_each_condition_stops_each_robot_and_status_says_why(rig: Rig, case: Case) -> None:
    rig.cruise()
    case.bend(rig)
    rig.run(case.seconds)
    assert abs(rig.speed()) < REST
    assert case.words in rig.line()
    assert rig.gate.status().latched == case.latched


def test_a_command_without_motion_is_told_and_latches_in_the_end(rig: Rig) -> None:
    rig.cruise()
    rig.measured = 0.0
    rig.run(1.5)
    assert "commanded but not moving)" in rig.line()
    assert not rig.gate.status().latched
    rig.run(2.0)
    assert "E-STOP (commanded but not moving: 0.3 m/s commanded for 3 s)" in rig.line()
    rig.run(1.0)
    assert abs(rig.speed()) < REST


def test_while_odometry_is_silent_status_says_that_motion_is_not_checked(rig: Rig) -> None:
    rig.cruise()
    assert "not checked" not in rig.line()
    rig.silent = True
    rig.run(0.5)
    assert "motion is not checked, odometry is silent" in rig.line()
    rig.silent = False
    rig.run(0.5)
    assert "not checked" not in rig.line()


def test_a_request_that_is_not_known_is_counted_and_changes_nothing(rig: Rig) -> None:
    rig.cruise()
    for _ in range(3):
        rig.stage.on(t.ROBOT_COMMAND, t.ROBOT_COMMAND.kind(mode="selfdestruct", cause="by hand"))
    rig.run(0.5)
    assert rig.health.robot_row()["refused"]["unknown request"] >= 3
    assert rig.way * rig.speed() > 0.7 * CRUISE


def test_motion_without_a_command_latches(rig: Rig) -> None:
    rig.vx, rig.measured = None, 0.5
    rig.run(3.0)
    assert "E-STOP (moving but not commanded: it moves by 0.50 m/s at a command of zero)" in rig.line()


def test_a_jump_of_the_command_is_slewed(rig: Rig) -> None:
    rig.vx = None
    rig.run(1.0)
    rig.vx = CRUISE
    rig.run(0.2)
    assert (
        0.0 < rig.way * rig.health.newest[t.ROBOT_STATE].vx <= 0.2 * rig.robot.capabilities.max_accel + 1e-6
    )
    rig.run(1.0)
    assert rig.way * rig.health.newest[t.ROBOT_STATE].vx == CRUISE


def test_a_process_that_comes_back_does_not_set_the_robot_going_again_at_once(rig: Rig) -> None:
    """Commands go on all the while: the tracker still has the path that the lost navigator gave it."""
    rig.cruise()
    rig.stage.alive("navigator", False)
    rig.run(0.6)
    assert abs(rig.speed()) < REST
    assert "held (waiting for navigator)" in rig.line()
    rig.stage.alive("navigator", True)
    rig.run(0.9)
    assert abs(rig.speed()) < REST
    assert "held (navigator just came back)" in rig.line()
    rig.run(0.2)
    assert "just came back" not in rig.line()
    rig.cruise()
    assert "held" not in rig.line()
