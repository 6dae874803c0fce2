"""The virtual model controller: statics against plain numpy, and short drives in simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hal.lowlevel import LowState
from hal.mujoco.sim import Simulation
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.climb import DRIVE
from hal.robots.go2w.locomotion.contact import turn_share
from hal.robots.go2w.locomotion.geometry import (
    contact_geometry,
    distribute,
    fit_plane,
    leg_weight,
    level_frame,
)
from hal.robots.go2w.locomotion.memory import MEMORY
from hal.robots.go2w.locomotion.params import VmcParams
from hal.robots.go2w.locomotion.traction import limit_traction
from hal.robots.go2w.locomotion.vmc import VmcController
from hal.rotation import wrap
from hal.types import PostureCommand, VelocityCommand
from hal.wheel_force import inverse3
from tools.bench.envelope.cliff import creep_to_edge
from tools.bench.envelope.driving import stopping_time
from tools.bench.envelope.trial import Conditions, drive
from tools.bench.envelope.turning import CURVE_COMMANDS, CURVING_TIME, turn_on_bar, turn_on_ramp


def campaign(*values: float | str) -> Any:
    """Another case of the same, for long runs."""
    return pytest.param(*values, marks=pytest.mark.campaign)


def _simulation(slope: float = 0.0) -> Simulation:
    x = np.arange(300) * 0.02 - 2.0
    height = np.broadcast_to(np.tan(slope) * x, (150, 300)).astype(np.float32)
    return Simulation(height, 0.02, (-2.0, -1.5))


def _run(sim: Simulation, controller: VmcController, vx: float, wz: float, seconds: float) -> None:
    for _ in range(round(seconds / sim.timestep)):
        sim.apply(controller.step(sim.low_state(), VelocityCommand(0, vx, 0.0, wz), PostureCommand(0)))
        sim.step()


def test_level_frame_removes_heading_and_keeps_up() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        w, x, y, z = quaternion
        up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        rot = level_frame(quaternion)
        np.testing.assert_allclose(rot @ rot.T, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(rot @ up, [0, 0, 1], atol=1e-9)
        assert rot[1, 0] == 0.0  # the trunk's x axis has no sideways part: no heading


def test_inverse3_matches_numpy() -> None:
    a = np.random.default_rng(2).normal(size=(3, 3))
    np.testing.assert_allclose(inverse3(a), np.linalg.inv(a), rtol=1e-9)


def test_leg_weight_matches_the_simulator_s_model() -> None:
    sim = _simulation()
    q = go2w.STAND + np.random.default_rng(3).normal(0.0, 0.2, 16)
    sim.reset(q=go2w.STAND)
    import mujoco

    data = mujoco.MjData(sim.model)
    for name, value in zip(go2w.MOTORS, q, strict=True):
        data.qpos[sim.model.joint(name).qposadr[0]] = value
    data.qpos[3:7] = np.array([0.98, 0.1, 0.15, 0.0]) / np.linalg.norm([0.98, 0.1, 0.15, 0.0])
    mujoco.mj_forward(sim.model, data)
    torque, com = leg_weight(q, level_frame(data.qpos[3:7]))
    bias = np.array([data.qfrc_bias[sim.model.joint(name).dofadr[0]] for name in go2w.MOTORS[:12]])
    np.testing.assert_allclose(
        torque.ravel(), bias, atol=0.1
    )  # the links' small sideways offsets are left out
    assert com[2] == pytest.approx(data.subtree_com[0][2] - data.qpos[2], abs=2e-3)


def test_plane_through_the_wheels_matches_weighted_least_squares() -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        points = rng.normal([0.0, 0.0, -0.4], [0.2, 0.2, 0.03], (4, 3))
        weight = rng.uniform(0.05, 1.0, 4)
        mean = weight @ points / weight.sum()
        rel = points - mean
        normal = rel[:, :2].T @ (weight[:, None] * rel[:, :2]) + 1e-4 * np.eye(2)  # the damping
        slope = np.linalg.solve(normal, rel[:, :2].T @ (weight * rel[:, 2]))
        expected = (mean[2] - slope @ mean[:2], *slope)
        np.testing.assert_allclose(fit_plane(points, weight), expected, atol=1e-9)


def test_contact_points_lie_on_the_tread_and_move_as_their_jacobians_say() -> None:
    rng = np.random.default_rng(8)
    rot = level_frame(np.array([0.99, 0.06, -0.08, 0.0]) / np.linalg.norm([0.99, 0.06, -0.08]))
    slope = np.array([0.2, -0.1])
    q = go2w.STAND + rng.normal(0.0, 0.1, 16)

    def at(joints: np.ndarray) -> tuple[np.ndarray, ...]:
        centres = go2w.wheel_centres(joints) @ rot.T
        jac = np.array([rot @ j for j in go2w.wheel_jacobians(joints)])
        return centres, *contact_geometry(joints, rot, centres, jac, *slope)

    centres, points, jacobians, forward, axles = at(q)
    np.testing.assert_allclose(np.linalg.norm(points - centres, axis=1), go2w.WHEEL_RADIUS, atol=1e-9)
    normal = np.array([*-slope, 1.0]) / np.sqrt(1.0 + slope @ slope)
    for leg in range(4):
        # The lowest point of the wheel's disc above the plane: no other point of its rim lies lower along the normal.
        u, v = np.linalg.svd(axles[leg].reshape(1, 3))[2][1:]
        angle = np.linspace(0.0, 2 * np.pi, 3600)
        rim = centres[leg] + go2w.WHEEL_RADIUS * (np.outer(np.cos(angle), u) + np.outer(np.sin(angle), v))
        assert points[leg] @ normal == pytest.approx((rim @ normal).min(), abs=1e-6)
        assert forward[leg] @ normal == pytest.approx(0.0, abs=1e-9)
        # Wheels locked: the material point of the tread moves with the calf.
        for joint in range(3):
            turn = rot[:, 0] if joint == 0 else axles[leg]
            moved = q.copy()
            moved[3 * leg + joint] += 1e-6
            velocity = (at(moved)[0][leg] - centres[leg]) / 1e-6 + np.cross(turn, points[leg] - centres[leg])
            np.testing.assert_allclose(jacobians[leg][:, joint], velocity, atol=1e-4)


def test_contact_forces_are_those_the_simulator_s_ground_exerts() -> None:
    sim, controller = _simulation(), VmcController()
    sim.reset(x=0.5)
    _run(sim, controller, 0.0, 0.0, 2.0)
    force = controller._memory["force"][0]
    # A quasi-static estimate: 8 percent of the weight is as good as it is at rest.
    assert force[:, 2].sum() == pytest.approx(go2w.ROBOT_MASS * 9.81, rel=0.08)
    assert np.abs(force[:, :2].sum(axis=0)).max() < 6.0
    assert (controller._memory["contact"][0] == 1).all()


def test_distribution_meets_the_wrench_and_the_bounds() -> None:
    points = np.array([[0.2, -0.19, -0.4], [0.2, 0.19, -0.4], [-0.2, -0.19, -0.4], [-0.2, 0.19, -0.4]])
    force = np.full(4, 40.0)
    distribute(points, np.zeros(3), np.array([190.0, 8.0, -6.0]), np.zeros(4), np.full(4, 170.0), force, 200)
    assert force.sum() == pytest.approx(190.0, abs=2.0)
    assert points[:, 1] @ force == pytest.approx(8.0, abs=0.5)
    assert -points[:, 0] @ force == pytest.approx(-6.0, abs=0.5)
    upper = np.array([0.0, 170.0, 170.0, 170.0])
    distribute(points, np.zeros(3), np.array([190.0, 0.0, 0.0]), np.zeros(4), upper, force, 200)
    assert force[0] == 0.0  # a lifted wheel carries nothing
    assert (force >= 0.0).all()


@pytest.mark.parametrize("vx", [0.5, -0.4])
def test_drives_straight_at_the_commanded_speed(vx: float) -> None:
    sim, controller = _simulation(), VmcController()
    sim.reset(x=1.0)
    _run(sim, controller, vx, 0.0, 1.5)
    start = sim.position
    _run(sim, controller, vx, 0.0, 1.0)
    moved = sim.position - start
    assert moved[0] == pytest.approx(vx, rel=0.08)
    assert abs(moved[1]) < 0.02
    assert controller.ground_speed() == pytest.approx(vx, rel=0.1)


@pytest.mark.parametrize("period", [0.002, 0.010])
def test_any_control_period_from_100_to_500_hz_will_do(period: float) -> None:
    x = np.arange(300) * 0.02 - 2.0
    height = np.broadcast_to(0.2 * np.maximum(x, 0.0), (150, 300)).astype(np.float32)
    sim = Simulation(height, 0.02, (-2.0, -1.5), timestep=period)
    controller = VmcController(period=period)
    sim.reset(x=-1.0)
    _run(sim, controller, 0.5, 0.0, 4.0)
    assert sim.position[0] == pytest.approx(0.75, abs=0.2)  # a ramp of 11 degrees on the way
    assert sim.rotation[2, 2] > 0.98
    _run(sim, controller, 0.0, 0.5, 2.0)
    assert sim.yaw > 0.6


def test_limited_traction_stays_in_the_cone_and_goes_to_the_same_side() -> None:
    rng = np.random.default_rng(6)
    for _ in range(200):
        wanted = rng.normal(0.0, 4.0, 4)
        grip = rng.uniform(0.0, 5.0, 4)
        torque = wanted.copy()
        limit_traction(torque, grip)
        assert (np.abs(torque) <= grip + 1e-12).all()
        for front, rear in ((0, 2), (1, 3)):
            room = grip[front] + grip[rear]
            side = np.clip(wanted[front] + wanted[rear], -room, room)
            assert torque[front] + torque[rear] == pytest.approx(side, abs=1e-9)
        if (np.abs(wanted) <= grip).all():
            np.testing.assert_allclose(torque, wanted, atol=1e-12)


def test_a_slipping_wheel_s_friction_is_learnt_and_bounds_it() -> None:
    sim, controller = _simulation(slope=0.2), VmcController()
    sim.reset(x=0.0)
    slippery = sim.model.geom("FR_wheel").id
    sim.model.geom_friction[slippery, 0] = 0.15
    least = np.ones(4)
    for _ in range(20):
        _run(sim, controller, 0.4, 0.0, 0.1)
        least = np.minimum(least, controller._memory["friction"][0])
    assert least[0] < 0.7
    assert (least[1:] > 0.9).all()
    assert sim.position[0] > 0.4  # the other three take it up
    memory = controller._memory[0]
    normal = np.array([-memory["slope_x"], -memory["slope_y"], 1.0])
    load = memory["force"] @ (normal / np.linalg.norm(normal))
    assert (memory["grip"] <= 1.3 * memory["friction"] * load * go2w.WHEEL_RADIUS + 0.3).all()


@pytest.mark.parametrize(("course", "run"), [("step_up_5", 0), campaign("step_up_10", 1)])
def test_steps_are_climbed_slowly_too(course: str, run: int) -> None:
    # The wheels of one side spun while the turn integral starved those of the other: nothing looked blocked.
    assert drive(VmcController(), course, run, Conditions(speed=0.15)).passed


def test_a_slow_curve_is_no_step_and_a_stop_after_it_stands() -> None:
    for speed, rate in ((0.12, 0.04), (0.15, -0.08), (0.3, 0.1)):
        sim, controller = _simulation(), VmcController()
        sim.reset()
        for _ in range(40):
            _run(sim, controller, speed, rate, 0.1)
            assert controller._memory["mode"][0] == DRIVE
        before = sim.position
        _run(sim, controller, 0.0, 0.0, 0.5)
        stopped = sim.position
        assert np.linalg.norm(stopped - before) < 0.025
        _run(sim, controller, 0.0, 0.0, 0.5)
        assert np.linalg.norm(sim.position - stopped) < 0.003


def test_a_hill_too_slippery_to_climb_is_not_a_step() -> None:
    x = np.arange(300) * 0.02 - 2.0
    height = np.broadcast_to(np.tan(np.radians(20.0)) * np.maximum(x, 0.0), (150, 300)).astype(np.float32)
    sim, controller = Simulation(height, 0.02, (-2.0, -1.5), friction=0.3), VmcController()
    sim.reset(x=-0.6)
    for _ in range(60):
        _run(sim, controller, 0.4, 0.0, 0.1)
        assert controller._memory["mode"][0] == DRIVE
        assert sim.rotation[2, 2] > 0.8


def test_turns_in_place_at_the_commanded_rate() -> None:
    sim, controller = _simulation(), VmcController()
    sim.reset()
    _run(sim, controller, 0.0, 0.6, 2.0)
    before = sim.yaw
    _run(sim, controller, 0.0, 0.6, 2.0)
    assert wrap(sim.yaw - before) == pytest.approx(1.2, rel=0.08)


def test_a_turn_waits_for_a_wheel_that_is_held_or_dragged_away() -> None:
    params = VmcParams()
    rng = np.random.default_rng(4)
    shares = []
    for _ in range(200):
        memory = np.zeros(1, MEMORY)
        memory["slope_x"], memory["slope_y"] = slope = rng.uniform(-0.3, 0.3, 2)
        memory["force"] = force = rng.normal([0.0, 0.0, 50.0], 30.0, (4, 3))
        memory["lag"] = lag = rng.normal(0.0, 0.03, (4, 2)) + rng.normal(0.0, 0.1, 2)
        for _ in range(200):  # until the filters have settled
            share = turn_share(memory[0], 0.005, params)
        normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1.0 + slope @ slope)
        load = force @ normal
        along = np.linalg.norm(force - load[:, None] * normal, axis=1)
        jam = max(0.0, (along - np.maximum(load, 0.0)).max())
        strain = np.linalg.norm(lag - lag.mean(axis=0), axis=1).max()
        held = max(jam / params.turn_jam, (strain / params.turn_strain - 0.6) / 0.4)
        assert share == pytest.approx(1.0 - np.clip(held, 0.0, 1.0), abs=1e-6)
        shares.append(share)
    assert min(shares) == 0.0
    assert max(shares) == 1.0
    assert any(0.1 < share < 0.9 for share in shares)


@pytest.mark.parametrize(
    ("height", "at", "angle"), [(0.04, 0.0, 0.0), campaign(0.08, -0.2, 0.0), campaign(0.08, 0.0, 1.3)]
)
def test_turning_astride_a_bar_does_not_tip_it(height: float, at: float, angle: float) -> None:
    tipped, turned = turn_on_bar(VmcController(), height, at, angle, 1)
    assert tipped == ""
    assert turned > np.radians(45.0 if height < 0.05 else 10.0)


@pytest.mark.parametrize(("at", "angle"), [campaign(0.0, 0.785), (0.0, 1.3), campaign(-0.2, 0.0)])
def test_driving_off_a_bar_in_a_curve_does_not_tip_it(at: float, angle: float) -> None:
    for off in CURVE_COMMANDS:
        assert turn_on_bar(VmcController(), 0.05, at, angle, -1, turning=CURVING_TIME, off=off)[0] == ""


def test_no_wheel_is_lifted_while_the_trunk_tips() -> None:
    # A bar of 5 cm met at a glancing angle on grippy ground: the weight shift for the lift tipped the robot.
    assert turn_on_bar(VmcController(), 0.05, 0.0, 1.3, 1, friction=1.0, turning=0.0)[0] != "arriving"


def test_what_a_turn_leaves_in_the_legs_is_no_block() -> None:
    for turn, after in ((0.8, 0.2), (-0.8, 0.4)):
        sim, controller = _simulation(0.0), VmcController()
        sim.reset()
        _run(sim, controller, 0.0, turn, 2.0)
        _run(sim, controller, 0.45, after, 1.0)
        start = sim.position
        _run(sim, controller, 0.45, after, 1.0)
        assert np.linalg.norm(sim.position - start) > 0.3


def test_turns_on_a_ramp() -> None:
    assert turn_on_ramp(VmcController(), 10.0, 1) > 0.6


def test_holds_its_place_level_on_a_slope() -> None:
    sim, controller = _simulation(np.radians(15.0)), VmcController()
    sim.reset()
    _run(sim, controller, 0.0, 0.0, 2.0)
    start = sim.position
    _run(sim, controller, 0.0, 0.0, 3.0)
    assert np.linalg.norm(sim.position - start) < 0.005
    pitch = -np.arcsin(sim.rotation[2, 0])
    assert abs(pitch) < 0.12  # the ground is at 0.26 rad


@pytest.mark.parametrize(
    ("speed", "yaw_rate", "degrees", "friction", "limit"),
    [
        campaign(0.5, 0.0, 0.0, 0.8, 0.20),
        (0.8, 0.0, 0.0, 0.6, 0.25),
        (0.5, 0.8, 0.0, 0.8, 0.28),
        (0.5, 0.0, 15.0, 0.8, 0.22),
        campaign(-0.5, 0.0, 0.0, 0.4, 0.25),
    ],
)
def test_a_zero_command_brings_it_to_rest_at_once_and_for_good(
    speed: float, yaw_rate: float, degrees: float, friction: float, limit: float
) -> None:
    assert 0.05 < stopping_time(VmcController(), speed, yaw_rate, degrees, friction) < limit


def test_contacts_are_those_of_the_simulator() -> None:
    sim, controller = _simulation(), VmcController()
    sim.reset()
    _run(sim, controller, 0.0, 0.0, 1.0)
    assert controller.contacts() == (True, True, True, True)
    assert set(sim.contacts().bodies) == {f"{leg}_wheel" for leg in go2w.LEGS}
    state = sim.low_state()
    state.tau = np.zeros(16)
    for _ in range(100):
        state = LowState(
            state.time, go2w.STAND, np.zeros(16), np.zeros(16), np.array([1.0, 0, 0, 0]), *[np.zeros(3)] * 2
        )
        weight, _ = leg_weight(state.q, np.eye(3))
        state.tau[:12] = weight.ravel()
        controller.step(state, VelocityCommand(0), PostureCommand(0))
    assert controller.contacts() == (False, False, False, False)


def test_same_input_gives_the_same_command_after_reset() -> None:
    sim, controller = _simulation(), VmcController()
    sim.reset()
    state = sim.low_state()
    outputs = []
    for _ in range(2):
        controller.reset()
        for _ in range(20):
            low = controller.step(state, VelocityCommand(0, 0.5, 0.0, 0.2), PostureCommand(0))
        outputs.append(np.concatenate([low.q, low.dq, low.tau, low.kp, low.kd]))
    np.testing.assert_array_equal(outputs[0], outputs[1])
    assert np.isfinite(outputs[0]).all()


@pytest.mark.parametrize(
    ("course", "run"), [("step_up_10", 0), campaign("ramp_up_20", 1), ("step_down_15", 1)]
)
def test_masters_the_course(course: str, run: int) -> None:
    assert drive(VmcController(), course, run).reason == "passed"


@pytest.mark.parametrize(
    ("speed", "angle", "friction"),
    [campaign(0.1, 0.0, 0.6), campaign(0.06, 0.0, 0.4), campaign(0.1, 0.7, 1.0), (-0.1, 0.3, 0.8)],
)
def test_creeping_it_stops_at_a_cliff(speed: float, angle: float, friction: float) -> None:
    controller = VmcController()
    assert creep_to_edge(controller, speed, angle, friction)
    assert controller.warning() == "", "it drove away"
    assert not creep_to_edge(VmcController(VmcParams(creep=0.0)), speed, angle, friction), (
        "without it, it falls"
    )


@pytest.mark.parametrize(("course", "speed"), [campaign("ramp_down_15", 0.1), ("step_down_10", 0.15)])
def test_what_is_no_cliff_does_not_stop_it(course: str, speed: float) -> None:
    controller = VmcController()
    assert drive(controller, course, 1, Conditions(speed=speed)).reason == "passed"
    assert controller.warning() == ""


def test_a_silly_period_is_refused() -> None:
    with pytest.raises(ValueError, match="control period"):
        VmcController(period=0.5)
