"""What every backend must do, whatever robot is behind it. Subclass `ContractSuite` and give it a `rig` fixture."""

from __future__ import annotations

import re
import types
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest

from hal.contract import Backend, BackendError
from hal.limbs import WHEEL_JOINTS
from hal.robots import Robot, describe
from hal.robots.go2w.facts import JOINT_RANGE
from hal.types import (
    NS,
    POINT_DTYPE,
    GroundTruth,
    ImuSample,
    JointSample,
    LidarScan,
    ModeRequest,
    Phase,
    PostureCommand,
    RobotState,
    Sample,
    VelocityCommand,
)

Kind = TypeVar("Kind")


class Rig:
    """A backend, the clock that drives it, and what can happen to its robot."""

    def __init__(
        self,
        backend: Backend,
        tick: Callable[[], int],
        fall: Callable[[], object],
        hinder: Callable[[bool], object],
        robot: Robot | None = None,
        lift: Callable[[], object] | None = None,
        x: Callable[[], float] | None = None,
    ) -> None:
        """`tick` lets one host period pass and returns the source clock [ns]; `fall` throws the robot over; while
        `hinder` is on it neither gets up nor lies down; `lift` puts one back on its feet that cannot get there by
        itself; `x` [m]: where a robot on feet truly is, of which no sample tells."""
        self._x, self._been = x, [(0, 0.0)]
        self.robot = robot or describe()
        self.lift = lift
        self.backend = backend
        self._tick = tick
        self.fall = fall
        self.hinder = hinder
        self.now = 0
        self.states: list[RobotState] = []

    def tick(self) -> int:
        """One host period later: the source clock [ns]."""
        now = self._tick()
        if self._x is not None:
            self._been.append((now, self._x()))
        return now

    def run(self, seconds: float, vx: float = 0.0, wz: float = 0.0) -> list[Sample]:
        """Drive for `seconds` of the source clock and return what the sensors said."""
        end = None
        samples: list[Sample] = []
        while end is None or self.now < end:
            self.now = self.tick()
            end = self.now + round(seconds * NS) if end is None else end
            self.backend.drive(VelocityCommand(self.now, vx=vx, wz=wz))
            samples += self.backend.read(self.now)
            self.states.append(self.backend.state())
        return samples

    def travelled(self, samples: list[Sample]) -> float:
        """How far forward [m]: what the wheels rolled, corrected for nothing, which is good enough on flat ground; of a
        robot on feet the simulator's truth."""
        if self.robot.wheeled:
            joints = of(samples, JointSample)
            turned = joints[-1].position[WHEEL_JOINTS] - joints[0].position[WHEEL_JOINTS]
            return float(np.mean(turned)) * self.robot.limbs.radius
        if self._x is not None:
            stamps, x = zip(*self._been, strict=True)
            first, last = np.interp([samples[0].stamp, samples[-1].stamp], stamps, x)
            return float(last - first)
        truth = of(samples, GroundTruth)
        return float((truth[-1].position - truth[0].position)[0])

    def put_back(self) -> None:
        """On its feet, where it cannot get there by itself."""
        if self.lift is not None:
            self.lift()
            self.run(0.5)

    def recover(self) -> None:
        """Ask a fallen robot to get up, or put it on its feet first."""
        self.put_back()
        self.request(ModeRequest.RECOVER)
        self.until(Phase.READY, seconds=20.0)

    def until(self, *phases: Phase, seconds: float) -> list[Sample]:
        """Run at zero velocity until the robot is in one of `phases`; fail after `seconds`."""
        samples: list[Sample] = []
        spent = 0.0
        while self.backend.state().phase not in phases:
            assert spent < seconds, f"still {self.backend.state()} after {seconds} s"
            samples += self.run(0.05)
            spent += 0.05
        return samples

    def ready(self) -> None:
        """Connect and wait until the robot takes velocity."""
        self.backend.connect()
        self.until(Phase.READY, seconds=30.0)

    def seated(self) -> None:
        """Connect, get ready and lie down."""
        self.ready()
        self.request(ModeRequest.SIT)
        self.run(3.5)

    def request(self, mode: ModeRequest) -> RobotState:
        """Ask, and let it take effect."""
        self.backend.request(mode)
        self.run(0.05)
        return self.backend.state()


def campaign(test: types.FunctionType) -> types.FunctionType:
    """A test of the suite that one of its subclasses runs as campaign alone."""
    own = types.FunctionType(test.__code__, test.__globals__, test.__name__)
    own.__annotations__ = test.__annotations__
    return pytest.mark.campaign(own)


def of(samples: list[Sample], kind: type[Kind]) -> list[Kind]:
    """The samples of one kind."""
    return [s for s in samples if isinstance(s, kind)]


class ContractSuite:
    """Subclass with a fixture `rig`: a fresh backend on flat ground with room, not connected yet."""

    live = False
    """The robot's clock goes on by itself."""

    legs = True
    joint_range = JOINT_RANGE[:12]
    """(12, 2) [rad] of hips, thighs and calves."""

    scan_hits = 500
    """Fewest points of a scan in the rig's surroundings."""

    def test_says_disconnected_before_connect_and_after_close(self, rig: Rig) -> None:
        assert rig.backend.state().phase is Phase.DISCONNECTED
        assert rig.backend.state().cause
        rig.ready()
        rig.backend.close()
        rig.backend.close()
        assert rig.backend.state().phase is Phase.DISCONNECTED
        assert rig.backend.read(rig.tick()) == []

    def test_is_a_backend_with_sane_capabilities(self, rig: Rig) -> None:
        assert isinstance(rig.backend, Backend)
        c = rig.backend.capabilities
        assert c.name
        assert 0.2 <= c.max_vx <= 4.0
        assert 0.2 <= c.max_wz <= 4.0
        assert c.strafe == (c.max_vy > 0.0)
        assert 0.0 < c.max_slope < 1.0
        assert 0.0 < c.max_step < 0.5

    def test_sensors_come_at_their_rates_in_order_and_never_from_the_future(self, rig: Rig) -> None:
        rig.ready()
        rig.run(0.5)
        samples = rig.run(2.0)
        for kind, rate in ((ImuSample, 200.0), (JointSample, 50.0), (LidarScan, 10.0), (RobotState, 10.0)):
            stamps = np.array(
                [s.stamp for s in samples if isinstance(s, kind) and getattr(s, "name", "main") == "main"]
            )
            assert len(stamps) >= 0.8 * 2.0 * rate, kind.__name__
            assert (np.diff(stamps) > 0).all(), kind.__name__
            assert (stamps <= rig.now).all(), kind.__name__
            assert np.median(np.diff(stamps)) < 1.2 * NS / rate, kind.__name__

    def test_a_standing_robot_feels_gravity_and_nothing_else(self, rig: Rig) -> None:
        rig.ready()
        rig.run(1.0)
        samples = rig.run(1.0)
        accel = np.mean([s.accel for s in of(samples, ImuSample)], axis=0)
        gyro = np.mean([s.gyro for s in of(samples, ImuSample)], axis=0)
        assert abs(np.linalg.norm(accel) - 9.81) < 0.2
        assert accel[2] > 9.5
        assert np.linalg.norm(gyro) < 0.03

    def test_joints_are_within_their_limits_and_carry_the_robot(self, rig: Rig) -> None:
        rig.ready()
        rig.run(0.5)
        joints = of(rig.run(0.5), JointSample)
        for sample in joints:
            assert sample.position.shape == sample.velocity.shape == sample.effort.shape == (16,)
            assert (sample.position[:12] > self.joint_range[:, 0] - 0.05).all()
            assert (sample.position[:12] < self.joint_range[:, 1] + 0.05).all()
        knees = np.mean([s.effort[2:12:3] for s in joints], axis=0)
        assert (np.abs(knees) > 1.0).all() or not self.legs

    def test_scans_are_points_with_times_and_without_the_robot(self, rig: Rig) -> None:
        rig.ready()
        scans = of(rig.run(1.0), LidarScan)
        assert scans
        for scan in scans:
            p = scan.points
            assert p.dtype == POINT_DTYPE
            assert len(p) >= self.scan_hits
            xyz = np.stack([p["x"], p["y"], p["z"]], axis=1)
            assert np.isfinite(xyz).all()
            assert p["time"].min() >= 0.0
            assert p["time"].max() <= 0.2
            near = np.linalg.norm(xyz, axis=1) < max(
                min(0.5 * rig.robot.body.length, 0.8 * rig.robot.height) - 0.1, 0.15
            )
            assert near.mean() < 0.01

    def test_drives_forward_and_stops_again(self, rig: Rig) -> None:
        rig.ready()
        rig.run(1.0, vx=0.4)
        samples = rig.run(2.0, vx=0.4)
        assert rig.backend.state().phase is Phase.MOVING
        assert 0.6 * 0.8 <= rig.travelled(samples) <= 1.4 * 0.8
        rig.run(2.0)
        assert rig.backend.state().phase is Phase.READY
        assert abs(rig.travelled(rig.run(1.0))) < 0.02

    def test_turns_in_place(self, rig: Rig) -> None:
        rig.ready()
        rig.run(1.0, wz=0.6)
        rate = np.mean([s.gyro[2] for s in of(rig.run(2.0, wz=0.6), ImuSample)])
        assert 0.45 <= rate <= 0.75

    def test_a_velocity_holds_until_the_next_one(self, rig: Rig) -> None:
        rig.ready()
        rig.run(0.5, vx=0.3)
        samples: list[Sample] = []
        end = rig.now + NS // 2
        while rig.now < end:
            rig.now = rig.tick()
            samples += rig.backend.read(rig.now)
        assert rig.travelled(samples) > 0.05

    def test_stop_latches_until_resume(self, rig: Rig) -> None:
        rig.ready()
        rig.run(1.0, vx=0.4)
        rig.backend.request(ModeRequest.STOP)
        rig.run(2.0, vx=0.4)
        assert rig.backend.state().phase is Phase.STOPPED
        assert "stop" in rig.backend.state().cause
        assert abs(rig.travelled(rig.run(1.0, vx=0.4))) < 0.02
        rig.backend.request(ModeRequest.RESUME)
        rig.until(Phase.READY, Phase.MOVING, seconds=2.0)
        rig.run(1.0, vx=0.4)
        assert rig.travelled(rig.run(1.0, vx=0.4)) > 0.2

    def test_sits_down_and_stands_up_again(self, rig: Rig) -> None:
        rig.ready()
        rig.backend.request(ModeRequest.SIT)
        rig.until(Phase.SITTING, seconds=10.0)
        rig.run(4.0)
        joints = of(rig.run(0.5, vx=0.4), JointSample)
        assert (joints[-1].position[2:12:3] < -2.2).all() or not self.legs, "knees are folded"
        assert np.abs(joints[-1].velocity[WHEEL_JOINTS]).max() < 0.5, "a seated robot does not drive"
        rig.backend.request(ModeRequest.STAND)
        rig.until(Phase.STANDING, Phase.READY, seconds=10.0)
        rig.until(Phase.READY, seconds=20.0)
        assert rig.travelled(rig.run(2.0, vx=0.4)) > 0.2

    def test_damp_lets_go_and_stand_takes_over_again(self, rig: Rig) -> None:
        rig.ready()
        rig.backend.request(ModeRequest.DAMP)
        rig.until(Phase.DAMPED, seconds=2.0)
        rig.run(2.0, vx=0.4)
        assert rig.backend.state().phase is Phase.DAMPED
        assert np.abs(of(rig.run(0.5, vx=0.4), JointSample)[-1].velocity[WHEEL_JOINTS]).max() < 0.5
        rig.backend.request(ModeRequest.STAND)
        rig.until(Phase.READY, seconds=20.0)

    def test_every_state_says_why(self, rig: Rig) -> None:
        rig.ready()
        rig.run(0.3, vx=0.3)
        rig.backend.request(ModeRequest.SIT)
        rig.run(1.0)
        assert len({s.phase for s in rig.states}) >= 3
        for state in rig.states:
            assert state.cause, state
            assert 0.0 <= state.battery <= 1.0

    def test_reading_twice_at_the_same_time_gives_nothing_new(self, rig: Rig) -> None:
        rig.ready()
        rig.run(0.5)
        again = rig.backend.read(rig.now)
        assert again == [] or self.live
        assert all(sample.stamp <= rig.now for sample in again)

    # --- requests: the table in hal.contract ------------------------------------------------------------------------

    def test_unless_connected_requests_are_errors_and_velocities_nothing(self, rig: Rig) -> None:
        def refused() -> None:
            for mode in ModeRequest:
                with pytest.raises(BackendError, match="not connected"):
                    rig.backend.request(mode)
            with pytest.raises(BackendError, match="not connected"):
                rig.backend.posture(PostureCommand(0, roll=0.1))
            rig.backend.drive(VelocityCommand(0, vx=0.5))

        refused()
        rig.backend.connect()
        samples: list[Sample] = []
        while rig.backend.state().phase is not Phase.READY or len(samples) < 1000:
            assert len(samples) < 20_000
            samples += rig.backend.read(rig.tick())
        assert abs(rig.travelled(samples[-500:])) < 0.02, "what was asked for before does not count"
        rig.backend.close()
        refused()

    def test_sitting_and_damped_show_from_the_request_on(self, rig: Rig) -> None:
        rig.ready()
        for mode, phase in ((ModeRequest.SIT, Phase.SITTING), (ModeRequest.DAMP, Phase.DAMPED)):
            assert rig.request(mode).phase is phase
            rig.states.clear()
            rig.run(4.0)
            assert {s.phase for s in rig.states} == {phase}

    def test_a_fall_is_a_fault_that_recover_ends_and_stand_and_sit_do_not(self, rig: Rig) -> None:
        rig.ready()
        rig.run(0.5)
        rig.fall()
        rig.until(Phase.FAULT, seconds=3.0)
        assert "fallen" in rig.backend.state().cause
        for mode in (ModeRequest.STAND, ModeRequest.SIT):
            state = rig.request(mode)
            assert state.phase is Phase.FAULT
            assert state.cause.startswith("fallen")
            assert f"{mode.value} refused" in state.cause
        if rig.lift is not None:
            rig.request(ModeRequest.RECOVER)
            rig.until(Phase.FAULT, seconds=20.0)
            assert "put it on its" in rig.backend.state().cause
            rig.put_back()
        assert rig.request(ModeRequest.RECOVER).phase is Phase.STANDING
        rig.states.clear()
        rig.until(Phase.READY, seconds=20.0)
        assert {s.phase for s in rig.states} <= {Phase.STANDING, Phase.READY}
        assert rig.travelled(rig.run(2.0, vx=0.4)) > 0.2

    def test_damp_ends_a_fault_and_a_damped_robot_may_lie_as_it_likes(self, rig: Rig) -> None:
        rig.ready()
        rig.fall()
        rig.until(Phase.FAULT, seconds=3.0)
        assert rig.request(ModeRequest.DAMP).phase is Phase.DAMPED
        rig.states.clear()
        rig.run(3.0, vx=0.4)
        assert {s.phase for s in rig.states} == {Phase.DAMPED}
        state = rig.request(ModeRequest.STAND)
        assert state.phase is Phase.DAMPED
        assert "stand refused: the robot lies on its side or back" in state.cause
        rig.recover()

    def test_a_transition_that_does_not_come_to_its_end_is_a_fault_in_time(self, rig: Rig) -> None:
        rig.seated()
        for mode, phase, seconds in (
            (ModeRequest.STAND, Phase.STANDING, 10.0),
            (ModeRequest.RECOVER, Phase.STANDING, 25.0),
            (ModeRequest.SIT, Phase.SITTING, 10.0),
        ):
            rig.hinder(True)
            assert rig.request(mode).phase is phase
            rig.until(Phase.FAULT, seconds=seconds)
            assert re.search(r"\d s\b", rig.backend.state().cause), "it says how long it waited"
            rig.run(0.5, vx=0.4)
            assert rig.backend.state().phase is Phase.FAULT
            if mode is ModeRequest.RECOVER:
                rig.hinder(False)
                rig.request(ModeRequest.RECOVER)
                rig.until(Phase.READY, seconds=20.0)

    def test_a_latched_stop_keeps_a_lying_robot_down(self, rig: Rig) -> None:
        rig.seated()
        rig.request(ModeRequest.STOP)
        for mode in (ModeRequest.STAND, ModeRequest.RECOVER):
            state = rig.request(mode)
            assert f"{mode.value} refused: stop is latched" in state.cause
            rig.states.clear()
            rig.run(1.0)
            assert {s.phase for s in rig.states} == {Phase.SITTING}
        rig.request(ModeRequest.RESUME)
        rig.run(1.0)
        assert rig.backend.state().phase is Phase.SITTING, "resume alone moves nothing"
        rig.request(ModeRequest.STAND)
        rig.until(Phase.READY, seconds=20.0)

    def test_getting_up_is_neither_started_over_nor_turned_into_sitting(self, rig: Rig) -> None:
        rig.seated()
        assert rig.request(ModeRequest.STAND).phase is Phase.STANDING
        for mode in (ModeRequest.STAND, ModeRequest.RECOVER, ModeRequest.SIT):
            state = rig.request(mode)
            assert state.phase is Phase.STANDING
            assert ("sit refused" in state.cause) == (mode is ModeRequest.SIT)
        rig.until(Phase.READY, seconds=20.0)
