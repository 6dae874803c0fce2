"""Driving backward over a bar or up a step."""

from __future__ import annotations

import math

import numpy as np

from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from tools.bench.envelope.terrain import CELL_SIDE
from tools.bench.envelope.trial import TIME_STEP, TIPPED_COSINE, steering

TRIALS = tuple((angle, friction) for angle in (0.0, 0.3, 0.5) for friction in (0.6, 0.8, 1.0))
"""Angle [rad] between the way and the face's normal, and wheel friction."""
BACKWARD_SPEED = 0.5
"""[m/s]"""
FACE_DISTANCE, PASSED_DISTANCE = 1.2, 2.2
"""[m] behind the robot: where the face stands, and where the robot has passed it."""
BAR_WIDTH = 0.10
"""Of a bar [m]."""
LONGEST_DRIVE = 14.0
"""[s]"""


def passes_backward(controller: Locomotion, kind: str, height: float, angle: float, friction: float) -> bool:
    """Whether it drives backward over a `bar`, or up a `step`, of `height` [m]."""
    x, y = np.meshgrid(np.arange(-3.0, 1.0, CELL_SIDE), np.arange(-2.0, 2.0, CELL_SIDE))
    beyond = -(x + FACE_DISTANCE) * math.cos(angle) + y * math.sin(angle)
    on = (beyond > 0.0) & (beyond < (BAR_WIDTH if kind == "bar" else np.inf))
    ground = np.where(on, height, 0.0).astype(np.float32)
    sim = Simulation(ground, CELL_SIDE, (-3.0, -2.0), friction=friction, timestep=TIME_STEP)
    sim.reset()
    driver = Driver(sim, controller)
    while sim.time < LONGEST_DRIVE:
        drives = sim.time >= 0.5
        driver.step(-BACKWARD_SPEED * drives, float(steering(-sim.position[1], sim.yaw)) * drives)
        if sim.rotation[2, 2] < TIPPED_COSINE:
            return False
        if sim.position[0] < -PASSED_DISTANCE:
            return True
    return False
