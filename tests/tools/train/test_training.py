"""The trainer without its learner: ground, what robots see and are paid, labels of the teacher, checkpoints."""

from pathlib import Path

import numpy as np
import pytest

from hal.lowlevel import LowCommand, LowState
from hal.mujoco.attitude import FILTER_GAIN, AttitudeFilter
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.hybrid import ONWARD_SPEED, TURN_MOST
from hal.robots.go2w.locomotion.layout import Layout
from hal.robots.go2w.locomotion.policy import PolicyController
from hal.robots.go2w.locomotion.rlsar import FRAME_LENGTH
from hal.robots.go2w.locomotion.torchfile import Layer
from hal.robots.go2w.locomotion.weights import save_weights
from hal.rotation import rotation as matrix_of
from hal.rotation import up_of
from hal.types import PostureCommand, VelocityCommand
from tools.train import teacher
from tools.train.checkpoint import Checkpoint
from tools.train.environment import (
    DETOUR_EVERY,
    DETOUR_TIME,
    KNOWN_COUNT,
    SEEN,
    Body,
    Environment,
    felt,
    in_body,
    rewards,
)
from tools.train.settings import DESCRIPTION, PARAMS, PERIOD, Physics, Settings
from tools.train.terrain import CELL_SIDE, KINDS, LEVEL_COUNT, OPEN, Ground, lane


@pytest.fixture(scope="module")
def env() -> Environment:
    settings = Settings(physics=Physics(models=2))
    return Environment(settings, 14, np.random.default_rng(3))


@pytest.mark.parametrize("kind", KINDS)
def test_lanes_grow_harder_and_begin_level(kind: str) -> None:
    lanes = [lane(kind, level) for level in range(LEVEL_COUNT)]
    spans = [float(np.ptp(z)) for z in lanes]
    assert spans[0] < spans[4] < spans[9]
    assert not any(z[:, : round(2.0 / CELL_SIDE)].any() for z in lanes)
    np.testing.assert_array_equal(lanes[7], lane(kind, 7))


def test_the_ground_knows_the_middle_of_each_lane() -> None:
    ground = Ground.build()
    steps = np.array([KINDS.index("steps")] * 2)
    y = ground.middle(steps, np.array([0, 9]))
    # The first tread begins at x = 1.0 and is 1.2 m long; level 0 is 4 cm, level 9 is 27.4 cm high.
    np.testing.assert_allclose(ground.at(np.full(2, 1.5), y), [0.04, 0.274], atol=1e-6)
    assert ground.at(np.array([5.0]), ground.middle(np.array([OPEN]), np.zeros(1, int)))[0] == 0.0


def test_a_frame_is_what_the_controller_sees(env: Environment, tmp_path: Path) -> None:
    """The observation in training, noise aside, is the one that the controller on the robot makes of the same state."""
    weights = np.zeros((16, SEEN), np.float32)
    save_weights(tmp_path / "p.npz", PARAMS, [Layer(weights, np.zeros(16, np.float32), "Identity")], {})
    controller = PolicyController(tmp_path / "p.npz")
    quiet = Settings(physics=Physics(models=1, noise={"gyro": 0.0, "up": 0.0, "dq": 0.0}))
    one = Environment(quiet, 5, np.random.default_rng(1))
    seen, known = one.observe()
    assert (seen.shape, known.shape) == ((5, SEEN), (5, KNOWN_COUNT))
    s, r = one.robots.state[0], one.robots
    state = LowState(0.0, s[1:24][r.qadr], s[24:46][r.vadr], np.zeros(16), s[4:8], s[27:30], np.zeros(3))
    vx, vy, wz = one.command[0].tolist()
    controller.step(state, VelocityCommand(0, vx, vy, wz), PostureCommand(0))
    np.testing.assert_allclose(seen[0, :FRAME_LENGTH], controller._frames[0], atol=1e-5)
    np.testing.assert_array_equal(seen[0, FRAME_LENGTH : 2 * FRAME_LENGTH], seen[0, :FRAME_LENGTH])


def test_robots_stand_and_are_paid_for_it(env: Environment) -> None:
    env.command[:] = 0.0
    total = np.zeros(14)
    for _ in range(5):
        reward, fault, _ = env.step(np.zeros((14, 16), np.float32))
        total += reward
        assert not fault.any()
        env.observe()
    assert np.isfinite(total).all()
    assert (env.body().up[:, 2] > 0.9).all()


def test_robots_may_begin_rolling(env: Environment) -> None:
    open_ground = np.flatnonzero(env.kind == OPEN)
    n = len(open_ground)
    robots, yaw, speed = env.robots, np.full(n, 0.5 * np.pi), np.full(n, 0.6)
    middle = robots.ground.middle(env.kind[open_ground], env.level[open_ground])
    robots.place(open_ground, np.full(n, 5.0), middle, yaw, speed)
    wheels = np.ix_(open_ground, 24 + robots.vadr[12:])
    placed = robots.state[wheels]
    rolls = np.zeros((14, 16), np.float32)
    rolls[open_ground, 12:] = 0.6 / go2w.WHEEL_RADIUS / env.layout.scale[12:]
    for _ in range(10):
        assert not robots.step(rolls)[open_ground].any()
    ahead = robots.state[open_ground, 2] - middle
    assert (np.abs(ahead - 0.2 * 0.6) < 0.06).all(), "0.6 m/s along the heading for 0.2 s"
    np.testing.assert_allclose(robots.state[wheels], placed, rtol=0.3)
    robots.place(
        np.arange(14), np.zeros(14), robots.ground.middle(env.kind, env.level), np.zeros(14), np.zeros(14)
    )


def test_robots_in_lanes_are_told_to_slow_down_to_turn_aside_and_to_stand() -> None:
    one = Environment(Settings(physics=Physics(models=2)), 14, np.random.default_rng(5))
    lanes = one.kind != OPEN
    begun = one.command[lanes, 0].copy()
    told, cruise = [], []
    for _ in range(round(2.0 * DETOUR_EVERY / PERIOD)):
        one._change_commands()
        one.observe()
        told.append(one.command[lanes].copy())
        cruise.append(one.command[lanes, 0] == begun)
    vx, wz, on_way = np.array(told)[:, :, 0], np.array(told)[:, :, 2], np.array(cruise)
    assert ((vx * np.sign(begun) >= 0.0) & (np.abs(vx) <= np.abs(begun) + 1e-9)).all(), (
        "never faster, never back"
    )
    assert (np.abs(vx[vx != 0.0]) >= ONWARD_SPEED).all()
    assert (wz[vx == 0.0] == 0.0).all(), "who stands does not turn"
    assert (np.abs(wz) <= TURN_MOST + 1e-9).all()
    assert (np.ptp(wz, axis=0) > 0.2).any(), "they are where they began, and told to turn"
    # A detour takes a second of four on average.
    share = 1.0 - on_way.mean()
    expected = np.mean(DETOUR_TIME) / (np.mean(DETOUR_TIME) + DETOUR_EVERY)
    assert 0.3 * expected < share < 2.0 * expected
    assert (on_way[-1] & ~on_way.all(axis=0)).any(), "it ends by itself"


def body(**changes: np.ndarray) -> Body:
    values = {
        "yaw": np.zeros(1), "velocity": np.zeros((1, 3)), "spin": np.zeros((1, 3)), "up": np.array([[0.0, 0.0, 1.0]]),
        "q": np.tile(Layout(DESCRIPTION).default, (1, 1)), "dq": np.zeros((1, 16)),
        "torque": np.zeros((1, 16)), "above": np.array([0.4]),
    }  # fmt: skip
    return Body(**(values | changes))


def test_rewards_of_one_robot_by_hand() -> None:
    layout, rest = Layout(DESCRIPTION), np.zeros((1, 16), np.float32)
    command = np.array([[0.5, 0.0, 0.3]])
    driving = body(
        velocity=np.array([[0.4, 0.1, 0.2]]), spin=np.array([[0.1, 0.2, 0.0]]), above=np.array([0.2])
    )
    terms = {k: float(v[0]) for k, v in rewards(driving, command, rest + 0.5, rest, layout).items()}
    assert terms["velocity"] == pytest.approx(np.exp(-0.2))
    assert terms["progress"] == pytest.approx(0.8)
    assert terms["turning"] == pytest.approx(np.exp(-0.6))
    assert (terms["bounce"], terms["sway"]) == pytest.approx((0.04, 0.05))
    assert terms["jerk"] == pytest.approx(4.0)
    assert terms["low"] == pytest.approx(0.05)
    assert terms["creep"] == 0.0
    rolling = body(dq=np.array([[0.0] * 12 + [2.0] * 4]))
    assert rewards(rolling, np.zeros((1, 3)), rest, rest, layout)["creep"][0] == 4.0


def test_a_fallen_robot_ends_and_goes_down_a_level(env: Environment) -> None:
    robot = int(np.flatnonzero(env.kind == 0)[0])
    env.level[robot] = 3
    env.robots.state[robot, 4:8] = np.cos(0.75), np.sin(0.75), 0.0, 0.0  # 86 deg of roll
    reward, fault, over = env.step(np.zeros((14, 16), np.float32))
    assert fault[robot]
    assert not over[robot]
    assert reward[robot] < -1.0
    assert env.level[robot] == 2
    assert env.body().up[robot, 2] > 0.9, "it stands again"
    env.observe()


def test_a_label_gives_the_teachers_torque() -> None:
    layout, rng = Layout(DESCRIPTION), np.random.default_rng(0)
    state = LowState(
        0.0,
        layout.default + rng.normal(0, 0.05, 16),
        rng.normal(0, 0.5, 16),
        np.zeros(16),
        np.array([1.0, 0, 0, 0]),
        np.zeros(3),
        np.zeros(3),
    )
    command = LowCommand(
        layout.default, np.zeros(16), rng.normal(0, 3.0, 16), np.full(16, 20.0), np.full(16, 1.0)
    )
    output = teacher.as_output(layout, state, command)
    q, dq = layout.targets(output)
    wanted = command.tau + command.kp * (command.q - state.q) + command.kd * (command.dq - state.dq)
    np.testing.assert_allclose(
        layout.kp * (q - state.q) + layout.kd * (dq - state.dq),
        np.clip(wanted, -go2w.TORQUE_LIMIT, go2w.TORQUE_LIMIT),
        atol=1e-4,
    )


def test_frames_before_the_start_are_the_first() -> None:
    frames = np.arange(20 * FRAME_LENGTH, dtype=np.float32).reshape(20, FRAME_LENGTH)
    stacked = teacher.stacked(frames)
    assert stacked.shape == (20, SEEN)
    np.testing.assert_array_equal(stacked[15], np.concatenate([frames[15 - age] for age in PARAMS.ages]))
    np.testing.assert_array_equal(stacked[3, -FRAME_LENGTH:], frames[0])


def test_a_checkpoint_comes_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    net = [
        (rng.normal(size=(4, 3)).astype(np.float32), np.zeros(3, np.float32)),
        (np.ones((3, 2), np.float32), np.ones(2, np.float32)),
    ]
    point = Checkpoint(
        Settings(seed=4),
        net,
        net,
        np.zeros(16, np.float32),
        np.ones(4, np.float32),
        np.ones(4, np.float32),
        np.arange(5),
        7,
        900,
        3.5,
        1e-4,
    )
    point.save(tmp_path)
    back = Checkpoint.load(tmp_path)
    assert (back.settings, back.iteration, back.steps, back.seconds, back.rate) == (
        point.settings,
        7,
        900,
        3.5,
        1e-4,
    )
    np.testing.assert_array_equal(back.policy[0][0], net[0][0])
    np.testing.assert_allclose(back.critic[0][0], net[0][0], atol=2e-3)
    np.testing.assert_array_equal(back.level, np.arange(5))
    assert [f.name for f in tmp_path.iterdir()] == ["checkpoint.npz"]


def test_training_knows_the_errors_of_the_attitude_that_the_robot_reads() -> None:
    """One accelerometer reading away from rest, of a robot that is turned any way: the IMU's filter moves as far."""
    rng = np.random.default_rng(8)
    quaternion = rng.normal(size=(20, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    acceleration = rng.uniform(-3.0, 3.0, (20, 3))
    told = in_body(quaternion, FILTER_GAIN * 0.02 * felt(acceleration))
    for q, a, moved in zip(quaternion, acceleration, told, strict=True):
        rotation = matrix_of(q[[1, 2, 3, 0]])
        low = LowState(0.0, *np.zeros((3, 16)), q.copy(), np.zeros(3), rotation.T @ [0.0, 0.0, 9.81])
        imu = AttitudeFilter()
        imu.measure(low)
        low.time, low.accel = 0.02, rotation.T @ (a + np.array([0.0, 0.0, 9.81]))
        imu.measure(low)
        np.testing.assert_allclose(np.array(up_of(low.quaternion)) - up_of(q), moved, atol=1e-4)
        assert 1e-4 < np.linalg.norm(moved) < 0.01


def test_a_run_goes_on_with_another_number_of_robots(env: Environment) -> None:
    more = Environment(env.settings, 40, np.random.default_rng(5))
    level = np.where(env.kind == OPEN, 0, 3 + env.kind)
    more.resume(level)
    np.testing.assert_array_equal(more.level[more.kind != OPEN], 3 + more.kind[more.kind != OPEN])
