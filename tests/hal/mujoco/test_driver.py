"""The loop of controller and simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hal.lowlevel import LowCommand, LowState
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation, stand_command
from hal.robots import describe
from hal.types import PostureCommand, VelocityCommand


class Recording:
    """A controller that stands and writes down what it is told."""

    def __init__(self, period: float) -> None:
        self.period = period
        self.told: list[tuple[float, float, float]] = []
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def step(self, state: LowState, velocity: VelocityCommand, posture: PostureCommand) -> LowCommand:
        self.told.append((round(state.time, 6), velocity.vx, velocity.wz))
        return stand_command(describe().pose)

    def warning(self) -> str:
        return ""


def driver(period: float) -> tuple[Driver, Recording]:
    sim = Simulation(np.zeros((41, 41), np.float32), 0.1, (-2.0, -2.0))
    sim.reset()
    controller = Recording(period)
    return Driver(sim, controller), controller


def test_the_controller_runs_at_its_own_period() -> None:
    loop, controller = driver(0.01)
    for k in range(4):
        loop.step(0.1 * k, -0.1 * k)
    assert controller.told == [(0.0, 0.0, -0.0), (0.01, 0.2, -0.2)]
    assert loop.simulation.time == 0.02
    loop.step()
    loop.restart()
    loop.step(0.5)
    assert controller.told[-1] == (0.025, 0.5, 0.0), "a restart begins with a control tick"
    assert controller.resets == 2


def test_settling_commands_nothing_for_as_long_as_asked() -> None:
    loop, controller = driver(0.005)
    loop.settle(0.2)
    assert abs(loop.simulation.time - 0.2) < 1e-9
    assert {(vx, wz) for _, vx, wz in controller.told} == {(0.0, 0.0)}
    assert len(controller.told) == 40


def test_what_the_controller_is_told_may_differ_from_the_physics() -> None:
    loop, controller = driver(0.005)
    loop.sense = lambda state: replace(state, time=7.0)
    loop.step()
    assert controller.told[0][0] == 7.0
    assert loop.simulation.time == 0.005
