"""One drive of one controller over one course of the envelope."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hal.lowlevel import Locomotion, LowState
from hal.mujoco.driver import Driver
from hal.mujoco.robot import Simulated
from hal.mujoco.sim import Simulation
from tools.bench.envelope.terrain import CELL_SIDE, course

TIME_STEP = 0.005
RUNS = (
    (0.6, (0.0, 0.0, 0.0)),
    (0.8, (-0.07, 0.05, 0.05)),
    (1.0, (-0.13, -0.05, -0.05)),
)
"""Wheel friction and start offset x, y [m], yaw [rad] of the three runs of a cell."""
TIPPED_COSINE = 0.5
"""Cosine of the trunk's tilt below which the robot has tipped over (60 degrees)."""
AIM_DISTANCE = 0.7
"""The heading loop aims this far ahead [m] on the line y = 0: on a steep side slope rolling wheels creep downhill."""
MAX_ASIDE = 0.6
"""Furthest from the line y = 0 [m]."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What is changed from the nominal drive."""

    speed: float = 0.5
    delay: float = 0.0
    """Between LowState and actuation [s]."""
    noise: bool = False
    payload: float = 0.0
    friction: float | None = None
    """Instead of the run's own."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a drive ended."""

    passed: bool
    tipped: bool
    reason: str
    x: float
    time: float
    pitch95: float
    """95th percentile of |pitch| [rad]."""


def noisy(state: LowState, rng: np.random.Generator) -> LowState:
    """Encoder, attitude and gyro noise of a good legged robot."""
    half = rng.normal(0.0, 0.005, 3) * 0.5
    quaternion = state.quaternion + np.array(
        [
            -half @ state.quaternion[1:],
            *(half * state.quaternion[0] + np.cross(state.quaternion[1:], half)),
        ]
    )
    return replace(
        state,
        q=state.q + rng.normal(0.0, 0.003, 16),
        dq=state.dq + rng.normal(0.0, 0.15, 16),
        tau=state.tau + rng.normal(0.0, 0.3, 16),
        quaternion=quaternion / np.linalg.norm(quaternion),
        gyro=state.gyro + rng.normal(0.0, 0.03, 3),
    )


def steering(aside: ArrayLike, yaw: ArrayLike) -> NDArray[np.float64]:
    """Yaw rate [rad/s] of robots `aside` of the line they drive along [m], with heading `yaw` to it [rad]; any
    shape."""
    off = np.arctan2(-np.asarray(aside, np.float64), AIM_DISTANCE) - np.asarray(yaw, np.float64)
    return np.clip(2.0 * off, -0.8, 0.8)


def drive(
    controller: Locomotion,
    name: str,
    run: int,
    conditions: Conditions | None = None,
    robot: Simulated | None = None,
) -> Outcome:
    """Drive course `name` along y = 0, steered by the true pose, every course by the same law. `robot`: None takes the
    default one."""
    c = conditions or Conditions()
    ground = course(name, run)
    friction, (x0, y0, yaw0) = RUNS[run]
    sim = Simulation(
        ground.height,
        CELL_SIDE,
        ground.origin,
        friction=friction if c.friction is None else c.friction,
        timestep=TIME_STEP,
        payload=c.payload,
        command_delay=c.delay,
        robot=robot,
    )
    sim.reset(x0, y0, yaw0)
    rng = np.random.default_rng(run)
    driver = Driver(sim, controller, (lambda state: noisy(state, rng)) if c.noise else None)
    limit = 1.0 + 3.0 * (ground.finish - x0) / c.speed
    pitches = []
    tick = 0
    while sim.time < limit:
        wz = float(steering(sim.position[1], sim.yaw))
        driver.step(*((c.speed, wz) if sim.time >= 0.5 else (0.0, 0.0)))
        tick += 1
        if tick % 4 == 0:
            x, y, _ = sim.position
            rot = sim.rotation
            pitches.append(abs(np.arcsin(np.clip(rot[2, 0], -1.0, 1.0))))
            reason = ""
            if rot[2, 2] < TIPPED_COSINE:
                reason = "tipped"
            elif abs(y) > MAX_ASIDE:
                reason = "left the corridor"
            elif x > ground.finish:
                reason = "passed"
            if reason:
                return Outcome(
                    reason == "passed",
                    reason == "tipped",
                    reason,
                    float(x),
                    sim.time,
                    float(np.percentile(pitches, 95)),
                )
    return Outcome(
        False, False, "out of time", float(sim.position[0]), sim.time, float(np.percentile(pitches, 95))
    )
