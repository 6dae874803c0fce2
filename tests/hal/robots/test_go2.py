"""The trot of the robot on feet, with the attitude that its IMU tells."""

from __future__ import annotations

import numpy as np
import pytest

from hal.limbs import LEGS, wheel_centres
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from hal.robots import describe
from hal.robots.go2.trot import leg_angles
from mapping.grid import ElevationGrid
from rbtrg_robot.config import load
from rbtrg_robot.hosts.plan import MapPlanner

ROBOT = describe("go2")


def driver(slope: float = 0.0, rough: float = 0.0, **options: float) -> Driver:
    """On a plane that rises by `slope` [deg] along x, with random heights of +- `rough` [m]."""
    x, _ = np.meshgrid(np.arange(-4.0, 5.0, 0.05), np.arange(-3.0, 3.0, 0.05))
    ground = np.tan(np.radians(slope)) * x + np.random.default_rng(0).uniform(-rough, rough, x.shape)
    sim = Simulation(ground.astype(np.float32), 0.05, (-4.0, -3.0), robot=ROBOT.model(), **options)
    sim.reset(-1.5)
    made = Driver(sim, ROBOT.model().controller("trot", "", sim.timestep))
    made.settle(0.5)
    return made


def drive(made: Driver, seconds: float, vx: float, wz: float) -> tuple[float, float, float]:
    """Mean speed ahead and to the left [m/s] and yaw rate [rad/s]; it must not lean by 12 deg from the start on."""
    sim = made.simulation
    start, yaw, turned, up = sim.position, sim.yaw, 0.0, sim.rotation[:, 2]
    last = yaw
    for _ in range(round(seconds / sim.timestep)):
        made.step(vx, wz)
        turned += float((sim.yaw - last + np.pi) % (2.0 * np.pi) - np.pi)
        last = sim.yaw
        assert sim.rotation[:, 2] @ up > np.cos(np.radians(12.0))
    x, y, _ = sim.position - start
    c, s = np.cos(yaw), np.sin(yaw)
    return (c * x + s * y) / seconds, (c * y - s * x) / seconds, turned / seconds


def test_angles_are_the_inverse_of_the_places() -> None:
    rng = np.random.default_rng(1)
    q = ROBOT.pose.copy()
    q[:12] += rng.uniform(-0.3, 0.3, 12)
    np.testing.assert_allclose(leg_angles(ROBOT.limbs, wheel_centres(ROBOT.limbs, q)), q, atol=1e-9)


@pytest.mark.parametrize(
    ("vx", "wz", "options"),
    [
        (0.4, 0.0, {"payload": 3.0, "friction": 0.5}),
        (0.0, 0.6, {"payload": 3.0, "friction": 0.5}),
        pytest.param(0.5, 0.0, {}, marks=pytest.mark.campaign),
        pytest.param(-0.4, 0.0, {"payload": 3.0}, marks=pytest.mark.campaign),
        pytest.param(0.4, 0.0, {"command_delay": 0.01, "rough": 0.015}, marks=pytest.mark.campaign),
    ],
)
def test_it_keeps_to_its_line_whatever_it_carries(vx: float, wz: float, options: dict[str, float]) -> None:
    made = driver(**options)
    drive(made, 0.6, vx, wz)
    ahead, aside, turned = drive(made, 2.4, vx, wz)
    assert ahead == pytest.approx(vx, abs=0.08)
    assert abs(aside) < 0.04
    assert turned == pytest.approx(wz, abs=0.10)
    drive(made, 1.8, 0.0, 0.0)
    ahead, aside, turned = drive(made, 0.4, 0.0, 0.0)
    assert np.abs([ahead, aside, turned]).max() < 0.02, "it stands on all four"


@pytest.mark.parametrize("slope", [15.0, pytest.param(-15.0, marks=pytest.mark.campaign)])
def test_on_slopes_the_trunk_goes_with_the_ground(slope: float) -> None:
    made = driver(slope)
    ahead, aside, _ = drive(made, 3.0, 0.4, 0.0)
    assert ahead > 0.28
    assert abs(aside) < 0.03
    _, _, turned = drive(made, 2.0, 0.0, 0.6)
    assert turned > 0.4


def test_bars_of_two_centimetres_hold_no_foot() -> None:
    """A foot that sank below the surface of such a bar was held on all sides."""
    x = np.arange(-2.5, 3.0, 0.02)
    ground = np.tile(np.where(np.abs(x % 0.5 - 0.25) < 0.05, 0.02, 0.0), (120, 1)).astype(np.float32)
    sim = Simulation(ground, 0.02, (-2.5, -1.2), friction=1.0, payload=2.0, robot=ROBOT.model())
    sim.reset(-1.5)
    made = Driver(sim, ROBOT.model().controller("trot", "", sim.timestep))
    made.settle(0.5)
    drive(made, 0.6, 0.45, 0.0)
    feet, lowest = [sim.model.geom(f"{leg}_wheel").id for leg in LEGS], 0.0
    for _ in range(5):
        ahead, _, _ = drive(made, 1.0, 0.45, 0.0)
        assert ahead > 0.25
        lowest = min(
            lowest, *(z - ROBOT.limbs.radius - sim.ground(x, y) for x, y, z in sim.data.geom_xpos[feet])
        )
    assert lowest > -0.015


def test_a_push_is_caught_by_a_step() -> None:
    made = driver(payload=3.0, friction=0.6)
    drive(made, 1.0, 0.3, 0.0)
    made.simulation.push((0.0, 150.0, 0.0), 0.2)
    drive(made, 2.0, 0.3, 0.0)
    drive(made, 1.0, 0.0, 0.0)


@pytest.mark.parametrize(("step", "goes"), [(0.0, True), (0.10, False), (-0.10, False)])
def test_what_its_envelope_forbids_is_no_way(step: float, goes: bool) -> None:
    """A face across the whole map."""
    height = np.zeros((60, 120), np.float32)
    height[:, 60:] = step
    grid = ElevationGrid(height, np.ones(height.shape, bool), (0.0, 0.0), 0.05)
    planner = MapPlanner(grid, load(None, ["robot_model=go2"]), start=(1.5, 1.5))
    assert planner.plan((1.5, 1.5), (4.5, 1.5)).reaches_goal == goes
