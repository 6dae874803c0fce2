"""The MuJoCo model carries the facts, and the bare simulation follows the motors' torque law."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hal.lowlevel import LowCommand
from hal.mujoco.contacts import PARTS
from hal.mujoco.model import build
from hal.mujoco.sim import Simulation, stand_command
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.simulated import GO2W

RESOLUTION = 0.05


def bumpy(rows: int = 61, cols: int = 81) -> np.ndarray:
    return np.random.default_rng(3).uniform(-0.2, 0.3, (rows, cols)).astype(np.float32)


def flat(n: int = 81) -> np.ndarray:
    return np.zeros((n, n), np.float32)


def on_flat(**options: object) -> Simulation:
    sim = Simulation(flat(), RESOLUTION, (-2.0, -2.0), **options)  # type: ignore[arg-type]
    sim.reset()
    return sim


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return build(flat(), RESOLUTION, (-2.0, -2.0), GO2W)


def test_mass_is_the_facts(model: mujoco.MjModel) -> None:
    assert model.body_mass.sum() == pytest.approx(19.521, abs=1e-3)


def test_left_and_right_balance(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    centre = data.subtree_com[model.body("base_link").id]
    assert centre[1] == pytest.approx(0.0, abs=1e-4)


def test_mirrored_links_have_the_same_principal_inertia(model: mujoco.MjModel) -> None:
    for part in ("hip", "thigh", "calf", "wheel"):
        moments = [np.sort(model.body(f"{leg}_{part}").inertia) for leg in go2w.LEGS]
        for moment in moments[1:]:
            np.testing.assert_allclose(moment, moments[0], rtol=1e-6)


def test_actuators_are_the_motors_in_sdk_order_with_their_limits(model: mujoco.MjModel) -> None:
    assert tuple(model.actuator(i).name for i in range(model.nu)) == go2w.MOTORS
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], go2w.TORQUE_LIMIT)
    for motor, name in enumerate(go2w.MOTORS[:12]):
        np.testing.assert_allclose(model.joint(name).range, go2w.JOINT_RANGE[motor], atol=1e-9)


def test_wheels_are_where_the_kinematics_say() -> None:
    sim = on_flat()
    rng = np.random.default_rng(5)
    for _ in range(20):
        q = rng.uniform(go2w.JOINT_RANGE[:12, 0], go2w.JOINT_RANGE[:12, 1])
        sim.data.qpos[:7] = [0, 0, 1, 1, 0, 0, 0]
        sim.data.qpos[sim._qadr[:12]] = q
        mujoco.mj_kinematics(sim.model, sim.data)
        for leg, name in enumerate(go2w.LEGS):
            place = sim.data.geom(f"{name}_wheel").xpos - [0, 0, 1]
            np.testing.assert_allclose(place, go2w.wheel_centres(q)[leg], atol=1e-9)


def test_housing_leaves_36_mm_of_clearance() -> None:
    sim = on_flat()
    sim.data.qpos[:7] = [0, 0, go2w.stand_height(go2w.STAND), 1, 0, 0, 0]
    sim.data.qpos[sim._qadr] = go2w.STAND
    mujoco.mj_kinematics(sim.model, sim.data)
    housings = [
        g
        for g in range(sim.model.ngeom)
        if sim.model.geom_group[g] == 3
        and sim.model.geom_type[g] == mujoco.mjtGeom.mjGEOM_CYLINDER
        and sim.model.geom_size[g, 1] == 0.025
    ]
    assert len(housings) == 4
    for g in housings:
        assert sim.data.geom_xpos[g, 2] - 0.05 == pytest.approx(0.036, abs=1e-3)


def test_terrain_has_the_height_of_each_cell_at_its_centre() -> None:
    height = bumpy()
    model = build(height, RESOLUTION, (-1.0, 2.0), GO2W)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    only_terrain = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    for r, c in ((1, 1), (30, 40), (59, 79), (7, 63)):
        start = np.array([-1.0 + c * RESOLUTION, 2.0 + r * RESOLUTION, 2.0])
        hit = mujoco.mj_ray(
            model, data, start, np.array([0, 0, -1.0]), only_terrain, 1, -1, np.zeros(1, np.int32), None
        )
        assert 2.0 - hit == pytest.approx(height[r, c], abs=1e-4)


def test_payload_adds_its_mass() -> None:
    assert build(flat(), 0.05, (0, 0), GO2W, payload=3.0).body_mass.sum() == pytest.approx(22.521, abs=1e-3)


def test_wheel_friction_is_the_grounds_friction(model: mujoco.MjModel) -> None:
    slick = build(flat(), 0.05, (0, 0), GO2W, friction=0.4)
    for leg in go2w.LEGS:
        assert slick.geom(f"{leg}_wheel").friction[0] == 0.4
        assert slick.geom(f"{leg}_wheel").priority[0] > slick.geom("terrain").priority[0]


# --- the simulation -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slope", [0.0, 0.2, 0.36])
@pytest.mark.parametrize("along", ["x", "y"])
def test_reset_stands_level_on_a_slope_and_stays(slope: float, along: str) -> None:
    ramp = slope * (np.arange(81) * RESOLUTION - 2.0)
    height = np.tile(ramp, (81, 1)) if along == "x" else np.tile(ramp[:, None], (1, 81))
    sim = Simulation(height.astype(np.float32), RESOLUTION, (-2.0, -2.0))
    sim.reset(0.1, -0.2, 0.7)
    assert sim.time == 0.0
    assert set(sim.contacts().bodies) == {f"{leg}_wheel" for leg in go2w.LEGS}, (
        "it stands on its wheels and on nothing else"
    )
    assert sim.rotation[2, 2] > np.cos(0.15)
    assert sim.yaw == pytest.approx(0.7, abs=0.05)
    np.testing.assert_allclose(sim.position[:2], [0.1, -0.2], atol=0.05)


def test_torque_is_the_motor_law_clipped_at_the_limit() -> None:
    sim = on_flat()
    state = sim.low_state()
    rng = np.random.default_rng(0)
    command = LowCommand(
        q=state.q + rng.uniform(-0.3, 0.3, 16),
        dq=rng.uniform(-2, 2, 16),
        tau=rng.uniform(-5, 5, 16),
        kp=rng.uniform(0, 300, 16),
        kd=rng.uniform(0, 2, 16),
    )
    law = command.tau + command.kp * (command.q - state.q) + command.kd * (command.dq - state.dq)
    assert (np.abs(law) > go2w.TORQUE_LIMIT).any(), "the draw must reach a limit somewhere"
    sim.apply(command)
    sim.step()
    np.testing.assert_allclose(
        sim.low_state().tau, np.clip(law, -go2w.TORQUE_LIMIT, go2w.TORQUE_LIMIT), atol=1e-9
    )


def test_a_free_wheel_does_not_spin_past_its_speed_limit() -> None:
    sim = on_flat()
    sim.data.qpos[2] = 3.0
    command = stand_command(go2w.STAND)
    command.kd[go2w.WHEEL_JOINTS] = 0.0
    command.tau[go2w.WHEEL_JOINTS] = 5.0
    sim.apply(command)
    top = 0.0
    for _ in range(100):
        sim.step()
        top = max(top, float(sim.low_state().dq[go2w.WHEEL_JOINTS].max()))
    assert 0.95 * go2w.SPEED_LIMIT[12] < top < 1.10 * go2w.SPEED_LIMIT[12]


def test_stiff_damping_is_stable_at_five_milliseconds() -> None:
    sim = on_flat()
    sim.apply(stand_command(go2w.STAND, kp=200.0))
    sim.step(200)
    assert np.abs(sim.low_state().dq).max() < 0.2
    assert not sim.diverged


def test_a_command_takes_effect_after_its_delay() -> None:
    sim = on_flat(command_delay=0.02)
    command = stand_command(sim.low_state().q, kp=0.0)
    command.kd[:] = 0.0
    command.tau[:] = 1.25
    sim.apply(command)
    torques = []
    for _ in range(6):
        sim.step()
        torques.append(float(sim.low_state().tau[0]))
    assert [t == 1.25 for t in torques] == [False] * 4 + [True] * 2


def test_a_push_moves_the_trunk_and_ends() -> None:
    sim = on_flat()
    sim.apply(stand_command(sim.low_state().q, kp=150.0))
    before = sim.position
    sim.push((0.0, 120.0, 0.0), 0.1)
    sim.step(20)
    assert sim.linear_velocity[1] > 0.2
    sim.step(200)
    assert sim.data.xfrc_applied.max() == 0.0
    assert np.linalg.norm(sim.position - before) < 0.3


def test_boxes_are_solid_where_they_are_placed() -> None:
    sim = on_flat(boxes=((0.2, 1.0, 0.6),))
    drive = stand_command(sim.low_state().q, kp=150.0)
    drive.dq[go2w.WHEEL_JOINTS] = 4.0
    drive.kd[go2w.WHEEL_JOINTS] = 1.0
    sim.place_box(0, (0.65, 0.0, 0.3))
    sim.apply(drive)
    sim.step(400)
    assert 0.15 < sim.position[0] < 0.30, "it drove up to the box"
    assert not all(name.endswith("wheel") for name in sim.contacts().bodies), "the trunk touches the box"
    assert abs(sim.linear_velocity[0]) < 0.02, "the box stops it, its wheels still drive"
    sim.place_box(0, None)
    sim.step(400)
    assert sim.position[0] > 0.6, "the box is gone"


def test_divergence_is_noticed() -> None:
    sim = on_flat()
    assert not sim.diverged
    sim.data.qvel[0] = np.nan
    sim.step()
    assert sim.diverged
    sim.reset()
    assert not sim.diverged


def test_contacts_tell_part_and_force() -> None:
    sim = on_flat()
    force = dict(zip(PARTS, sim.part_forces().tolist(), strict=True))
    assert force["wheel"] == pytest.approx(19.521 * 9.81, rel=0.02)
    assert force["trunk"] == force["leg"] == force["housing"] == 0.0
    contacts = sim.contacts()
    assert contacts.forces.sum() == pytest.approx(force["wheel"])
    assert {PARTS[k] for k in contacts.parts.tolist()} == {"wheel"}
    sim.data.qpos[2] -= 0.06  # sunk until the housings are in the ground and trunk and legs are not
    mujoco.mj_forward(sim.model, sim.data)
    assert [f > 0.0 for f in sim.part_forces().tolist()] == [False, False, True, True]


def test_the_vendors_colliders_have_no_housings() -> None:
    sim = on_flat(housings=False)
    sim.data.qpos[2] -= 0.06
    mujoco.mj_forward(sim.model, sim.data)
    assert not sim.part_forces()[:3].any()
    assert sim.model.body_mass.sum() == pytest.approx(19.521, abs=1e-3), "only the collider is gone"


def test_the_robot_is_lifted_until_nothing_but_wheels_touches() -> None:
    height = flat()
    height[38:43, 38:43] = 0.45  # a block under the trunk, between the wheels
    sim = Simulation(height, RESOLUTION, (-2.0, -2.0))
    sim.reset(q=go2w.STAND, settle=0.0)
    assert sim.part_forces()[:3].any()
    lift = sim.lift_clear()
    assert not sim.part_forces()[:3].any()
    assert 0.05 < lift < 0.25
    assert sim.time == 0.0
    sim.data.qpos[2] -= 0.011
    mujoco.mj_forward(sim.model, sim.data)
    assert sim.part_forces()[:3].any(), "one step less was not enough"


def test_friction_set_later_is_friction_built_in_and_nothing_is_left_of_a_run_before() -> None:
    def run(sim: Simulation) -> list[float]:
        sim.reset()
        sim.apply(stand_command(go2w.STAND))
        sim.push((120.0, 80.0, 0.0), 0.5)
        sim.step(150)
        return sim.data.qpos.tolist()

    fresh = Simulation(flat(), RESOLUTION, (-2.0, -2.0), friction=0.6)
    used = Simulation(flat(), RESOLUTION, (-2.0, -2.0), friction=1.0)
    other = run(used)
    used.set_friction(0.6)
    assert run(used) == run(fresh)
    assert other != run(used)


@pytest.mark.parametrize("timestep", [0.002, 0.005])
@pytest.mark.parametrize("speed", [-6.0, 2.0, 6.0])
def test_wheels_that_roll_cover_their_circumference(speed: float, timestep: float) -> None:
    sim = on_flat(timestep=timestep)
    command = stand_command(go2w.STAND)
    command.kp[go2w.WHEEL_JOINTS], command.kd[go2w.WHEEL_JOINTS] = 0.0, 5.0

    def roll(seconds: float) -> None:
        for _ in range(round(seconds / timestep)):
            command.dq[go2w.WHEEL_JOINTS] = speed * min(1.0, sim.time)
            sim.apply(command)
            sim.step()

    roll(1.5)
    start, angle = sim.position[0], sim.low_state().q[go2w.WHEEL_JOINTS].mean()
    roll(1.0)
    driven = sim.position[0] - start
    rolled = go2w.WHEEL_RADIUS * (sim.low_state().q[go2w.WHEEL_JOINTS].mean() - angle)
    assert abs(rolled) > 0.1
    assert driven / rolled == pytest.approx(1.0, abs=0.01)
