"""What holds the body or a wheel is felt at once, and neither driving nor mapped ground is taken for it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hal.mujoco.driver import Driver
from hal.mujoco.sensors import imu_sample, joint_sample
from hal.mujoco.sim import Simulation
from hal.robots import describe
from hal.robots.go2w.locomotion.vmc import VmcController
from hal.safety.monitors import taken_out
from hal.safety.swept import LIDAR, TOUCHED, Surroundings
from hal.safety.touch import AFTER_FACE, BODY_TIME, CELLS, CLIMB_TIME, FACE, TALL, Touch, TouchWatch, uneven
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
    ) -> None:
        self.simulation = Simulation(
            height, RES, (-3.0, -3.0), boxes=[size for _, size, _ in box], payload=payload
        )
        self.simulation.reset()
        for k, (centre, _, yaw) in enumerate(box):
            self.simulation.place_box(k, centre, yaw)
        self.driver = Driver(self.simulation, VmcController())
        self.watch = TouchWatch(describe().limbs, describe().body.sprung_mass, 30.0)
        self.touches: list[tuple[float, Touch]] = []
        self.met = np.inf

    def drive(self, vx: float, wz: float, seconds: float, uneven: float = 0.0) -> None:
        """Until the first touch, at most so long."""
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
                )
                self.touches += [(now, touch)] if touch else []


PANE = (0.02, 3.0, 1.2)


def test_just_after_a_face_it_takes_longer_until_a_push_is_a_touch() -> None:
    # The rear wheels come onto a kerb when the map under the body is even again: drives ended on kerbs by that.
    run = Run(ground(), ((1.0, 0.0, 0.6), PANE, 0.0))
    run.drive(0.5, 0.0, 1.2, uneven=0.1)
    assert run.met == np.inf
    run.drive(0.5, 0.0, 3.0)
    (now, touch), *_ = run.touches
    assert touch == Touch(1.0, 0.0)
    assert CLIMB_TIME <= now - run.met <= AFTER_FACE + BODY_TIME + 0.1


@pytest.mark.parametrize(
    ("box", "vx", "part"),
    [
        (((1.0, 0.0, 0.6), PANE, 0.0), 0.5, "body"),
        (((-1.0, 0.0, 0.6), PANE, 0.0), -0.3, "body"),
        (((1.0, 0.0, 0.6), PANE, 1.05), 0.3, "wheel"),
        (((1.0, 0.2, 0.5), (0.05, 0.05, 1.0), 0.0), 0.4, "wheel"),
        (((1.0, 0.0, 0.42), (0.04, 3.0, 0.06), 0.0), 0.4, "body"),
        (((1.0, 0.0, 0.13), (0.04, 3.0, 0.04), 0.0), 0.5, "wheel"),
    ],
)
def test_what_it_drives_into_is_felt_within_a_fifth_of_a_second(
    box: tuple[tuple[float, float, float], tuple[float, float, float], float], vx: float, part: str
) -> None:
    run = Run(ground(), box)
    run.drive(vx, 0.0, 5.0)
    ((when, touch),) = run.touches
    assert run.met < when < run.met + 0.2
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


def pushed(forces: list[float], uneven: float) -> list[Touch]:
    """What is told of forces [N] on the body, one each joint sample, while it is slower than it should be and no wheel
    pushes."""
    watch, touches = TouchWatch(describe().limbs, describe().body.sprung_mass, 30.0), []
    for k, force in enumerate(forces):
        stamp = k * NS // 50
        watch.imu(ImuSample(stamp, np.zeros(3), np.array([-force / 14.241, 0.0, GRAVITY])))
        joints = JointSample(stamp, np.array([0.0, 0.67, -1.3] * 4 + [0.0] * 4), np.zeros(16), np.zeros(16))
        touch = watch.joints(joints, 0.5, 0.0, uneven, 0.1)
        touches += [touch] if touch else []
    return touches


def test_what_the_legs_throw_at_a_face_that_is_climbed_is_no_touch_and_what_holds_on_is() -> None:
    """The forces are those of a rescue lane: 0.19 m, a shank on the edge, the learnt policy drives."""
    thrown = [-14.0, 96.0, 143.0, -2.0, 100.0, 104.0, -5.0]
    assert pushed(thrown, 0.0) == [Touch(1.0, 0.0)]
    assert pushed(thrown, 0.193) == []
    held = [-14.0, *[100.0] * 14]
    assert pushed(held, 0.193) == [Touch(1.0, 0.0)], "within 0.3 s"


def around(height: Callable[[np.ndarray, np.ndarray], np.ndarray], source: int = LIDAR) -> Surroundings:
    x, y = np.meshgrid(0.04 * np.arange(-35, 36), 0.04 * np.arange(-35, 36))
    heights = height(x, y).astype(np.float32)
    kind = np.where(heights > 0.05, source, LIDAR).astype(np.uint8)
    nothing = np.zeros(heights.shape, np.uint8)
    return Surroundings(heights, np.full_like(heights, np.nan), kind, nothing, (-1.4, -1.4), 0.04)


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


@pytest.mark.parametrize(("riser", "tread"), [(0.15, 0.30), (0.17, 0.28), (0.18, 0.26)])
def test_stairs_explain_what_pushes_at_the_body_and_one_kerb_does_not(riser: float, tread: float) -> None:
    for x in np.arange(0.0, tread, 0.04):
        stairs = around(lambda u, _, x=x: riser * np.floor((u + x) / tread))
        assert min(uneven(stairs, (0.0, 0.0, 0.0), BODY)) > TALL
        kerb = around(lambda u, _, x=x: 0.19 * (u > x - 0.1))
        assert max(uneven(kerb, (0.0, 0.0, 0.0), BODY)) < TALL


def test_noise_of_a_cell_and_what_was_touched_explain_nothing() -> None:
    one = around(lambda x, y: 0.3 * ((np.abs(x - 0.4) < 0.01) & (np.abs(y) < 0.03)))
    assert 0 < np.count_nonzero(one.height) < CELLS
    assert uneven(one, (0.0, 0.0, 0.0), BODY)[0] < FACE
    pane = around(lambda x, _: 0.6 * ((x > 0.35) & (x < 0.45)), TOUCHED)
    assert uneven(pane, (0.0, 0.0, 0.0), BODY)[0] < FACE


def test_a_map_that_knows_nothing_explains_nothing() -> None:
    assert uneven(around(lambda x, y: x * y * np.nan), (0.0, 0.0, 0.0), BODY) == (0.0, 0.0)


def test_a_wall_beside_the_body_explains_a_held_wheel_and_no_touch_of_the_body() -> None:
    wall = uneven(around(lambda _, y: 0.6 * (np.abs(y - 0.24) < 0.021)), (0.0, 0.0, 0.0), BODY)[0]
    assert FACE < wall < TALL
