"""The Unitree backend against the robot's side in lockstep: transitions, faults, and what the robot does then."""

from __future__ import annotations

import json
import math
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.contract import Backend, BackendError
from hal.lidar.config import LidarConfig, only
from hal.rotation import rotation_rpy
from hal.safety.monitors import MOTOR_LOST, SWEEP_LATE, taken_out
from hal.types import (
    NS,
    POINT_QUANTUM,
    ImuSample,
    JointSample,
    LidarScan,
    ModeRequest,
    Phase,
    PostureCommand,
    RobotState,
    VelocityCommand,
)
from hal.unitree.api import Sport
from hal.unitree.config import UnitreeConfig
from hal.unitree.link import L1_CLOUD
from tests.hal.unitree.robot import LOW_STATE_RATE, Faults, KinematicBody, RobotSide
from tests.hal.unitree.world import EVERYTHING, HOST_EPOCH, RATE, World

REST = 0.05
"""[m/s]; the body approaches zero exponentially."""


def ready(faults: Faults | None = None, **kwargs) -> World:
    world = World(faults, **kwargs)
    world.backend.connect()
    world.until(Phase.READY, 20.0)
    return world


# --- the plain way ------------------------------------------------------------------------------------------------


def test_it_is_a_backend():
    assert isinstance(World().backend, Backend)


def test_connects_to_a_standing_robot_and_drives_it():
    world = ready()
    assert world.apis("motion_switcher") == [1001]
    world.run(3.0, vx=0.4)
    assert world.phase is Phase.MOVING
    assert world.body.x == pytest.approx(0.9 * 0.4 * 3.0, abs=0.12)
    moves = [(at, r) for at, s, r in world.sent if s == "sport" and r.api == Sport.MOVE]
    gaps = np.diff([at for at, _ in moves]) / NS
    assert gaps.max() <= 0.05
    assert len(moves) / 3.0 <= 55
    assert json.loads(moves[-1][1].parameter) == {"x": 0.4, "y": 0.0, "z": 0.0}
    assert all(r.no_reply for _, r in moves)


def test_zero_velocity_sends_stop_move_and_falls_silent():
    world = ready()
    world.run(2.0, vx=0.5)
    before = len(world.sent)
    world.run(2.0)
    after = [r.api for _, s, r in world.sent[before:] if s == "sport"]
    assert Sport.STOP_MOVE in after[:2], "at once; one Move was due before the host asked for zero"
    assert after.count(Sport.STOP_MOVE) == 1
    assert 5 <= after.count(Sport.MOVE) <= 20
    assert abs(world.body.v) < REST
    quiet = len(world.sent)
    world.run(1.0)
    assert len(world.sent) == quiet


def test_samples_have_host_stamps_rates_and_frames():
    world = ready(Faults(epoch=0.0), rate=LOW_STATE_RATE)  # the robot's clock says 1970
    world.run(1.0)
    samples = world.run(2.0, wz=0.4)
    for kind, rate in ((ImuSample, 250), (JointSample, 50), (LidarScan, 10), (RobotState, 25)):
        stamps = np.array([s.stamp for s in samples if isinstance(s, kind)])
        assert len(stamps) == pytest.approx(2.0 * rate, rel=0.1), kind
        assert (np.diff(stamps) > 0).all()
        assert stamps[0] > HOST_EPOCH
        assert stamps[-1] <= world.now
    imu = [s for s in samples if isinstance(s, ImuSample)]
    assert np.mean([s.accel[2] for s in imu]) == pytest.approx(9.81, abs=0.05)
    assert np.mean([s.gyro[2] for s in imu[250:]]) == pytest.approx(0.38, abs=0.02)
    # Stamps follow the robot's clock, not the 20 ms of the host loop.
    assert np.diff([s.stamp for s in imu]).max() < 5_000_000
    assert world.backend.state().battery == pytest.approx(0.87)
    assert world.backend.state().motor_temperature == 38.0


def test_the_flipped_l1_shows_the_floor_below():
    world = ready()
    scans = [s for s in world.run(1.0) if isinstance(s, LidarScan)]
    mount = world.backend.capabilities.lidars[0].mount
    points = scans[-1].points
    local = np.stack([points["x"], points["y"], points["z"]], axis=1)
    base = local @ rotation_rpy(*mount.rpy).T + mount.translation
    floor = base[np.hypot(base[:, 0], base[:, 1]) < 4.5]
    assert len(floor) > 500
    assert np.abs(floor[:, 2] + 0.40).max() < 0.01
    assert points["time"].max() == pytest.approx(0.1, abs=1e-3)


def test_imu_of_the_l1_is_turned_into_the_trunk():
    world = ready(options=UnitreeConfig(lidars=only("l1"), imu="l1"), rate=LOW_STATE_RATE)
    imu = [s for s in world.run(2.0, wz=0.4) if isinstance(s, ImuSample)]
    assert len(imu) == pytest.approx(500, rel=0.1)
    assert imu[-1].gyro == pytest.approx([0.0, 0.0, 0.38], abs=0.02)
    assert imu[-1].accel == pytest.approx([0.0, 0.0, 9.81], abs=0.05)


def test_a_lying_robot_stands_up_with_unlocked_joints():
    world = World(standing=False)
    world.backend.connect()
    assert world.phase is Phase.SITTING
    world.run(0.1, vx=0.3)
    assert world.phase is Phase.SITTING
    world.backend.request(ModeRequest.STAND)
    world.until(Phase.STANDING, 0.1)
    world.until(Phase.READY, 10.0)
    calls = world.apis()
    assert calls.index(Sport.STAND_UP) < calls.index(Sport.BALANCE_STAND)
    assert Sport.MOVE not in calls[: calls.index(Sport.BALANCE_STAND)]
    world.run(2.0, vx=0.3)
    assert world.body.x > 0.3


def test_asking_again_does_not_start_a_transition_over():
    world = World(standing=False)
    world.backend.connect()
    for _ in range(100):
        world.backend.request(ModeRequest.STAND)
        world.run(0.04)
    assert world.phase is Phase.READY
    assert world.apis().count(Sport.STAND_UP) == 1
    for _ in range(100):
        world.backend.request(ModeRequest.SIT)
        world.run(0.04)
    assert world.phase is Phase.SITTING
    assert world.apis().count(Sport.STAND_UP) == 1, "lying, it must not stand up to lie down"
    assert world.apis().count(Sport.STAND_DOWN) == 1


def test_sits_damps_and_comes_back():
    world = ready()
    world.run(1.0, vx=0.3)
    world.backend.request(ModeRequest.SIT)
    world.run(3.0)
    assert (world.phase, world.cause) == (Phase.SITTING, "lying")
    assert world.body.phase is Phase.SITTING
    world.backend.request(ModeRequest.STAND)
    world.until(Phase.READY, 10.0)
    world.backend.request(ModeRequest.DAMP)
    world.run(0.5)
    assert (world.phase, world.cause) == (Phase.DAMPED, "joints are soft")
    assert world.body.phase is Phase.DAMPED
    world.backend.request(ModeRequest.RECOVER)
    world.until(Phase.READY, 10.0)
    assert Sport.RECOVERY_STAND in world.apis()


def test_stop_is_immediate_latches_and_needs_resume():
    world = ready()
    world.run(2.0, vx=0.5)
    before = len(world.sent)
    world.backend.request(ModeRequest.STOP)
    assert [r.api for _, _, r in world.sent[before : before + 2]] == [Sport.STOP_MOVE, Sport.MOVE]
    world.run(1.0, vx=0.5)
    assert world.phase is Phase.STOPPED
    assert world.cause == "emergency stop"
    assert abs(world.body.v) < REST
    world.backend.request(ModeRequest.STAND)
    world.run(0.5, vx=0.5)
    assert world.phase is Phase.STOPPED
    world.backend.request(ModeRequest.RESUME)
    world.run(1.0, vx=0.5)
    assert world.phase is Phase.MOVING


def test_close_stops_lies_down_and_never_releases_the_motion_service():
    world = ready()
    world.run(2.0, vx=0.5)
    start = world.elapsed
    world.backend.close()
    world.backend.close()
    assert (world.elapsed - start) / NS < 3.0
    assert world.phase is Phase.DISCONNECTED
    world.advance(1.5)
    assert world.body.phase is Phase.SITTING
    assert world.apis("motion_switcher") == [1001]
    assert world.backend.read(world.now) == []


def test_a_program_that_failed_leaves_the_robot_stopped_and_on_its_feet():
    world = ready()
    world.run(2.0, vx=0.5)
    world.backend.close(lie_down=False)
    world.advance(1.5)
    assert abs(world.body.v) < REST
    assert world.body.phase is Phase.READY
    assert Sport.STAND_DOWN not in world.apis()


def test_attitude_offsets_are_repeated_at_rest_only():
    world = ready()
    world.backend.posture(PostureCommand(world.now, roll=0.2, pitch=2.0))
    world.run(1.0)
    eulers = [json.loads(r.parameter) for _, _, r in world.sent if r.api == Sport.EULER]
    assert 4 <= len(eulers) <= 7
    assert eulers[0] == {"x": 0.2, "y": 0.75, "z": 0.0}
    world.run(1.0, vx=0.3)
    assert len([r for _, _, r in world.sent if r.api == Sport.EULER]) <= len(eulers) + 1
    world.backend.posture(PostureCommand(world.now))
    world.run(1.0)
    world.run(0.5, vx=0.0)
    eulers = [json.loads(r.parameter) for _, _, r in world.sent if r.api == Sport.EULER][len(eulers) :]
    assert eulers.count({"x": 0.0, "y": 0.0, "z": 0.0}) == 1, "level is told once"


def test_obstacle_avoidance_takes_and_gives_back_the_remote_role():
    world = ready(options=UnitreeConfig(lidars=only("l1"), avoid_obstacles=True))
    assert world.robot.avoid_remote
    world.run(2.0, vx=0.4)
    assert world.body.x > 0.5
    assert Sport.MOVE not in world.apis()
    world.backend.close()
    assert not world.robot.avoid_remote


def test_velocities_beyond_the_limits_are_clipped_and_nan_is_zero():
    world = ready()
    world.run(0.5, vx=3.0, wz=-9.0)
    move = [json.loads(r.parameter) for _, _, r in world.sent if r.api == Sport.MOVE][-1]
    assert move == {"x": 0.8, "y": 0.0, "z": -1.0}
    world.run(0.5, vx=math.nan)
    assert abs(world.body.v) < 0.05
    assert "finite" in world.cause


def test_dry_run_sends_nothing_and_says_what_it_would():
    world = World(dry_run=True)
    world.backend.connect()
    world.run(0.5)
    assert (world.phase, world.cause) == (
        Phase.READY,
        "dry run, nothing is sent: balance stand, takes velocity",
    )
    world.run(13.0, vx=0.4)
    assert world.phase is Phase.READY, "that it does not move is no fault"
    world.backend.request(ModeRequest.SIT)
    world.run(1.0)
    world.backend.request(ModeRequest.STOP)
    world.run(0.5)
    world.backend.close()
    assert world.sent == []
    assert world.body.x == 0.0
    assert any(api == Sport.MOVE for _, _, api, _ in world.backend._rpc.history)
    world.backend.connect()
    world.until(Phase.READY, 2.0)
    world.backend.close()
    assert world.sent == []


# --- faults -------------------------------------------------------------------------------------------------------


def test_a_silent_host_stops_the_robot():
    world = ready()
    world.run(2.0, vx=0.5)
    for _ in range(25):  # reads go on, drives do not: the tracker died, say, or the gate is stuck
        world.advance(0.02)
        world.backend.read(world.now)
    assert abs(world.body.v) < REST
    assert "no velocity from the host" in world.cause


def test_a_dead_host_without_guardian_is_what_the_robot_makes_of_it():
    world = ready()
    world.run(2.0, vx=0.5)
    x = world.body.x
    world.advance(2.0)
    assert 0.4 < world.body.x - x < 0.7, "the one-second hold: the reason for the guardian"


def test_deaf_after_standing_up_is_waited_for():
    world = World(Faults(deaf=8.0), standing=False)
    world.backend.connect()
    world.backend.request(ModeRequest.STAND)
    world.until(Phase.READY, 10.0)
    world.run(3.0, vx=0.3)
    assert world.phase is Phase.READY
    assert "Move is not followed" in world.cause
    world.until(Phase.MOVING, 8.0, vx=0.3)
    assert world.body.v > 0.05


def test_a_robot_that_never_follows_is_a_fault():
    world = ready()
    world.robot._deaf_until = 10**18
    state = world.until(Phase.FAULT, 15.0, vx=0.3)
    assert "ignores Move" in state.cause
    assert world.apis()[-2:].count(Sport.STOP_MOVE) + world.apis()[-2:].count(Sport.MOVE) == 2
    world.robot._deaf_until = 0
    world.backend.request(ModeRequest.RECOVER)
    world.until(Phase.READY, 5.0)
    world.until(Phase.MOVING, 2.0, vx=0.3)


def test_released_motion_service_is_selected_through_busy():
    world = World(
        Faults(released=True, busy=6.0), options=UnitreeConfig(lidars=only("l1"), connect_timeout=2.0)
    )
    world.backend.connect()
    world.until(Phase.READY, 5.0)
    assert world.robot.motion == "ai-w"
    assert world.apis("motion_switcher").count(1002) > 3


def test_an_answer_that_cannot_be_read_does_not_replace_the_running_motion_service():
    world = World(Faults(babble=True))
    with pytest.raises(BackendError, match=r"which motion service is active: answer .* is not JSON"):
        world.backend.connect()
    assert world.apis("motion_switcher") == [1001]


def test_busy_for_too_long_is_an_error_with_advice():
    world = World(
        Faults(released=True, busy=60.0), options=UnitreeConfig(lidars=only("l1"), connect_timeout=1.0)
    )
    with pytest.raises(BackendError, match="busy"):
        world.backend.connect()


def test_release_while_driving_is_a_fault_and_recover_brings_it_back():
    world = ready(Faults(busy=5.0))
    world.run(2.0, vx=0.5)
    world.robot.release(world.elapsed)
    state = world.until(Phase.FAULT, 2.0, vx=0.5)
    assert "sport service is silent" in state.cause
    world.backend.request(ModeRequest.RECOVER)
    world.until(Phase.READY, 15.0)


@pytest.mark.parametrize("fault", ["low_silent", "low_frozen"])
def test_stale_low_state_disconnects_and_its_return_reconnects(fault: str):
    world = ready()
    world.run(2.0, vx=0.5)
    setattr(world.faults, fault, True)
    start = world.elapsed
    state = world.until(Phase.DISCONNECTED, 0.5, vx=0.5)
    assert (world.elapsed - start) / NS <= 0.26
    assert "no LowState" in state.cause
    world.run(0.3, vx=0.5)
    assert abs(world.body.v) < REST
    setattr(world.faults, fault, False)
    world.until(Phase.READY, 1.0)
    world.run(1.0, vx=0.5)
    assert world.phase is Phase.MOVING


LONGER = [pytest.param(late, 0.0, marks=pytest.mark.campaign) for late in (0.6, 1.2)]


@pytest.mark.parametrize(("late", "answers"), [(0.3, 0.0), (0.6, 0.6), *LONGER])
def test_late_telemetry_holds_the_robot_for_as_long_as_it_lasts(late: float, answers: float):
    """Also where requests are answered at once: what lost nothing on its way was delayed."""
    world = ready()
    world.run(2.0, vx=0.5)
    world.late = {EVERYTHING: late, "motion_switcher": answers}
    world.run(0.5, vx=0.5)
    assert abs(world.body.v) < REST
    world.run(late)
    x = world.body.x
    samples = world.run(15.0, vx=0.5)
    assert world.body.x - x < 0.01
    assert world.phase is Phase.DISCONNECTED
    assert world.cause == f"telemetry of the robot arrives {late:.1f} s late"
    ages = [(world.now - s.stamp) / NS for s in samples[-20:] if isinstance(s, ImuSample)]
    assert late <= min(ages) < late + 0.1
    world.late = {}
    world.run(late)
    world.until(Phase.READY, 1.0)
    world.run(1.0, vx=0.5)
    assert world.phase is Phase.MOVING
    assert world.backend.diagnostics()["clock_jumps"] == 0


@pytest.mark.parametrize("step", [-0.6, -3.0, 0.6, 5.0])
def test_a_step_of_the_robots_clock_is_told_from_a_delay_by_the_round_trip_of_a_request(step: float):
    world = ready(rate=LOW_STATE_RATE)
    world.run(2.0, vx=0.5)
    world.faults.tick_step = step
    world.late = {"motion_switcher": 0.3}  # nobody shows that the way is short
    world.run(3.0, vx=0.5)
    assert (world.phase is Phase.DISCONNECTED) == (step < 0.0)
    if step < 0.0:
        assert world.cause == f"the clock of the robot stepped by {step:+.2f} s, waiting for prompt answers"
        assert abs(world.body.v) < REST
    world.late = {}
    world.run(0.5)
    world.until(Phase.READY, 1.0)
    samples = world.run(1.0, vx=0.5)
    assert world.body.v > 0.3
    assert all(0 <= world.now - s.stamp < NS + NS // 20 for s in samples)
    assert world.backend.diagnostics()["clock_jumps"] == 1


@pytest.mark.parametrize(
    "step", [-0.08, *(pytest.param(step, marks=pytest.mark.campaign) for step in (-0.3, 0.3)), 0.9]
)
def test_a_step_of_a_lidars_clock_names_the_clock(step: float):
    world = ready()
    world.run(2.0)
    before = [s.stamp for s in world.run(1.0) if isinstance(s, LidarScan)]
    world.faults.lidar_step = step
    scans = [s.stamp for s in world.run(1.5) if isinstance(s, LidarScan)]
    assert len(scans) >= 12
    phases = np.array([*before, *scans]) / (NS // 10) % 1.0  # the sweeps end when they ended before
    assert np.ptp((phases - phases[0] + 0.5) % 1.0) < 0.25
    words, size = world.cause.removesuffix(" s").rsplit(" ", 1)
    assert words == "the clock of the main LiDAR stepped by"
    assert float(size) == pytest.approx(step, abs=0.025)  # read in a loop of 20 ms
    assert world.backend.diagnostics()["clock_jumps"] == 1
    world.run(11.0)
    assert world.cause == "balance stand, takes velocity"


def test_sweeps_that_come_late_keep_their_true_stamps_and_are_told():
    world = ready()
    world.run(2.0)
    world.late = {L1_CLOUD: 0.6}
    scans = [s for s in world.run(12.0) if isinstance(s, LidarScan)]
    assert world.cause == "sweeps of the main LiDAR arrive 0.6 s late"
    assert 0.65 < (world.now - scans[-1].stamp) / NS < 0.85
    with taken_out(SWEEP_LATE.name):
        world.run(1.0)
        assert world.cause == "balance stand, takes velocity"
    world.late = {}
    world.run(1.5)
    assert world.cause == "balance stand, takes velocity"


@pytest.mark.parametrize("fault", ["sport_silent", "sport_frozen"])
def test_stale_sport_state_is_a_fault_with_a_stop_that_recover_ends(fault: str):
    world = ready()
    world.run(2.0, vx=0.5)
    setattr(world.faults, fault, True)
    state = world.until(Phase.FAULT, 2.0, vx=0.5)
    assert "sport service is silent" in state.cause
    world.run(0.4, vx=0.5)
    assert abs(world.body.v) < REST
    setattr(world.faults, fault, False)
    world.run(1.0, vx=0.5)
    assert world.phase is Phase.FAULT, "somebody has to look at it"
    world.backend.request(ModeRequest.RECOVER)
    world.until(Phase.READY, 5.0)


def test_a_cut_cable_mid_motion_and_its_return():
    world = ready()
    world.run(2.0, vx=0.5)
    world.cut = True
    state = world.until(Phase.DISCONNECTED, 0.5, vx=0.5)
    assert "check cable" in state.cause
    world.run(2.0, vx=0.5)
    assert abs(world.body.v) < REST, "the robot's own hold ran out"
    world.cut = False
    world.until(Phase.READY, 1.0)


def test_silence_after_a_message_that_was_a_little_late_is_told_as_silence():
    world = ready()
    world.run(2.0)
    world.late = {EVERYTHING: 0.06}
    world.run(1.0)
    world.cut, world.late = True, {}
    assert "no LowState" in world.until(Phase.DISCONNECTED, 0.5).cause


def restarted(world: World, faults: Faults, standing: bool) -> None:
    """The robot's computers start anew a second later: nothing of before is known to them."""
    world.cut = True
    world.run(1.0)
    world.cut = False
    world.body = KinematicBody(standing)
    world.robot = RobotSide(world.body, faults, topic=L1_CLOUD)
    world.faults = world.robot.faults
    switched_on, handle, step = world.elapsed, world.robot.handle, world.robot.step
    responses = world.robot.responses
    world.robot.step = lambda now: step(now - switched_on)  # type: ignore[method-assign]
    world.robot.handle = lambda service, request, now: handle(service, request, now - switched_on)  # type: ignore[method-assign]
    world.robot.responses = lambda now: responses(now - switched_on)  # type: ignore[method-assign]


def test_a_restarted_robot_is_noticed():
    world = ready()
    world.run(2.0, vx=0.5)
    restarted(world, Faults(epoch=5.0), standing=False)
    world.run(1.0, vx=0.5)
    assert world.phase is Phase.SITTING
    assert world.backend.diagnostics()["robot_restarts"] == 1
    stamps = [s.stamp for s in world.run(1.0) if isinstance(s, ImuSample)]
    assert abs(stamps[-1] - world.now) < NS // 10


def test_a_dry_run_follows_a_restarted_robot():
    """It asks nothing, so no answer tells a restart from a delay: the tick that begins anew does."""
    world = World(dry_run=True)
    world.backend.connect()
    world.run(3.0)
    restarted(world, Faults(epoch=5.0), standing=True)
    world.run(3.0)
    stamps = [s.stamp for s in world.run(1.0) if isinstance(s, ImuSample)]
    assert abs(stamps[-1] - world.now) < NS // 10
    assert world.sent == []


def test_control_of_a_restarted_robot_is_taken_again():
    """It came back listening to its joystick alone."""
    world = ready(options=UnitreeConfig(lidars=only("l1"), avoid_obstacles=True))
    world.run(2.0, vx=0.5)
    restarted(world, Faults(late=0.1), standing=True)
    world.states.clear()
    world.until(Phase.READY, 2.0, vx=0.5)
    assert {state.cause.split(":")[0] for state in world.states if state.phase is Phase.STANDING} == {
        "taking control again"
    }
    assert world.robot.avoid_remote
    world.run(1.0, vx=0.5)
    assert world.body.v > 0.3


def test_a_sport_service_that_comes_back_after_low_state_is_waited_for():
    """A fault would latch the safety gate."""
    world = ready()
    world.run(2.0, vx=0.5)
    world.cut = True
    world.run(3.0)
    world.cut, world.faults.sport_silent = False, True
    world.states.clear()
    world.run(0.6, vx=0.5)
    assert {state.phase for state in world.states} == {Phase.DISCONNECTED}
    assert world.cause == "LowState is back, waiting for sportmodestate"
    world.faults.sport_silent = False
    world.until(Phase.READY, 1.0)
    world.cut = True
    world.run(3.0)
    world.cut, world.faults.sport_silent = False, True
    world.until(Phase.FAULT, 1.5)
    assert "sport service is silent" in world.cause


@pytest.mark.parametrize(("drop", "late"), [(2, 0.0), (0, 0.4), (0, 0.9)])
def test_lost_and_late_responses_are_repeated(drop: int, late: float):
    world = World(Faults(drop=drop, late=late), standing=False)
    world.backend.connect()
    world.faults.drop = drop
    world.backend.request(ModeRequest.STAND)
    world.until(Phase.READY, 20.0)


def test_responses_later_than_patience_end_in_a_fault_that_names_the_service():
    world = ready()
    world.faults.late = 2.5
    world.backend.request(ModeRequest.SIT)
    state = world.until(Phase.FAULT, 10.0)
    assert "no answer in time (3104)" in state.cause
    assert "sport" in state.cause
    world.faults.late = 0.0
    world.run(3.0)
    assert world.backend.diagnostics()["late_responses"] == 3


def test_a_refused_request_ends_in_a_fault_in_plain_words():
    world = World(Faults(refuse={Sport.STAND_UP: 4201}), standing=False)
    world.backend.connect()
    world.backend.request(ModeRequest.STAND)
    state = world.until(Phase.FAULT, 3.0)
    assert "action took too long (4201)" in state.cause


def test_no_robot_is_an_error_with_advice():
    world = World(
        Faults(low_silent=True, sport_silent=True), options=UnitreeConfig(lidars=(), connect_timeout=1.0)
    )
    with pytest.raises(BackendError, match=r"no LowState .* switched on.* cable"):
        world.backend.connect()
    assert world.elapsed < 2 * NS
    assert world.phase is Phase.DISCONNECTED


def test_fallen_is_a_fault_until_recovered():
    world = ready()
    world.faults.fallen = True
    state = world.until(Phase.FAULT, 0.5, vx=0.3)
    assert "fallen" in state.cause
    world.faults.fallen = False
    world.run(0.5)
    assert world.phase is Phase.FAULT, "standing again by itself is not enough"
    world.backend.request(ModeRequest.RECOVER)
    world.until(Phase.READY, 10.0)


class FakeGuardian:
    """The driver's end of a guardian process that lives and gets ready as it is told to."""

    made: ClassVar[list[FakeGuardian]] = []

    def __init__(self, *_arguments: object) -> None:
        self.lives, self.ready, self.killed, self.moving = True, False, False, False
        self.pid = 1
        self.made.append(self)

    def alive(self) -> bool:
        return self.lives

    def kill(self) -> None:
        self.killed = True

    def beat(self, moving: bool) -> None:
        self.moving = moving

    stop = damp = leave_off = close = lambda self: None

    def wait_ready(self, _timeout: float) -> None:
        self.ready = True


@pytest.fixture
def guarded(monkeypatch: pytest.MonkeyPatch) -> World:
    """A robot that is ready, and whose guardian is the only one of `FakeGuardian.made`."""
    monkeypatch.setattr("hal.unitree.backend.Guardian", FakeGuardian)
    FakeGuardian.made.clear()
    world = World()
    world.backend._guarded = True
    world.backend.connect()
    world.until(Phase.READY, 5.0)
    return world


def test_nothing_moves_without_a_guardian_that_is_ready(guarded: World):
    world = guarded
    world.until(Phase.MOVING, 2.0, vx=0.5)
    (first,) = FakeGuardian.made
    first.lives = False
    assert "guardian process lost" in world.until(Phase.FAULT, 0.1, vx=0.5).cause
    world.backend.request(ModeRequest.RECOVER)
    assert first.killed, "a guardian that hangs must not be waited for"
    x = world.body.x
    world.run(5.0, vx=0.5)
    assert (world.phase, world.cause) == (Phase.STANDING, "waiting for the guardian process")
    assert world.body.x - x < 0.2
    FakeGuardian.made[1].ready = True
    world.until(Phase.MOVING, 2.0, vx=0.5)


def test_the_guardian_hears_of_a_motion_before_the_robot_does(
    guarded: World, monkeypatch: pytest.MonkeyPatch
):
    """A host that dies after the first Move must not leave a guardian that takes the robot to be at rest."""
    world = guarded
    (guardian,) = FakeGuardian.made
    assert not guardian.moving
    told: list[bool] = []
    monkeypatch.setattr(world, "send", lambda *_: told.append(guardian.moving))
    world.backend.drive(VelocityCommand(world.now, vx=0.5))
    assert told == [True]


def test_an_l1_mounted_the_other_way_round_is_found_out_by_gravity():
    world = World(Faults(upright_l1=True))
    world.backend.connect()
    state = world.until(Phase.FAULT, 3.0)
    assert "165 deg" in state.cause
    assert "check the mount in lidars" in state.cause


def test_an_l1_quaternion_in_the_other_order_is_told_and_the_setting_mends_it():
    world = ready(Faults(wxyz=False))
    world.run(1.5)
    assert world.phase is Phase.READY
    assert world.cause == "the L1 stores its quaternion x, y, z, w: set unitree.l1_imu_wxyz=false"
    world.run(2.0, vx=0.3)
    assert world.body.x > 0.3, "nothing drives by it"
    for faults, setting in ((Faults(wxyz=False), False), (Faults(), True)):
        world = ready(faults, options=UnitreeConfig(lidars=only("l1"), l1_imu_wxyz=setting))
        world.run(1.5)
        assert world.cause == "balance stand, takes velocity"


def in_base(world: World) -> np.ndarray:
    """(n, 3) points of a sweep that comes within the next second."""
    scan = next(s for s in world.run(1.0) if isinstance(s, LidarScan)).points
    mount = world.backend.capabilities.lidars[0].mount
    local = np.stack([scan["x"], scan["y"], scan["z"]], axis=1).astype(np.float64)
    return local @ rotation_rpy(*mount.rpy).T + mount.translation


def test_an_l1_turned_about_itself_is_set_right_by_its_yaw():
    usual = in_base(ready())
    yaw = -2.15
    turned = ready(Faults(l1_yaw=yaw), options=UnitreeConfig(lidars=only("l1"), l1_yaw=yaw))
    np.testing.assert_allclose(in_base(turned), usual, atol=2 * POINT_QUANTUM)
    assert turned.cause == "balance stand, takes velocity"
    unset = in_base(ready(Faults(l1_yaw=yaw)))
    assert np.abs(unset - usual).max() > 1.0


def test_the_z_rate_that_leaks_into_the_l1s_gyro_is_taken_out():
    def rates(leak: float) -> np.ndarray:
        options = UnitreeConfig(lidars=only("l1"), imu="l1", l1_gyro_leak=(leak, 0.0))
        samples = ready(Faults(l1_leak=0.15), options=options).run(2.0, wz=0.4)
        return [s for s in samples if isinstance(s, ImuSample)][-1].gyro

    assert rates(0.15) == pytest.approx([0.0, 0.0, 0.38], abs=0.01)
    assert np.linalg.norm(rates(0.0) - [0.0, 0.0, 0.38]) > 0.04


def test_the_lidars_stamps_are_shifted_by_its_time_offset():
    def stamps(offset: float) -> np.ndarray:
        world = ready(options=UnitreeConfig(lidars=(LidarConfig(model="l1", time_offset=offset),)))
        return np.array([s.stamp - world.epoch for s in world.run(1.0) if isinstance(s, LidarScan)])

    np.testing.assert_array_equal(stamps(0.0) - stamps(-0.005), 5_000_000)


@pytest.mark.parametrize(
    ("sticks", "moved"),
    [
        ((0.0, 0.0, 0.0, 0.0, 0.0), False),
        ((0.05, -0.05, 0.05, 0.0, 0.05), False),
        ((0.0, 0.0, 0.0, 1.0, 0.0), False),  # the trigger is no stick
        ((math.nan, 1e30, -math.inf, 0.0, 0.0), False),  # these bytes are no sticks
        ((0.2, 0.0, 0.0, 0.0, 0.0), True),
        ((0.0, -0.2, 0.0, 0.0, 0.0), True),
        ((0.0, 0.0, 1.0, 0.0, 0.0), True),
        ((math.nan, 0.0, 0.0, 0.0, -1.0), True),
    ],
)
def test_the_sticks_of_the_robots_own_remote_are_seen(sticks: tuple[float, ...], moved: bool):
    world = ready()
    assert not world.backend.state().remote
    world.faults.remote = sticks
    world.run(0.1)
    assert world.backend.state().remote == moved


def test_low_state_with_a_wrong_checksum_is_not_believed():
    world = ready(rate=LOW_STATE_RATE)
    world.run(2.0, vx=0.5)
    world.faults.low_bent = True
    state = world.until(Phase.DISCONNECTED, 0.5, vx=0.5)
    assert "unreadable, its checksum is wrong" in state.cause
    world.run(0.4, vx=0.5)
    assert abs(world.body.v) < REST
    world.faults.low_bent = False
    world.until(Phase.READY, 2.0)
    assert world.backend.diagnostics()["unreadable rt/lowstate"] > 200


def test_a_robot_whose_checksums_are_always_wrong_is_an_error_with_the_setting_that_takes_them():
    options = {"lidars": only("l1"), "connect_timeout": 1.0}
    world = World(Faults(low_bent=True), options=UnitreeConfig(**options))
    with pytest.raises(BackendError, match=r"its checksum is wrong; .*unitree.check_crc=false"):
        world.backend.connect()
    ready(Faults(low_bent=True), options=UnitreeConfig(**options, check_crc=False))
    ready(Faults(unsigned=True))


def test_garbage_on_every_topic_is_counted_and_survived():
    world = ready(Faults(garbage=True))
    samples = world.run(3.0, vx=0.4)
    assert world.phase is Phase.MOVING
    assert world.body.x > 0.8
    assert len([s for s in samples if isinstance(s, LidarScan)]) >= 25
    words = (name.split() for name in world.backend.diagnostics())
    unreadable = {word[1] for word in words if word[0] == "unreadable"}
    assert unreadable == {"rt/lowstate", "rt/sportmodestate", "rt/utlidar/imu", "rt/utlidar/cloud"}


def test_a_clock_set_from_1970_while_running_does_not_break_the_stamps():
    world = ready(Faults(epoch=12.0))
    world.run(2.0)
    world.faults.epoch = 1.75e9
    world.run(1.0)
    scans = [s for s in world.run(1.0) if isinstance(s, LidarScan)]
    assert len(scans) >= 9
    assert all(0 <= world.now - s.stamp < 2 * NS for s in scans)
    assert world.backend.diagnostics()["clock_jumps"] == 1


IMPOSSIBLE = {
    "IMU in g": (
        "accel_scale",
        1 / 9.81,
        "IMU measures 1.0 m/s^2 on average, gravity has 9.8: its unit is wrong",
    ),
    "IMU reversed": (
        "accel_scale",
        -1.0,
        "IMU: gravity is 180 deg from where its gyro tells: signs or units are wrong",
    ),
    "IMU too large": (
        "accel_scale",
        1e28,
        "IMU: an acceleration of 9.81e+28 m/s^2, possible are -400 to 400",
    ),
    "L1 too large": (
        "l1_accel",
        1e28,
        "IMU of the L1: an acceleration of -7.05e+27 m/s^2, possible are -400 to 400",
    ),
    "motor": ("lost", 9999, "motor FL_calf has lost 9999 messages, error bits 0x4"),
}


@pytest.mark.parametrize("kind", IMPOSSIBLE)
def test_what_cannot_be_is_refused_and_told_with_stream_value_and_range(kind: str):
    name, value, words = IMPOSSIBLE[kind]
    world = ready()
    world.run(1.0)
    usual = getattr(world.faults, name)
    setattr(world.faults, name, value)
    world.run(2.0)
    samples = world.run(1.0)
    assert words in world.cause
    assert world.phase is Phase.READY, "no lasting fault"
    imu = [s for s in samples if isinstance(s, ImuSample)]
    assert bool(imu) == (name != "accel_scale"), "the gate holds for want of an IMU"
    assert any(isinstance(s, LidarScan) for s in samples)
    setattr(world.faults, name, usual)
    world.run(4.0)
    assert world.cause == "balance stand, takes velocity"
    assert len([s for s in world.run(1.0) if isinstance(s, ImuSample)]) == RATE


def test_without_the_monitor_nobody_reads_of_lost_messages():
    world = ready()
    world.faults.lost = 9999
    with taken_out(MOTOR_LOST.name):
        world.run(2.0)
    assert world.cause == "balance stand, takes velocity"


def test_an_imu_whose_signs_were_reversed_from_the_start_is_told_from_a_robot_on_its_back():
    world = World(Faults(accel_scale=-1.0))
    world.backend.connect()
    assert not [s for s in world.run(2.0) if isinstance(s, ImuSample)]
    assert world.phase is Phase.READY, "its own attitude says that it stands"
    assert "IMU tells that the robot lies on its side or back, tilted by 180 deg" in world.cause
    world = World(Faults(fallen=True))
    world.backend.connect()
    world.run(1.0)
    assert "fallen" in world.cause


_action = st.one_of(
    st.tuples(st.just("run"), st.floats(0.02, 1.5), st.floats(-1, 1)),
    st.tuples(st.just("mode"), st.sampled_from(list(ModeRequest))),
    st.tuples(
        st.just("fault"),
        st.sampled_from(
            ["low_silent", "low_frozen", "sport_silent", "sport_frozen", "fallen", "stuck", "garbage"]
        ),
        st.booleans(),
    ),
    st.tuples(st.just("late"), st.sampled_from([0.0, 0.3, 2.0])),
    st.tuples(st.just("drop"), st.integers(0, 3)),
    st.tuples(st.just("cut"), st.booleans()),
    st.tuples(st.just("release")),
)


@given(st.lists(_action, max_size=12))
@settings(max_examples=12)
def test_whatever_happens_there_is_a_phase_with_a_cause_and_rest_when_not_driven(actions):
    world = ready()
    for action in actions:
        match action:
            case ("run", seconds, vx):
                world.run(seconds, vx)
            case ("mode", mode):
                world.backend.request(mode)
            case ("fault", name, on):
                setattr(world.faults, name, on)
            case ("late", value):
                world.faults.late = value
            case ("drop", value):
                world.faults.drop = value
            case ("cut", value):
                world.cut = value
            case ("release",):
                world.robot.release(world.elapsed)
        assert world.cause
    world.run(0.04)
    world.run(1.5)  # zero velocity; the longest is a cut cable: the robot's own hold and its braking
    assert abs(world.body.v) < REST
    assert abs(world.body.wz) < 0.02
    assert all(state.cause for state in world.states)
    start = world.elapsed
    world.backend.close()
    assert (world.elapsed - start) / NS < 3.5


CODES = {1001: "damped", 1002: "standing", 1013: "ready"}


def test_a_robot_that_tells_its_posture_in_error_code_stands_drives_and_lies_down():
    options = UnitreeConfig.model_validate({"lidars": (), "state_codes": CODES})
    world = World(Faults(coded=True), standing=False, options=options)
    world.backend.connect()
    world.run(0.5)
    assert world.phase is Phase.DAMPED
    world.backend.request(ModeRequest.STAND)
    world.until(Phase.READY, 12.0)
    world.run(3.0, vx=0.4)
    assert world.phase is Phase.MOVING
    assert world.body.x > 0.5
    world.backend.request(ModeRequest.SIT)
    world.until(Phase.DAMPED, 12.0)
    assert world.body.height < 0.2


def test_a_code_that_is_not_known_never_makes_a_robot_ready_and_is_told():
    world = World(Faults(coded=True), standing=False, options=UnitreeConfig(lidars=()))
    world.backend.connect()
    world.backend.request(ModeRequest.STAND)
    state = world.until(Phase.FAULT, 30.0)
    assert "error_code 1013, mode 0" in state.cause
    assert "unitree.state_codes" in state.cause
    world.run(1.0, vx=0.4)
    assert world.body.x == 0.0


def test_a_dry_run_logs_what_the_posture_is_read_from(caplog):
    caplog.set_level("INFO")
    world = World(options=UnitreeConfig(lidars=()), dry_run=True)
    world.backend.connect()
    world.run(1.0)
    told = [r.getMessage() for r in caplog.records if r.getMessage().startswith("sportmodestate:")]
    assert len(told) == 1
    assert "error_code 0, mode 1, gait_type 0, body_height 0.3" in told[0]
    assert told[0].endswith("taken as ready")
