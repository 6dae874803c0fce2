"""Driving backward over a bar or up a step."""

from __future__ import annotations

import math

import numpy as np

from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from tools.bench.envelope.terrain import RESOLUTION
from tools.bench.envelope.trial import DT, TIPPED, steering

TRIALS = tuple((angle, friction) for angle in (0.0, 0.3, 0.5) for friction in (0.6, 0.8, 1.0))
"""Angle [rad] between the way and the face's normal, and wheel friction."""
SPEED = 0.5
"""[m/s]"""
NEAR, BEYOND = 1.2, 2.2
"""[m] behind the robot: where the face stands, and where the robot has passed it."""
WIDE = 0.10
"""Of a bar [m]."""
LONGEST = 14.0
"""[s]"""


def passes_backward(controller: Locomotion, kind: str, height: float, angle: float, friction: float) -> bool:
    """Whether it drives backward over a `bar`, or up a `step`, of `height` [m]."""
    x, y = np.meshgrid(np.arange(-3.0, 1.0, RESOLUTION), np.arange(-2.0, 2.0, RESOLUTION))
    beyond = -(x + NEAR) * math.cos(angle) + y * math.sin(angle)
    on = (beyond > 0.0) & (beyond < (WIDE if kind == "bar" else np.inf))
    ground = np.where(on, height, 0.0).astype(np.float32)
    sim = Simulation(ground, RESOLUTION, (-3.0, -2.0), friction=friction, timestep=DT)
    sim.reset()
    driver = Driver(sim, controller)
    while sim.time < LONGEST:
        drives = sim.time >= 0.5
        driver.step(-SPEED * drives, float(steering(-sim.position[1], sim.yaw)) * drives)
        if sim.rotation[2, 2] < TIPPED:
            return False
        if sim.position[0] < -BEYOND:
            return True
    return False
