"""The guard's rules for the planner: the same kernel on the planner's map, so no path leads where the guard would
hold the robot.

The planner knows certain heights, and bounds of uncertain ones. It knows neither the newest sweep nor the future tilt
of the robot: a track begins at the height of the first known ground under the body."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hal.safety.swept import (
    FLAT,
    SAMPLES_BEFORE,
    TRACK_SPACING,
    Body,
    Surroundings,
    reach_of,
    straight_tracks,
    turn_step,
    turn_tracks,
)
from hal.types import Array, Capabilities

Pose = tuple[float, float, float]
"""x, y [m], yaw [rad] in `map`."""


def mapped(
    height: NDArray[np.float32],
    origin: tuple[float, float],
    resolution: float,
    bound: NDArray[np.float32] | None = None,
) -> Surroundings:
    """Ground of a map. `height` (rows, cols) [m], NaN where it is not certain; `bound` (rows, cols) [m], the ground
    is not above this, NaN where no ray tells; `origin` x, y [m] of the centre of cell [0, 0]."""
    nothing = np.zeros(height.shape, np.uint8)
    bound = np.full_like(height, np.nan) if bound is None else bound
    certain = np.zeros(height.shape, np.float32)
    return Surroundings(height, bound, nothing, nothing, certain, origin, resolution)


def known_behind(around: Surroundings, pose: Pose, body: Body, max_gap: float, reach: float) -> float:
    """How far [m], at most `reach`, a `body` at `pose` may back up on ground that the map knows."""
    # Nothing is too high, too low or too steep: what was seen counts, not what it is.
    robot = Capabilities("", max_step=math.inf, max_slope=0.0, max_gap=max_gap)
    tracks = _backward(body, reach + max_gap + 2.0 * around.resolution)  # a gap shows at its other end
    return min(reach_of(tracks, TRACK_SPACING, around, pose, FLAT, robot, seen=True).free, reach)


def free_turn(
    around: Surroundings, pose: Pose, turn: float, robot: Capabilities, spare: float = 0.0
) -> float:
    """How far [rad], at most the size of `turn`, a body at `pose` may turn on the spot, to the left if `turn` is
    positive. Of `robot` counts what it drives over; `spare` [m] is kept on all sides of the body."""
    body = Body.of(robot)
    samples = SAMPLES_BEFORE + math.ceil(abs(turn) / turn_step(body)) + 1
    tracks = np.ascontiguousarray(_turning(body, math.copysign(1.0, turn), spare)[:, :samples])
    found = reach_of(tracks, turn_step(body), around, pose, FLAT, robot, seen=False)
    return min(found.free, abs(turn)) if found.kind else abs(turn)


@lru_cache(maxsize=8)
def _backward(body: Body, reach: float) -> Array:
    return straight_tracks(reach, -1.0, body)


@lru_cache(maxsize=4)
def _turning(body: Body, sign: float, spare: float) -> Array:
    return turn_tracks(math.pi, sign, body, spare=spare)
