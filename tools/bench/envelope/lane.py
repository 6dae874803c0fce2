"""Driving through rescue lanes along their middle with the project's tracker on the true pose, without map and planner.

What lanes ask of a controller and single obstacles do not: short run-ups, bends astride faces, headings that are off,
standing
against a face while the tracker steers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hal.lowlevel import Locomotion
from hal.mujoco.driver import Driver
from hal.mujoco.sim import Simulation
from hal.scenes.lanes import lane
from hal.types import Array
from planning.tracking.tracker import PathTracker, TrackerConfig, TrackPhase
from tools.bench.envelope.trial import TIME_STEP, TIPPED_COSINE

LANE_SEEDS = tuple(range(100, 124, 4))
"""Seeds of lanes in the layout `single`, for work."""
WEAVE_WAYS = ((0.4, 0.10, 1.0), (0.3, -0.08, 2.5))
"""Speed [m/s], and amplitude [m] and phase [rad] of a weave of 2.4 m, as a planned path weaves: headings to 0.26 rad
off."""
TRACK_EVERY = 4
"""Ticks of `TIME_STEP` per step of the tracker: 50 Hz."""
STUCK_AFTER = 5.0
"""Time [s] without progress that ends a drive."""


@dataclass(frozen=True, slots=True)
class Passage:
    """How a drive through a lane ended."""

    passed: bool
    tipped: bool
    seconds: float
    tilt: float
    """Greatest tilt of the trunk [deg]."""


def weaving(line: Array, amplitude: float, phase: float) -> Array:
    """(n, 2) way along the corners `line` (m, 2) of a single lane; it weaves where it does not pass beside a wall."""
    x = np.arange(line[0, 0], line[-1, 0], 0.05)
    middle = np.interp(x, line[:, 0] + 1e-6 * np.arange(len(line)), line[:, 1])
    beside = np.convolve(np.pad(np.abs(middle) > 0.02, 10, "edge").astype(float), np.ones(21), "valid") > 0.0
    weave = amplitude * np.sin(2.0 * np.pi * (x - x[0]) / 2.4 + phase) * np.clip(2.0 * (x - x[0]), 0.0, 1.0)
    y = np.pad(np.where(beside, middle, middle + weave), 8, "edge")
    return np.column_stack([x, np.convolve(y, np.ones(17) / 17, "valid")])


def through_lane(
    controller: Locomotion,
    seed: int,
    kind: str,
    way: tuple[float, float, float],
    envelope: str = "vmc",
    level: int = 4,
) -> Passage:
    """Drive the lane of a seed with the layout `single`, made of `kind`, graded for `envelope`."""
    speed, amplitude, phase = way
    one = lane(seed, level=level, controller=envelope, map=kind)
    points = weaving(one.line, amplitude, phase)
    sim = Simulation(one.scene.height, one.scene.resolution, one.scene.origin, timestep=TIME_STEP)
    (x, y), (dx, dy) = points[0], points[1] - points[0]
    sim.reset(float(x), float(y), float(np.arctan2(dy, dx)))
    driver = Driver(sim, controller)
    driver.settle(0.5)
    tracker = PathTracker(TrackerConfig(max_speed=speed))
    tracker.set_path(points, None, speed)
    began = moved = sim.time
    place, furthest, tilt, v = sim.position, points[0, 0], 0.0, 0.0
    while sim.time - moved < STUCK_AFTER:
        rot = sim.rotation
        tilt = max(tilt, float(np.degrees(np.arccos(min(rot[2, 2], 1.0)))))
        if rot[2, 2] < TIPPED_COSINE:
            return Passage(False, True, sim.time - began, tilt)
        at, before = sim.position, place
        v += 0.3 * (float((at - before) @ rot[:, 0]) / (TRACK_EVERY * TIME_STEP) - v)
        out = tracker.step(round(sim.time * 1e9), at[0], at[1], sim.yaw, v, float(sim.low_state().gyro[2]))
        if out.phase is TrackPhase.DONE:
            return Passage(True, False, sim.time - began, tilt)
        place = at
        if at[0] > furthest + 0.02:
            furthest, moved = at[0], sim.time
        for _ in range(TRACK_EVERY):
            driver.step(out.vx, out.wz)
    return Passage(False, False, sim.time - began, tilt)
