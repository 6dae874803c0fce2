"""The guard's rules for the planner: the same kernel on the planner's map, so that no path leads where the guard would hold the robot.

The planner knows the heights that are certain and bounds of those that are not. It knows neither the newest sweep nor how the robot will
be tilted: a track begins at the height of the first known ground under the body.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.go2w import HIP_Y, THIGH_Y, TREAD_WIDTH
from hal.go2w import TREAD_Y as TREAD
from hal.safety.swept import (
    BEFORE,
    FLAT,
    SPACING,
    Surroundings,
    reach_of,
    straight_tracks,
    turn_step,
    turn_tracks,
)
from hal.types import Array, Capabilities

AXLE, TREAD_Y = 0.21, HIP_Y + THIGH_Y + TREAD
"""Where the wheels stand in base_link [m]."""
TURN_FACE = 0.09
"""[m] Of turns on the spot with a bar of 6 cm and more under the robot half ended with a wheel at the bar (`docs/simulated_robot.md`); 3 cm are the noise
of the map."""

Pose = tuple[float, float, float]
"""x, y [m], yaw [rad] in `map`."""


def mapped(
    height: NDArray[np.float32],
    origin: tuple[float, float],
    resolution: float,
    bound: NDArray[np.float32] | None = None,
) -> Surroundings:
    """Ground of a map. `height` (rows, cols) [m], NaN where it is not certain; `bound` (rows, cols) [m], the ground is not above
    this, NaN where no ray tells; `origin` x, y [m] of the centre of cell [0, 0].
    """
    nothing = np.zeros(height.shape, np.uint8)
    bound = np.full_like(height, np.nan) if bound is None else bound
    return Surroundings(height, bound, nothing, nothing, origin, resolution)


def known_behind(around: Surroundings, pose: Pose, max_gap: float, reach: float) -> float:
    """How far [m], at most `reach`, a body at `pose` may back up on ground that the map knows."""
    # Nothing is too high, too low or too steep: what was seen counts, not what it is.
    robot = Capabilities("", max_step=math.inf, max_slope=0.0, max_gap=max_gap)
    tracks = _backward(reach + max_gap + 2.0 * around.resolution)  # a gap shows at its other end
    return min(reach_of(tracks, SPACING, around, pose, FLAT, robot, seen=True).free, reach)


def free_turn(
    around: Surroundings, pose: Pose, turn: float, robot: Capabilities, spare: float = 0.0
) -> float:
    """How far [rad], at most the size of `turn`, a body at `pose` may turn on the spot, to the left where `turn` is positive. Of `robot`
    counts what it drives over; `spare` [m] is kept on all sides of the body.
    """
    samples = BEFORE + math.ceil(abs(turn) / turn_step()) + 1
    tracks = np.ascontiguousarray(_turning(math.copysign(1.0, turn), spare)[:, :samples])
    found = reach_of(tracks, turn_step(), around, pose, FLAT, robot, seen=False)
    return min(found.free, abs(turn)) if found.kind else abs(turn)


def wheels_turn(around: Surroundings, pose: Pose, turn: float, max_slope: float) -> float:
    """How far [rad], at most the size of `turn`, a body at `pose` turns on the spot, to the left where `turn` is positive, before one of its
    wheels comes to a face above `TURN_FACE`. Ground may rise as steeply as `max_slope` [rad] besides.
    """
    steps = math.ceil(abs(turn) / turn_step())
    at = wheel_face(
        around.height,
        around.origin[0],
        around.origin[1],
        around.resolution,
        float(pose[0]),
        float(pose[1]),
        float(pose[2]),
        math.copysign(turn_step(), turn),
        steps,
        TURN_FACE,
        math.tan(max_slope),
    )
    return min(at * turn_step(), abs(turn))


@njit(cache=True)
def wheel_face(
    height, x0, y0, resolution, x, y, yaw, step, steps, limit, grade
):  # pragma: no cover - compiled
    """Number of steps of `step` [rad] after which a wheel meets a face of more than `limit` [m] within two cells, less what the ground rises by `grade`;
    `steps` where none does."""
    rows, cols = height.shape
    first = steps
    for wheel in range(12):
        u = AXLE if wheel % 2 == 0 else -AXLE
        v = TREAD_Y * (1.0 if wheel % 4 < 2 else -1.0) + 0.5 * TREAD_WIDTH * (wheel // 4 - 1)
        radius, angle = math.hypot(u, v), yaw + math.atan2(v, u)
        back = math.ceil(2.0 * resolution / (radius * abs(step)))
        ground = np.full(steps + 1, np.nan)
        for i in range(first + 1):
            a = angle + i * step
            col = math.floor((x + radius * math.cos(a) - x0) / resolution + 0.5)
            row = math.floor((y + radius * math.sin(a) - y0) / resolution + 0.5)
            if 0 <= row < rows and 0 <= col < cols:
                ground[i] = height[row, col]
            met = False
            for j in range(max(0, i - back), i):
                met |= ground[i] - ground[j] - grade * (i - j) * radius * abs(step) > limit
            if met:
                first = min(first, i)
                break
    return first


@lru_cache(maxsize=8)
def _backward(reach: float) -> Array:
    return straight_tracks(reach, -1.0)


@lru_cache(maxsize=4)
def _turning(sign: float, spare: float) -> Array:
    return turn_tracks(math.pi, sign, spare)
