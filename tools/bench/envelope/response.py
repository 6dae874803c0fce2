"""Response of a controller to slow commands: deadband and gain, along the body and in turns on the spot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from hal.rotation import wrap
from tools.bench.envelope.trial import TIME_STEP

COMMANDED_SPEEDS = (0.03, 0.06, 0.09, 0.12, 0.16, 0.2, 0.3, 0.5)
"""[m/s]"""
COMMANDED_RATES = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.8)
"""[rad/s]"""
WHEEL_FRICTIONS = (0.5, 0.8)
DRIVING_SPEED = 0.3
"""[m/s] while turns are asked for on the way."""
SETTLE_TIME, MEASURE_TIME = 1.0, 2.5
"""[s] after the command that are not looked at, and that are."""
EFFECT_SHARE = 0.5
"""Least share of a command that counts as an effect."""


@dataclass(frozen=True, slots=True)
class Response:
    """Of one kind of command, worst of both directions and frictions."""

    deadband: float
    """Smallest command from which on every one has an effect; infinite when the largest has none."""
    gain: float
    """Share of the largest command that is followed."""


def followed(controller: Locomotion, vx: float, wz: float, friction: float) -> tuple[float, float]:
    """Mean speed [m/s] and yaw rate [rad/s] on level ground under a steady command."""
    sim = Simulation(
        np.zeros((120, 120), np.float32), 0.1, (-6.0, -6.0), friction=friction, timestep=TIME_STEP
    )
    sim.reset()
    driver = Driver(sim, controller)
    along = turned = 0.0
    for _ in range(round((0.5 + SETTLE_TIME + MEASURE_TIME) / TIME_STEP)):
        before = sim.yaw
        driver.step(*((vx, wz) if sim.time >= 0.5 else (0.0, 0.0)))
        if sim.time > 0.5 + SETTLE_TIME:
            along += float(sim.linear_velocity[0]) * TIME_STEP
            turned += wrap(sim.yaw - before)
    return along / MEASURE_TIME, turned / MEASURE_TIME


def _response(share: dict[float, float]) -> Response:
    """From the least followed share of each command."""
    deadband = float("inf")
    for command in sorted(share, reverse=True):
        if share[command] < EFFECT_SHARE:
            break
        deadband = command
    return Response(deadband, share[max(share)])


def along(controller: Locomotion) -> Response:
    """Forward and backward."""
    return _response(
        {
            v: min(followed(controller, s * v, 0.0, f)[0] / (s * v) for s in (1, -1) for f in WHEEL_FRICTIONS)
            for v in COMMANDED_SPEEDS
        }
    )


def turning(controller: Locomotion, speed: float = 0.0) -> Response:
    """To both sides, on the spot or while driving at `speed` [m/s]."""
    return _response(
        {
            w: min(
                followed(controller, speed, s * w, f)[1] / (s * w) for s in (1, -1) for f in WHEEL_FRICTIONS
            )
            for w in COMMANDED_RATES
        }
    )


def turning_while_driving(controller: Locomotion) -> Response:
    """To both sides on the way, at `DRIVING_SPEED`."""
    return turning(controller, DRIVING_SPEED)
