"""Creeping towards an edge that is far deeper than the robot can descend: does it stay on top, say why, and get
away?"""

from __future__ import annotations

import math

import numpy as np

from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from tools.bench.envelope.terrain import CELL_SIDE
from tools.bench.envelope.trial import TIME_STEP, TIPPED_COSINE

EDGE_DEPTH = 0.5
"""Of the edge [m]."""
EDGE_X = 1.0
"""Where the edge crosses the x axis [m]."""
START_X = 0.6
"""[m]; behind the edge by the robot's half length and a little."""
HALF_SIDE = 2.0
"""Half the side of the ground [m]."""
WHEEL_FRICTIONS = (0.4, 0.6, 0.8, 1.0)

Trial = tuple[float, float, float, float]
"""Speed [m/s], negative backward; angle of the edge [rad]; friction; command delay [s]."""

WAYS: dict[str, list[Trial]] = {
    "head_on": [(speed, 0.0, mu, 0.0) for speed in (0.06, 0.1) for mu in WHEEL_FRICTIONS],
    "askew": [(0.1, angle, mu, 0.0) for angle in (0.3, 0.7) for mu in WHEEL_FRICTIONS],
    "backward": [(-0.1, angle, mu, 0.0) for angle in (0.0, 0.5) for mu in WHEEL_FRICTIONS],
    "delay_20": [(0.1, angle, mu, 0.02) for angle in (0.0, 0.5) for mu in WHEEL_FRICTIONS],
    "at_0.2": [(0.2, angle, mu, 0.0) for angle in (0.0, 0.5) for mu in WHEEL_FRICTIONS],
}


def creep_to_edge(
    controller: Locomotion, speed: float, angle: float, friction: float = 0.8, delay: float = 0.0
) -> bool:
    """Push on for 4 s after reaching the edge, then drive away: True when it stayed on top, said why, and got away."""
    axis = np.arange(-HALF_SIDE, HALF_SIDE + 1e-9, CELL_SIDE)
    x, y = np.meshgrid(axis, axis)
    beyond = (x - EDGE_X) * math.cos(angle) + y * math.sin(angle) > 0.0
    height = np.where(beyond, 0.0, EDGE_DEPTH).astype(np.float32)
    sim = Simulation(
        height,
        CELL_SIDE,
        (-HALF_SIDE, -HALF_SIDE),
        friction=friction,
        timestep=TIME_STEP,
        command_delay=delay,
    )
    sim.reset(START_X - 0.15 * math.tan(angle), 0.0, 0.0 if speed > 0.0 else math.pi)
    driver = Driver(sim, controller)
    turned_back = 0.5 + 0.3 / abs(speed) + 4.0
    nearest, said = START_X, ""
    while sim.time < turned_back + 2.0:
        vx = 0.0 if sim.time < 0.5 else speed if sim.time < turned_back else -speed
        driver.step(vx)
        nearest = max(nearest, float(sim.position[0]))
        said = said or controller.warning()
        if sim.rotation[2, 2] < TIPPED_COSINE or sim.position[2] < EDGE_DEPTH + 0.2:
            return False
    return said.startswith("cliff") and bool(sim.position[0] < nearest - 0.1)
