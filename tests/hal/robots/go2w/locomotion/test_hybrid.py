"""Who drives when, that changes throw nothing, and what the two do together."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hal.lowlevel import LowCommand, LowState
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.climb import DRIVE
from hal.robots.go2w.locomotion.controllers import OURS
from hal.robots.go2w.locomotion.hybrid import (
    ASTRIDE_HEIGHT,
    BLEND_TIME,
    FAST_SPEED,
    OTHER_TIME,
    PUSH_MOST,
    SHAKE_SIGMA,
    TURN_MOST,
    TWIST_HEIGHT,
    HybridController,
    mixed,
)
from hal.robots.go2w.locomotion.params import VmcParams
from hal.robots.go2w.locomotion.rlsar import FRAME_LENGTH, PolicyParams
from hal.robots.go2w.locomotion.torchfile import Layer
from hal.robots.go2w.locomotion.vmc import VmcController
from hal.robots.go2w.locomotion.weights import load_weights, save_weights
from hal.types import PostureCommand, VelocityCommand
from tools.bench.envelope.cliff import creep_to_edge
from tools.bench.envelope.driving import hold_on_slope
from tools.bench.envelope.terrain import CELL_SIDE, course
from tools.bench.envelope.trial import drive
from tools.train.settings import PARAMS


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that keeps its joints where it stands, whatever it sees: it brakes."""
    file = tmp_path_factory.mktemp("policy") / "standing.npz"
    params: PolicyParams = PARAMS
    layer = Layer(
        np.zeros((16, FRAME_LENGTH * len(params.ages)), np.float32), np.zeros(16, np.float32), "Identity"
    )
    save_weights(file, params, [layer], {})
    return file


def on(name: str, friction: float = 0.8) -> Simulation:
    ground = course(name, 0)
    sim = Simulation(ground.height, CELL_SIDE, ground.origin, friction=friction)
    sim.reset(0.0, 0.0, 0.0)
    return sim


def torque(command: LowCommand, state: LowState) -> np.ndarray:
    return command.tau + command.kp * (command.q - state.q) + command.kd * (command.dq - state.dq)


@given(st.integers(0, 2**31), st.floats(0.0, 1.0))
def test_mixed_torques_are_the_share_of_both(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    one, other = (
        LowCommand(
            *rng.normal(size=(3, 16)), *(rng.uniform(0.0, 90.0, (2, 16)) * (rng.random((2, 16)) < 0.7))
        )
        for _ in range(2)
    )
    state = LowState(0.0, *rng.normal(size=(3, 16)), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    out = mixed(one, other, share, LowCommand(*np.zeros((5, 16))))
    wanted = (1.0 - share) * torque(one, state) + share * torque(other, state)
    np.testing.assert_allclose(torque(out, state), wanted, atol=1e-9)


def test_level_ground_is_driven_by_the_model_based_controller_to_the_bit(standing: Path) -> None:
    sims = [on("ramp_up_0"), on("ramp_up_0")]
    hybrid = HybridController(standing)
    drivers = [Driver(sims[0], hybrid), Driver(sims[1], VmcController(VmcParams(climb=0.0)))]
    for tick in range(600):
        for driver in drivers:
            driver.step(*((0.5, 0.3) if tick > 100 else (0.0, 0.0)))
        assert not hybrid.climbing
    assert sims[0].position[0] > 0.6
    np.testing.assert_array_equal(sims[0].data.qpos, sims[1].data.qpos)


@pytest.mark.parametrize(
    ("speed", "yaw"), [(0.5, 0.0), pytest.param(-0.5, np.pi, marks=pytest.mark.campaign)]
)
def test_a_blocked_wheel_calls_the_policy_and_level_ground_sends_it_home(
    standing: Path, speed: float, yaw: float
) -> None:
    sim, hybrid = on("step_up_15"), HybridController(standing)
    sim.reset(0.0, 0.0, yaw)
    driver = Driver(sim, hybrid)
    when = None
    for tick in range(800):
        driver.step(*((speed, 0.0) if tick > 100 else (0.0, 0.0)))
        assert hybrid.wheels._memory["mode"][0] == DRIVE, "it lifts no wheel: the policy climbs"
        if hybrid.climbing and when is None:
            when = tick
            assert 0.2 < sim.position[0] < 0.8, "a wheel is at the face"
            assert "learnt" in hybrid.warning()
    assert when is not None
    assert hybrid.climbing, "this policy stands before the face for ever"
    for _ in range(500):
        driver.step()
    assert not hybrid.climbing
    assert not hybrid.warning()
    assert abs(sim.data.qvel[:2]).max() < 0.02
    assert sim.rotation[2, 2] > 0.98


@pytest.mark.parametrize(("share", "calls"), [(0.02, True), (0.4, False)])
def test_a_wheel_that_stands_while_the_others_spin_calls_the_policy(
    standing: Path, share: float, calls: bool
) -> None:
    # Before a post of 10 cm one wheel stood for 4 s and was pushed by so little that it did not count as blocked.
    hybrid, q, dq = HybridController(standing), np.zeros(16), np.zeros(16)
    q[1:12:3], q[2:12:3] = 0.67, -1.3
    dq[go2w.WHEEL_JOINTS] = 0.5 / go2w.WHEEL_RADIUS
    dq[12] *= share
    for tick in range(round(0.9 / hybrid.period)):
        state = LowState(
            tick * hybrid.period, q, dq, np.zeros(16), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)
        )
        hybrid.step(state, VelocityCommand(0, 0.5), PostureCommand(0))
        assert calls or not hybrid.climbing
    assert hybrid.climbing == calls


def test_who_stands_amid_a_climb_is_held_by_the_policy_until_something_else_is_asked(standing: Path) -> None:
    sim, hybrid = on("step_up_15"), HybridController(standing)
    driver = Driver(sim, hybrid)
    for _ in range(100):
        driver.step()
    while not hybrid.climbing:
        driver.step(0.5)
        assert sim.time < 4.0
    hybrid._calm = -60.0  # as if it stood on uneven ground
    for _ in range(600):
        driver.step()
    assert hybrid.climbing
    place = sim.position.copy()
    for _ in range(200):
        driver.step()
    assert np.abs(sim.position - place).max() < 0.003
    state = sim.low_state()
    hybrid.step(state, VelocityCommand(0), PostureCommand(0, pitch=0.2))
    assert not hybrid.climbing, "the policy knows no posture"


def test_a_policy_that_does_not_get_on_is_asked_for_more_and_shaken_and_one_that_stops_is_not(
    standing: Path,
) -> None:
    sim, hybrid = on("step_up_15"), HybridController(standing)
    driver = Driver(sim, hybrid)
    asked: list[float] = []
    times: list[float] = []
    step = hybrid.climber.step

    def seen(state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        asked.append(velocity.vx)
        times.append(state.time)
        return step(state, velocity, posture)

    hybrid.climber.step = seen  # type: ignore[method-assign]
    for tick in range(900):
        driver.step(0.5 if tick > 100 else 0.0)
    assert hybrid.climber.shake == SHAKE_SIGMA, "this policy brakes for ever"
    assert asked[0] == pytest.approx(0.5, abs=0.01)
    assert 0.75 < asked[-1] <= PUSH_MOST
    told = zip(itertools.pairwise(times), itertools.pairwise(asked), strict=True)
    jumps = [abs(after - before) for (a, b), (before, after) in told if b - a < 1.5 * hybrid.period]
    assert len(jumps) > 300
    assert max(jumps) < 0.01
    hybrid._calm = -60.0
    for _ in range(20):
        driver.step()
    assert hybrid.climber.shake == 0.0
    assert asked[-1] == 0.0


@pytest.mark.parametrize("wz", [-0.3, 1.0])
def test_amid_a_climb_it_turns_no_faster_than_it_learnt(standing: Path, wz: float) -> None:
    sim, hybrid = on("step_up_15"), HybridController(standing)
    driver = Driver(sim, hybrid)
    while not hybrid.climbing:
        driver.step(0.5 if sim.time > 0.5 else 0.0)
        assert sim.time < 4.0
    asked: list[float] = []
    step = hybrid.climber.step

    def seen(state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        asked.append(velocity.wz)
        return step(state, velocity, posture)

    hybrid.climber.step = seen  # type: ignore[method-assign]
    for _ in range(100):
        driver.step(0.5, wz)
    assert asked[-1] == pytest.approx(np.clip(wz, -TURN_MOST, TURN_MOST), abs=1e-3)
    assert max(map(abs, asked)) <= TURN_MOST


def on_wheels(state: LowState, raised: dict[int, float]) -> LowState:
    """`state` level at rest with wheels raised by so much [m]: legs FR, FL, RR, RL."""
    q = state.q.copy()
    for leg, height in raised.items():
        for share in np.linspace(0.0, 1.0, 400):
            q[3 * leg + 1 : 3 * leg + 3] = state.q[3 * leg + 1 : 3 * leg + 3] + share * np.array([0.6, -1.2])
            if go2w.wheel_centres(q)[leg, 2] - go2w.wheel_centres(state.q)[leg, 2] >= height:
                break
        else:
            raise AssertionError("a leg cannot fold so far")
    return LowState(state.time, q, state.dq, state.tau, np.array([1.0, 0, 0, 0]), np.zeros(3), state.accel)


@pytest.mark.parametrize(
    ("raised", "twisted"),
    [
        ({0: 1.2 * TWIST_HEIGHT}, True),
        ({3: 1.2 * TWIST_HEIGHT}, True),
        ({0: 0.7 * TWIST_HEIGHT, 3: 0.7 * TWIST_HEIGHT}, True),
        ({0: 0.8 * TWIST_HEIGHT}, False),
        ({0: 1.2 * TWIST_HEIGHT, 1: 1.2 * TWIST_HEIGHT}, False),
        ({1: 1.2 * TWIST_HEIGHT, 3: 1.2 * TWIST_HEIGHT}, False),
        ({}, False),
    ],
    ids=["front", "rear", "diagonal", "little", "ramp", "side slope", "level"],
)
def test_where_one_wheel_is_off_the_plane_of_the_others_only_the_policy_drives(
    standing: Path, raised: dict[int, float], twisted: bool
) -> None:
    sim = on("ramp_up_0")
    driver = Driver(sim, VmcController())
    for _ in range(200):
        driver.step()
    rest = sim.low_state()
    state = on_wheels(rest, raised)
    astride, nearly = on_wheels(rest, {0: 1.1 * ASTRIDE_HEIGHT}), on_wheels(rest, {0: 0.8 * ASTRIDE_HEIGHT})
    for vx, wz in ((0.1, 0.0), (-0.2, 0.3), (0.0, 0.5), (0.5, 0.0)):
        hybrid = HybridController(standing)
        for _ in range(50):
            hybrid.step(state, VelocityCommand(0), PostureCommand(0))
        assert not hybrid.climbing, "who stands goes on standing"
        hybrid.step(state, VelocityCommand(0, vx, 0.0, wz), PostureCommand(0))
        assert hybrid.climbing == twisted
        if not twisted:
            continue
        for _ in range(round(2.0 * OTHER_TIME / hybrid.period)):
            hybrid.step(state, VelocityCommand(0, 0.0, 0.0, 0.5), PostureCommand(0))
        assert hybrid.climbing, "not even a turn on the spot is handed back"
        for apart, kept in ((astride, True), (nearly, False)):
            for _ in range(round(2.0 * OTHER_TIME / hybrid.period)):
                hybrid.step(apart, VelocityCommand(0, 0.0, 0.0, 0.5), PostureCommand(0))
            assert hybrid.climbing == kept


def test_the_next_climb_begins_without_the_push_of_the_last(standing: Path) -> None:
    sim, hybrid = on("step_up_15"), HybridController(standing)
    driver = Driver(sim, hybrid)
    hybrid._push = 0.4
    for _ in range(450):
        driver.step()
    assert hybrid._push == 0.0


@pytest.mark.parametrize(
    ("speed", "yaw"),
    [(FAST_SPEED - 0.05, 0.0), pytest.param(0.05 - FAST_SPEED, np.pi, marks=pytest.mark.campaign)],
)
def test_slow_it_lifts_wheels_itself(standing: Path, speed: float, yaw: float) -> None:
    sim, hybrid = on("step_up_5"), HybridController(standing)
    sim.reset(0.0, 0.0, yaw)
    driver = Driver(sim, hybrid)
    for tick in range(2400):
        driver.step(speed if tick > 100 else 0.0)
        assert not hybrid.climbing
        if sim.position[0] > 1.6:
            break
    assert sim.position[0] > 1.6, "up 5 cm"


def test_a_change_of_controllers_changes_the_torques_slowly(standing: Path) -> None:
    sim, hybrid = on("step_up_15"), HybridController(standing)
    driver = Driver(sim, hybrid)
    last, shares, jumps = None, [], []
    step = hybrid.step

    def watched(state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        nonlocal last
        command = step(state, velocity, posture)
        if last is not None:
            jumps.append(np.abs(torque(command, state) - torque(last, state)).max())
            shares.append(hybrid._share)
        last = LowCommand(
            *(np.array(v) for v in (command.q, command.dq, command.tau, command.kp, command.kd))
        )
        return command

    hybrid.step = watched  # type: ignore[method-assign]
    for tick in range(1000):
        driver.step(*((0.5, 0.0) if 100 < tick < 600 else (0.0, 0.0)))
    changing = (np.array(shares) > 0.0) & (np.array(shares) < 1.0)
    assert changing.sum() >= 2 * BLEND_TIME / 0.005 - 4, "there and back"
    assert max(np.array(jumps)[changing]) < 4.5, "Nm from tick to tick; the motors give 23.7"


@pytest.mark.parametrize("name", ["step_up_25", "stairs_up_15"])
def test_with_our_policy_it_climbs_what_the_model_based_one_does_not(name: str) -> None:
    hybrid = HybridController(OURS)
    assert drive(hybrid, name, 1).passed


@pytest.mark.parametrize(
    ("angle", "friction"), [(0.0, 0.6), pytest.param(0.7, 1.0, marks=pytest.mark.campaign)]
)
def test_creeping_it_feels_edges_as_the_model_based_controller_does(angle: float, friction: float) -> None:
    hybrid = HybridController(OURS)
    assert creep_to_edge(hybrid, 0.1, angle, friction)
    assert not hybrid.climbing


@pytest.mark.parametrize("seconds", [8.0, pytest.param(30.0, marks=pytest.mark.campaign)])
def test_with_our_policy_it_still_stands_still(seconds: float) -> None:
    assert hold_on_slope(HybridController(OURS), seconds=seconds) < 0.01


def test_our_policy_is_small_and_tells_how_it_was_made() -> None:
    assert OURS.stat().st_size < 300_000
    _, _, facts = load_weights(OURS)
    assert facts["trained"]["million_steps"] > 10
    assert "envelope.hybrid.step_up_25" in facts["envelope"]
