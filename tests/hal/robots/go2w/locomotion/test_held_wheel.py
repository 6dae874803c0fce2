"""A wheel that an edge holds while the robot drives on: it stays under the trunk, is noticed, and is lifted or driven
back from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hal.lowlevel import LowCommand, LowState
from hal.mujoco.sim import Simulation
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.climb import (
    BACK_SPEED,
    BACK_TIME,
    DRIVE,
    LIFT,
    LOWER,
    REACH,
    TIPPING_RATIO,
    back_off,
    climb_tick,
    detect_blocked,
)
from hal.robots.go2w.locomotion.controllers import OURS
from hal.robots.go2w.locomotion.hybrid import HybridController
from hal.robots.go2w.locomotion.memory import MEMORY
from hal.robots.go2w.locomotion.params import RECORD, VmcParams
from hal.robots.go2w.locomotion.vmc import VmcController
from hal.types import PostureCommand, VelocityCommand
from tools.bench.envelope.lane import WEAVE_WAYS, through_lane

FL_THIGH, FR_WHEEL, FL_WHEEL, RL = 4, 12, 13, 3
DT = 0.005


def _memory() -> Any:
    memory: Any = np.zeros(1, MEMORY).view(np.recarray)[0]
    return memory


def _params() -> Any:
    """As the controller hands them over: a tuple would be compiled for anew."""
    params: Any = np.array([VmcParams()], RECORD).view(np.recarray)[0]
    return params


def _after_holding(thigh: float, calf: float) -> tuple[np.ndarray, LowCommand]:
    """Joint angles and command when the front left leg stands elsewhere than a tick before."""
    controller, q = VmcController(), np.zeros(16)
    q[1:12:3], q[2:12:3] = 0.67, -1.3

    def tick() -> LowCommand:
        still = np.zeros(3)
        state = LowState(0.0, q.copy(), np.zeros(16), np.zeros(16), np.array([1.0, 0, 0, 0]), still, still)
        return controller.step(state, VelocityCommand(0, 0.3), PostureCommand(0))

    tick()
    q[FL_THIGH : FL_THIGH + 2] = thigh, calf
    return q, tick()


@pytest.mark.parametrize(("thigh", "calf"), [(0.85, -1.3), (1.06, -1.2), (1.05, -0.95), (1.04, -0.85)])
def test_a_wheel_held_behind_is_drawn_forward_however_straight_its_leg_is(thigh: float, calf: float) -> None:
    q, command = _after_holding(thigh, calf)
    behind = (
        go2w.wheel_centres(np.array([0.0, 0.67, -1.3] * 4 + [0.0] * 4))[1, 0] - go2w.wheel_centres(q)[1, 0]
    )
    jacobian = go2w.wheel_jacobians(q)[1]
    rate = jacobian[0, 1]  # of x with the thigh
    assert behind > 0.04
    assert command.q[FL_THIGH] - q[FL_THIGH] == pytest.approx(max(behind / rate, -0.3), abs=0.02)


def test_a_wheel_far_behind_its_place_rolls_faster_than_its_neighbour_and_one_near_it_does_not() -> None:
    _, far = _after_holding(1.05, -0.95)
    _, near = _after_holding(0.72, -1.3)
    assert far.dq[FL_WHEEL] > far.dq[FR_WHEEL] + 1.0
    assert near.dq[FL_WHEEL] == pytest.approx(near.dq[FR_WHEEL], abs=0.3)


@pytest.mark.parametrize("steering", [0.0, -0.35])
def test_a_wheel_that_holds_a_standing_robot_is_found_although_the_robot_is_steered(steering: float) -> None:
    m, params, rng = _memory(), _params(), np.random.default_rng(0)
    m.vx, m.wz = 0.3, steering
    m.force[:, 2] = 48.0
    found = -1
    for _ in range(round(2.0 / DT)):
        m.speed = rng.normal(0.05, 0.05)
        m.force[:, 0] = [-5.0, 28.0, -5.0, -25.0 + rng.normal(0.0, 6.0)]
        found = detect_blocked.py_func(m, np.zeros((4, 3)), 1.0, DT, params)
        if found >= 0:
            break
    assert found == RL


def test_no_wheel_is_blocked_while_the_robot_drives_and_turns() -> None:
    m, params = _memory(), _params()
    m.vx, m.wz, m.speed, m.pace = 0.3, 0.35, 0.3, 0.3
    m.force[:, 2] = 48.0
    m.force[:, 0] = [-5.0, 28.0, -5.0, -25.0]
    centres = np.zeros((4, 3))
    assert all(detect_blocked.py_func(m, centres, 1.0, DT, params) == -1 for _ in range(400))


def test_a_climb_without_footing_drives_back_for_a_while_and_not_once_commanded_away() -> None:
    m = _memory()
    m.way, m.retreat = 1.0, BACK_TIME
    speeds = [back_off.py_func(m, 0.4, DT) for _ in range(round(1.5 * BACK_TIME / DT))]
    assert speeds[0] == -BACK_SPEED
    assert speeds[-1] == 0.4
    assert sum(v < 0.0 for v in speeds) * DT == pytest.approx(BACK_TIME, abs=2 * DT)
    m.retreat = BACK_TIME
    assert back_off.py_func(m, -0.4, DT) == -0.4
    assert back_off.py_func(m, 0.4, DT) == 0.4


@pytest.mark.parametrize("mode", [LIFT, REACH])
@pytest.mark.parametrize(("share", "after"), [(0.95, None), (1.05, LOWER)])
def test_a_wheel_in_the_air_is_put_down_where_it_is_when_the_trunk_tips(
    mode: int, share: float, after: int | None
) -> None:
    m, params = _memory(), _params()
    centres = go2w.wheel_centres(np.array([0.0, 0.67, -1.3] * 4 + [0.0] * 4))
    m.mode, m.leg, m.way, m.vx = mode, 1, 1.0, 0.3
    m.foot[:] = centres[1] + [0.05, 0.0, 0.03]
    m.lift_x = centres[1, 0]
    m.tilt[0] = -share * TIPPING_RATIO * params.lift_tilt
    climb_tick(m, centres, np.zeros(3), np.eye(3), 0.3, np.zeros(3), DT, params)
    assert m.mode == (mode if after is None else after)
    if after is not None:
        assert m.foot[[0, 2]] == pytest.approx(centres[1, [0, 2]])


@pytest.mark.parametrize("friction", [0.8, 1.0])
def test_on_flat_ground_no_wheel_counts_as_blocked_whatever_is_commanded(friction: float) -> None:
    """Not when the robot sets off into a turn, nor from the strain between the wheels after one."""
    sim = Simulation(np.zeros((300, 300), np.float32), 0.05, (-7.5, -7.5), friction=friction)
    sim.reset(0.0, 0.0, 0.0)
    controller = VmcController()
    pairs = [
        ((-0.15, 0.5), (-0.3, 0.0)),
        ((0.5, 0.5), (-0.15, 0.0)),
        ((0.5, -0.5), (-0.15, 0.0)),
        ((-0.15, 0.8), (-0.3, 0.0)),
    ]
    lifted = []
    for before, after in pairs:
        for vx, wz in ((0.0, 0.0), before, after):
            for _ in range(250):
                sim.apply(
                    controller.step(sim.low_state(), VelocityCommand(0, vx, 0.0, wz), PostureCommand(0))
                )
                sim.step()
                lifted.append(int(controller._memory["mode"][0]) != DRIVE)
    assert not any(lifted)


def test_the_kerbs_of_a_lane_are_crossed_askew_without_tipping() -> None:
    end = through_lane(VmcController(), 112, "kerbs", WEAVE_WAYS[0])
    assert end.passed
    assert end.tilt < 35.0


@pytest.mark.parametrize("hybrid", [False, True])
def test_what_holds_a_wheel_is_climbed_only_where_that_is_allowed(hybrid: bool) -> None:
    """At a face of 9 cm: the model-based controller lifts a wheel, the hybrid one hands over, or neither does."""
    x, _ = np.meshgrid(np.arange(-1.0, 2.0, 0.02), np.arange(-1.0, 1.0, 0.02))
    height = np.where(x > 0.5, 0.09, 0.0).astype(np.float32)
    for climb in (True, False):
        controller = HybridController(OURS) if hybrid else VmcController()
        wheels = controller.wheels if isinstance(controller, HybridController) else controller
        simulation = Simulation(height, 0.02, (-1.0, -1.0))
        simulation.reset()
        every = round(controller.period / simulation.timestep)
        climbed = False
        for k in range(round(2.0 / simulation.timestep)):
            if k % every == 0:
                command = VelocityCommand(0, 0.4, climb=climb)
                simulation.apply(controller.step(simulation.low_state(), command, PostureCommand(0)))
                climbed |= wheels._mode[0] != DRIVE
                climbed |= isinstance(controller, HybridController) and controller.climbing
            simulation.step()
        assert climbed == climb
