"""Turning on the spot where it is dangerous, astride a bar, and where it is hard, on a ramp."""

from __future__ import annotations

import math

import numpy as np

from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from hal.rotation import wrap
from tools.bench.envelope.terrain import CELL_SIDE
from tools.bench.envelope.trial import TIME_STEP, TIPPED_COSINE

TURN_RATE = 0.8
"""[rad/s]"""
TURNING_TIME, LEAVING_TIME = 10.5, 3.0
"""How long it turns, and then drives off [s]."""
LEAVING_COMMAND = (0.5, 0.0)
"""Speed [m/s] and yaw rate [rad/s] of driving off."""
CURVING_TIME = 3.5
"""How long it turns before it drives off in a curve [s]: long enough to be held by the bar."""
CURVE_COMMANDS = ((0.4, TURN_RATE), (0.4, -TURN_RATE))
"""Speed [m/s] and yaw rate [rad/s, the way it turned positive] of driving off in a curve."""
PLACES = tuple((at, angle, way) for at in (-0.2, 0.0, 0.2) for angle in (0.0, 0.785, 1.3) for way in (1, -1))
"""Offset [m] and angle [rad] of the bar's middle line to the robot, and the turning direction of the 18 trials."""
HALF_SIDE = 2.5
"""Half the side of the ground [m]."""


def _ground() -> tuple[np.ndarray, np.ndarray]:
    axis = np.arange(-HALF_SIDE, HALF_SIDE + 1e-9, CELL_SIDE)
    x, y = np.meshgrid(axis, axis)
    return x, y


def _drive(driver: Driver, vx: float, wz: float) -> bool:
    """One tick; False when the robot has tipped."""
    driver.step(vx, wz)
    return bool(driver.simulation.rotation[2, 2] >= TIPPED_COSINE)


def turn_on_bar(
    controller: Locomotion,
    height: float,
    at: float,
    angle: float,
    way: int,
    friction: float = 0.8,
    turning: float = TURNING_TIME,
    off: tuple[float, float] = LEAVING_COMMAND,
) -> tuple[str, float]:
    """Drive onto a bar of `height` [m] and 0.1 m width, turn there, drive off: when it tipped over, angle turned [rad].

    It tipped "arriving", "turning", "leaving" or never, which is "".

    `at` [m] and `angle` [rad]: where the bar's middle line passes the place of turning; `way`: +1 left, -1 right;
    `turning` [s]; `off`: how it drives off, speed [m/s] and yaw rate [rad/s, the way it turned positive].
    """
    x, y = _ground()
    z = np.where(np.abs(x * math.cos(angle) + y * math.sin(angle) - at) < 0.05, height, 0.0).astype(
        np.float32
    )
    sim = Simulation(z, CELL_SIDE, (-HALF_SIDE, -HALF_SIDE), friction=friction, timestep=TIME_STEP)
    sim.reset(-1.0)
    driver = Driver(sim, controller)
    while sim.time < 0.5:
        if not _drive(driver, 0.0, 0.0):
            return "arriving", 0.0
    while sim.position[0] < 0.0 and sim.time < 8.0:
        if not _drive(driver, 0.5, float(np.clip(-2.0 * (sim.yaw + sim.position[1]), -0.6, 0.6))):
            return "arriving", 0.0
    turned = 0.0
    end = sim.time + turning
    while sim.time < end:
        before = sim.yaw
        if not _drive(driver, 0.0, way * TURN_RATE):
            return "turning", way * turned
        turned += wrap(sim.yaw - before)
    end = sim.time + LEAVING_TIME
    while sim.time < end and np.abs(sim.position[:2]).max() < HALF_SIDE - 0.6:
        if not _drive(driver, off[0], way * off[1]):
            return "leaving", way * turned
    return "", way * turned


def turn_on_ramp(controller: Locomotion, degrees: float, way: int, seconds: float = 8.0) -> float:
    """Share of the commanded angle that the robot turns on a ramp within `seconds`; zero when it tips over."""
    x, _ = _ground()
    z = (math.tan(math.radians(degrees)) * x).astype(np.float32)
    sim = Simulation(z, CELL_SIDE, (-HALF_SIDE, -HALF_SIDE), friction=0.8, timestep=TIME_STEP)
    sim.reset()
    driver = Driver(sim, controller)
    turned = 0.0
    while sim.time < 0.5 + seconds:
        before = sim.yaw
        if not _drive(driver, 0.0, way * TURN_RATE if sim.time >= 0.5 else 0.0):
            return 0.0
        turned += wrap(sim.yaw - before)
    return way * turned / (TURN_RATE * seconds)
