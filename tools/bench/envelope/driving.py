"""Driving quality of a locomotion controller: a figure-eight on rolling ground, standing on a slope, cost."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from hal.types import PostureCommand, VelocityCommand
from planning.tracking.tracker import PathTracker, TrackerConfig, TrackPhase
from tools.bench.envelope.terrain import CELL_SIDE, course, rolling_ground
from tools.bench.envelope.trial import TIME_STEP, TIPPED_COSINE

DRIVE_SPEED = 0.5
"""[m/s]"""
TRACK_EVERY = 4
"""Ticks of `TIME_STEP` per step of the tracker: 50 Hz."""


@dataclass(frozen=True, slots=True)
class Ride:
    """A figure-eight."""

    rmse: float
    """Cross-track error [m]; infinite when the robot fell or did not arrive."""
    worst: float
    yaw_gain: float
    """Slope of the measured on the commanded yaw rate, both averaged over 0.24 s."""


def eight(size: float = 3.0, n: int = 900) -> np.ndarray:
    """(n, 2) lemniscate of Gerono [m], 2 * `size` long, `size` wide, from the crossing point back to it."""
    t = np.linspace(0.0, 2.0 * np.pi, n)
    return np.column_stack([size * np.sin(t), size * np.sin(t) * np.cos(t)])


def figure_eight(controller: Locomotion) -> Ride:
    """Follow the eight over rolling ground at 0.5 m/s with the project's tracker on the true pose."""
    height, origin = rolling_ground()
    sim = Simulation(height, CELL_SIDE, origin, timestep=TIME_STEP)
    points = eight()
    direction = points[1] - points[0]
    sim.reset(0.0, 0.0, float(np.arctan2(direction[1], direction[0])))
    driver = Driver(sim, controller)
    tracker = PathTracker(TrackerConfig(max_speed=DRIVE_SPEED))
    tracker.set_path(points, None, DRIVE_SPEED)
    command = 0.0, 0.0
    errors: list[float] = []
    wanted: list[float] = []
    got: list[float] = []
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    for tick in range(round(3.0 * length / DRIVE_SPEED / TIME_STEP)):
        rot = sim.rotation
        if rot[2, 2] < TIPPED_COSINE:
            break
        if tick % TRACK_EVERY == 0 and sim.time > 0.5:
            x, y, _ = sim.position
            yaw_rate = float(rot[2] @ sim.angular_velocity)
            out = tracker.step(
                round(sim.time * 1e9), float(x), float(y), sim.yaw, float(sim.linear_velocity[0]), yaw_rate
            )
            if out.phase is TrackPhase.FOLLOWING:
                errors.append(out.cross_track)
                wanted.append(out.wz)
                got.append(yaw_rate)
            elif out.phase is TrackPhase.DONE:
                break
            command = out.vx, out.wz
        driver.step(*command)
    else:
        return Ride(np.inf, np.inf, np.nan)
    if len(errors) < 100 or sim.rotation[2, 2] < TIPPED_COSINE:
        return Ride(np.inf, np.inf, np.nan)
    k = 12
    mean_wanted, mean_got = (np.convolve(v, np.ones(k) / k, "valid")[::k] for v in (wanted, got))
    gain = float(mean_wanted @ mean_got / (mean_wanted @ mean_wanted))
    e = np.array(errors)
    return Ride(float(np.sqrt(np.mean(e**2))), float(np.abs(e).max()), gain)


def hold_on_slope(controller: Locomotion, degrees: int = 20, seconds: float = 30.0) -> float:
    """Furthest drift [m] of the trunk within `seconds` of zero command, uphill and across the slope.

    The first two seconds belong to the robot: it takes its posture.
    """
    worst = 0.0
    for kind, x, y in (("ramp_up", 1.9, 0.0), ("cross_slope", 2.2, 0.0)):
        ground = course(f"{kind}_{degrees}")
        sim = Simulation(ground.height, CELL_SIDE, ground.origin, timestep=TIME_STEP)
        sim.reset(x, y)
        driver = Driver(sim, controller)
        driver.settle(2.0)
        start = sim.position
        for tick in range(round(seconds / TIME_STEP)):
            driver.step()
            if tick % 100 == 0:
                worst = max(worst, float(np.linalg.norm(sim.position - start)))
    return worst


def stopping_time(
    controller: Locomotion, speed: float, yaw_rate: float = 0.0, degrees: float = 0.0, friction: float = 0.8
) -> float:
    """Seconds from the first zero command until the trunk is slower than 0.05 m/s for good (watched for 1.5 s).

    The robot drives at `speed` [m/s] along +x, downhill where `degrees` > 0, for the last second with `yaw_rate`
    [rad/s].
    """
    axis = np.arange(round(10.0 / CELL_SIDE)) * CELL_SIDE - 5.0
    height = np.broadcast_to(-np.tan(np.radians(degrees)) * axis, (axis.size, axis.size)).astype(np.float32)
    sim = Simulation(height, CELL_SIDE, (-5.0, -5.0), friction=friction, timestep=TIME_STEP)
    sim.reset()
    driver = Driver(sim, controller)
    driven = 2.5
    moving = 0.0
    while sim.time < driven + 1.5:
        wz = float(np.clip(-2.0 * sim.yaw, -0.8, 0.8)) if sim.time < driven - 1.0 else yaw_rate
        driver.step(*((speed, wz) if 0.4 < sim.time < driven else (0.0, 0.0)))
        if sim.rotation[2, 2] < TIPPED_COSINE:
            return np.inf
        if sim.time > driven and np.linalg.norm(sim.linear_velocity) >= 0.05:
            moving = sim.time - driven
    return moving


def real_time_factor(controller: Locomotion, seconds: float = 6.0) -> tuple[float, float, float]:
    """Simulated over processor time at 5 ms on 500 x 500 cells: physics with the controller, physics alone. Best of
    three.

    The third figure is the processor time of one control tick [s], state and command included.
    """
    height, origin = rolling_ground()
    sim = Simulation(height, CELL_SIDE, origin, timestep=TIME_STEP)
    best, tick = [0.0, 0.0], np.inf
    for _ in range(3):
        sim.reset()
        controller.reset()
        physics = 0
        start = time.thread_time_ns()
        for _ in range(round(seconds / TIME_STEP)):
            sim.apply(controller.step(sim.low_state(), VelocityCommand(0, 0.4, 0.0, 0.3), PostureCommand(0)))
            before = time.thread_time_ns()
            sim.step()
            physics += time.thread_time_ns() - before
        total = time.thread_time_ns() - start
        best = [max(best[0], seconds * 1e9 / total), max(best[1], seconds * 1e9 / physics)]
        tick = min(tick, 1e-9 * (total - physics) / round(seconds / TIME_STEP))
    return best[0], best[1], tick
