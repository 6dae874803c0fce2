"""A locomotion controller that drives the bare simulated robot: the loop of benches and tests without the stack."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hal.lowlevel import Ground, Locomotion, LowState, Sighted
from hal.mujoco.attitude import AttitudeFilter
from hal.mujoco.sim import Simulation
from hal.types import Array, PostureCommand, VelocityCommand


class Driver:
    """Velocity in, motion out: each `step` is one physics step, the controller runs at its own period.

    The controller gets the attitude of the IMU's filter on exact gyro and accelerometer. `sense` may change what the
    controller is told of the state, for example by noise. It never touches the physics."""

    def __init__(
        self,
        simulation: Simulation,
        controller: Locomotion,
        sense: Callable[[LowState], LowState] | None = None,
    ) -> None:
        self.simulation, self.controller, self.sense = simulation, controller, sense
        self._every = max(1, round(controller.period / simulation.timestep))
        self._posture = PostureCommand(0)
        self._attitude = AttitudeFilter()
        self.restart()

    def restart(self) -> None:
        """Forget the controller's state: the robot was placed anew."""
        self.controller.reset()
        self._attitude.restart()
        self._tick = 0

    def step(self, vx: float = 0.0, wz: float = 0.0) -> None:
        """One physics step under a forward speed [m/s] and a yaw rate [rad/s]."""
        state = self.simulation.low_state()
        self._attitude.measure(state)
        if self._tick % self._every == 0:
            if isinstance(self.controller, Sighted) and len(self.controller.places):
                self.controller.see(self._ground(self.controller.places))
            if self.sense is not None:
                state = self.sense(state)
            command = VelocityCommand(0, vx, 0.0, wz)
            self.simulation.apply(self.controller.step(state, command, self._posture))
        self.simulation.step()
        self._tick += 1

    def _ground(self, places: Array) -> Ground:
        """As exact as the state: what a map without errors would show."""
        sim = self.simulation
        x, y, z = sim.position.tolist()
        c, s = math.cos(sim.yaw), math.sin(sim.yaw)
        above = [z - sim.ground(x + c * a - s * b, y + s * a + c * b) for a, b in places.tolist()]
        return Ground(np.array(above), "")

    def settle(self, seconds: float) -> None:
        """Stand under zero velocity for `seconds`: the learnt policy holds its joints after 0.6 s of it."""
        for _ in range(round(seconds / self.simulation.timestep)):
            self.step()
