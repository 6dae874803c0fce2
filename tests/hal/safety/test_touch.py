"""What holds the body or a wheel is felt at once, and neither driving nor mapped ground is taken for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from hal.limbs import LEGS, wheel_centres
from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.sensors import imu_sample, joint_sample
from hal.mujoco.sim import Simulation
from hal.robots import describe
from hal.robots.go2w.locomotion.controllers import OURS
from hal.robots.go2w.locomotion.hybrid import HybridController
from hal.robots.go2w.locomotion.vmc import VmcController
from hal.rotation import rotation_rpy
from hal.safety.monitors import taken_out
from hal.safety.swept import LIDAR, TOUCHED, Surroundings
from hal.safety.touch import FACE_HEIGHT, LEAST_CELLS, Touch, TouchWatch, near_body, uneven
from hal.types import GRAVITY, NS, ImuSample, JointSample
from tests.hal.safety.ground import BODY

RES = 0.02


def ground(height: Callable[[np.ndarray], np.ndarray] = np.zeros_like) -> np.ndarray:
    x, _ = np.meshgrid(np.arange(-3.0, 5.0, RES), np.arange(-3.0, 3.0, RES))
    return height(x).astype(np.float32)


class Run:
    """The bare robot at the origin, driven by hand; what the watch tells of it, and when something but a wheel's tread
    on the ground touched it."""

    def __init__(
        self,
        height: np.ndarray,
        *box: tuple[tuple[float, float, float], tuple[float, float, float], float],
        payload: float = 0.0,
        controller: Locomotion | None = None,
    ) -> None:
        self.simulation = Simulation(
            height, RES, (-3.0, -3.0), boxes=[size for _, size, _ in box], payload=payload
        )
        self.simulation.reset()
        for k, (centre, _, yaw) in enumerate(box):
            self.simulation.place_box(k, centre, yaw)
        self.driver = Driver(self.simulation, controller or VmcController())
        self.watch = TouchWatch(describe().limbs, describe().body.sprung_mass, 30.0)
        self.touches: list[tuple[float, Touch]] = []
        self.met = np.inf

    def drive(
        self, vx: float, wz: float, seconds: float, uneven: float = 0.0, ground: Surroundings | None = None
    ) -> None:
        """Until the first touch, at most so long. `ground`: what the map tells of what is near the body."""
        for k in range(round(seconds / self.simulation.timestep)):
            if self.touches:
                return
            self.driver.step(vx, wz)
            state, now = self.simulation.low_state(), self.simulation.time
            contacts = self.simulation.contacts()
            if self.met == np.inf and ((contacts.places[:, 2] > 0.03) & (contacts.forces > 1.0)).any():
                self.met = now
            self.watch.imu(imu_sample(round(now * NS), state))
            if k % 4 == 0:
                touch = self.watch.joints(
                    joint_sample(round(now * NS), state),
                    vx,
                    wz,
                    uneven,
                    float(self.simulation.linear_velocity[0]),
                    near_body=ground is not None and self._near(ground),
                )
                self.touches += [(now, touch)] if touch else []

    def _near(self, ground: Surroundings) -> bool:
        sim = self.simulation
        return near_body(ground, tuple(sim.position), sim.rotation, describe().limbs, sim.low_state().q, BODY)


PANE = (0.02, 3.0, 1.2)


@pytest.mark.parametrize(
    ("box", "vx", "part"),
    [
        (((1.0, 0.0, 0.6), PANE, 0.0), 0.5, "body"),
        (((-1.0, 0.0, 0.6), PANE, 0.0), -0.3, "wheel"),
        (((1.0, 0.0, 0.6), PANE, 1.05), 0.3, "wheel"),
        (((1.0, 0.2, 0.5), (0.05, 0.05, 1.0), 0.0), 0.4, "wheel"),
        (((1.0, 0.0, 0.42), (0.04, 3.0, 0.06), 0.0), 0.4, "body"),
        (((1.0, 0.0, 0.13), (0.04, 3.0, 0.04), 0.0), 0.5, "wheel"),
    ],
)
def test_what_it_drives_into_is_felt_within_three_tenths_of_a_second(
    box: tuple[tuple[float, float, float], tuple[float, float, float], float], vx: float, part: str
) -> None:
    run = Run(ground(), box)
    run.drive(vx, 0.0, 5.0)
    ((when, touch),) = run.touches
    assert run.met < when < run.met + 0.3
    assert touch.way == np.sign(vx)
    assert (touch.left == 0.0) == (part == "body")


def test_without_the_monitor_it_is_not_felt() -> None:
    with taken_out("touched"):
        run = Run(ground(), ((0.6, 0.0, 0.6), PANE, 0.0))
        run.drive(0.5, 0.0, 1.5)
    assert np.isfinite(run.met)
    assert not run.touches


def test_starts_stops_and_turns_are_no_touch() -> None:
    run = Run(ground())
    for vx, wz in [
        (1.0, 0.0),
        (0.0, 0.0),
        (-0.5, 0.0),
        (0.5, 0.0),
        (0.5, 1.0),
        (0.3, -1.0),
        (0.0, 1.0),
        (0.1, 0.0),
    ]:
        run.drive(vx, wz, 1.0)
    assert not run.touches


@pytest.mark.parametrize("payload", [0.0, 8.0])
@pytest.mark.parametrize("slope", [0.36, -0.36])
def test_a_ramp_whose_foot_the_map_tells_is_no_touch_whatever_is_carried(
    slope: float, payload: float
) -> None:
    run = Run(ground(lambda x: slope * np.clip(x - 0.6, 0.0, 1.5)), payload=payload)
    run.drive(0.5, 0.0, 1.6, uneven=0.08)
    assert run.simulation.position[0] > 0.6
    run.drive(0.5, 0.0, 1.8)
    assert run.simulation.position[0] > 1.2
    assert not run.touches


def test_a_face_is_climbed_where_the_map_tells_it_and_touched_where_it_does_not() -> None:
    kerb = ground(lambda x: 0.09 * ((x > 0.7) & (x < 1.5)))
    told, untold = Run(kerb), Run(kerb)
    told.drive(0.4, 0.0, 9.0, uneven=0.09)
    assert not told.touches
    assert told.simulation.position[0] > 1.5
    untold.drive(0.4, 0.0, 9.0)
    assert untold.touches
    assert untold.simulation.position[0] < 0.7


def test_a_pane_on_a_kerb_is_felt_astride_of_the_kerb_and_the_kerb_alone_is_not() -> None:
    """The learnt policy climbs; the front wheels are on the kerb or at its face when the nose meets the pane."""

    def told(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.19 * ((x > 0.6) & (x < 1.2))

    kerb, climber = ground(lambda x: told(x, x)), HybridController(OURS)
    alone = Run(kerb, controller=climber)
    alone.drive(0.5, 0.0, 7.0, uneven=0.19, ground=around(told))
    assert alone.simulation.position[0] > 1.0
    assert not alone.touches
    pane = Run(kerb, ((0.76, 0.0, 0.79), PANE, 0.0), controller=HybridController(OURS))
    pane.drive(0.5, 0.0, 6.0, uneven=0.19, ground=around(told))
    ((when, touch),) = pane.touches
    assert touch == Touch(1.0, 0.0)
    assert when < pane.met + 1.0


def pushed(forces: list[float], near_body: Sequence[bool] = (False,)) -> list[Touch]:
    """What is told of forces [N] on the body, one each joint sample, while it is slower than it should be and no wheel
    pushes. `near_body`: again and again."""
    watch, touches = TouchWatch(describe().limbs, describe().body.sprung_mass, 30.0), []
    for k, force in enumerate(forces):
        stamp = k * NS // 50
        watch.imu(ImuSample(stamp, np.zeros(3), np.array([-force / 14.241, 0.0, GRAVITY])))
        joints = JointSample(stamp, np.array([0.0, 0.67, -1.3] * 4 + [0.0] * 4), np.zeros(16), np.zeros(16))
        touch = watch.joints(joints, 0.5, 0.0, 0.2, 0.1, near_body=near_body[k % len(near_body)])
        touches += [touch] if touch else []
    return touches


def test_what_throws_legs_about_is_no_touch_nor_what_the_map_explains_and_what_pushes_on_is() -> None:
    thrown = [90.0, 40.0, -60.0, -50.0, 10.0, 0.0]
    assert not pushed(5 * thrown)
    pane = [100.0] * 8
    assert pushed(pane) == [Touch(1.0, 0.0)], "within 0.16 s"
    assert not pushed(4 * pane, [True])
    assert not pushed(4 * pane, 3 * [True] + 12 * [False]), "a shank that comes and goes"
    assert pushed(4 * pane, [True] + 31 * [False]), "it was there for a moment only"


@pytest.mark.parametrize(
    ("torques", "told"), [([1.0, -3.0, 1.0, 1.0], []), ([2.0, 2.0, 2.0, 2.0], [Touch(1.0, 0.0)])]
)
def test_a_motor_of_a_wheel_on_the_body_that_brakes_in_a_bend_is_no_touch_and_motors_that_push_in_vain_are(
    torques: list[float], told: list[Touch]
) -> None:
    """On lanes with a map the Jackal-like robot took bends on bars of 2 cm for glass."""
    robot = describe("jackal")
    watch = TouchWatch(robot.limbs, robot.body.sprung_mass, robot.body.touch_force)
    touches = []
    for k in range(40):
        watch.imu(ImuSample(k * NS // 50, np.zeros(3), np.array([0.0, 0.0, GRAVITY])))
        joints = JointSample(k * NS // 50, np.zeros(16), np.zeros(16), np.array([0.0] * 12 + torques))
        touch = watch.joints(joints, 0.4, 0.1, 0.0, 0.0)
        touches += [touch] if touch else []
    assert touches[:1] == told


def around(height: Callable[[np.ndarray, np.ndarray], np.ndarray], source: int = LIDAR) -> Surroundings:
    x, y = np.meshgrid(0.04 * np.arange(-35, 36), 0.04 * np.arange(-35, 36))
    heights = height(x, y).astype(np.float32)
    kind = np.where(heights > 0.05, source, LIDAR).astype(np.uint8)
    nothing = np.zeros(heights.shape, np.uint8)
    return Surroundings(
        heights, np.full_like(heights, np.nan), kind, nothing, np.zeros_like(heights), (-1.4, -1.4), 0.04
    )


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("yaw", [0.0, 0.7, 3.0])
def test_a_slope_is_even_and_a_step_before_the_wheels_is_not(way: float, yaw: float) -> None:
    here, c, s = (0.0, 0.0, yaw), way * np.cos(yaw), way * np.sin(yaw)
    slope = around(lambda x, y: 0.4 * x - 0.2 * y)
    assert max(uneven(slope, here, BODY)) < 1e-5
    step = around(lambda x, y: 0.1 * (c * x + s * y > 0.45))
    ends = uneven(step, here, BODY)
    assert ends[way < 0.0] == pytest.approx(0.1, abs=1e-5)
    assert ends[way > 0.0] < 1e-5, "it is at the other end"


def near(
    height: Callable[[np.ndarray, np.ndarray], np.ndarray],
    pitch: float = 0.0,
    **legs: tuple[float, float, float],
) -> bool:
    """Whether ground comes up to a robot at the origin whose front wheels stand at height 0; `pitch` [rad], nose up;
    joint angles of `legs` that do not stand."""
    q = describe().pose.copy()
    for leg, angles in legs.items():
        q[3 * LEGS.index(leg) : 3 * LEGS.index(leg) + 3] = angles
    turned = rotation_rpy(0.0, -pitch, 0.0)
    z = describe().limbs.radius - (wheel_centres(describe().limbs, q) @ turned.T)[:2, 2].mean()
    return near_body(around(height), (0.0, 0.0, z), turned, describe().limbs, q, BODY)


def test_ground_that_a_shank_hangs_on_is_near_the_body_and_a_kerb_before_or_between_the_wheels_is_not() -> (
    None
):
    assert not near(lambda x, y: 0.0 * x)
    assert not near(lambda x, y: 0.19 * (x > 0.31)), "before the wheels"
    up = math.asin(0.19 / 0.42)

    def kerb(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(x < 0.12, -0.19, 0.0)

    assert not near(kerb, up), "astride"
    # In a lane of kerbs: the rear left leg trails and hangs by its shank on the edge that the other three stand on.
    legs = {"FR": (0.13, 0.88, -2.73), "FL": (-0.39, 0.59, -2.31), "RR": (-0.07, 1.41, -2.72)}

    def behind(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(x < -0.47, -0.19, 0.0)

    assert near(behind, 0.34, RL=(-0.12, 1.98, -0.83), **legs)


@pytest.mark.parametrize(("riser", "tread"), [(0.15, 0.30), (0.17, 0.28), (0.18, 0.26)])
def test_stairs_come_up_to_the_nose_of_a_robot_on_them(riser: float, tread: float) -> None:
    places = np.arange(0.0, tread, 0.04)

    def stairs(at: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        return lambda x, y: riser * np.floor((x - 0.19 + at) / tread)

    assert any(near(stairs(at), 0.6 * math.atan(riser / tread)) for at in places)


def test_noise_of_a_cell_and_what_was_touched_explain_nothing() -> None:
    one = around(lambda x, y: 0.3 * ((np.abs(x - 0.4) < 0.01) & (np.abs(y) < 0.03)))
    assert 0 < np.count_nonzero(one.height) < LEAST_CELLS
    assert uneven(one, (0.0, 0.0, 0.0), BODY)[0] < FACE_HEIGHT
    pane = around(lambda x, _: 0.6 * ((x > 0.35) & (x < 0.45)), TOUCHED)
    assert uneven(pane, (0.0, 0.0, 0.0), BODY)[0] < FACE_HEIGHT


def test_a_map_that_knows_nothing_explains_nothing() -> None:
    assert uneven(around(lambda x, y: x * y * np.nan), (0.0, 0.0, 0.0), BODY) == (0.0, 0.0)


def test_a_wall_beside_the_body_explains_a_held_wheel() -> None:
    wall = uneven(around(lambda _, y: 0.6 * (np.abs(y - 0.24) < 0.021)), (0.0, 0.0, 0.0), BODY)[0]
    assert wall > FACE_HEIGHT
