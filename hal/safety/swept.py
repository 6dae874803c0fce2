"""How far the body can go before it meets what it cannot drive over: forward, backward, turning left and right.

Every point of the body's rim that leads a motion draws a track over the height map. Along a track the ground may rise and fall
by no more than a step within two cells. Behind cells that are missing it may have risen as the steepest slope does; where it
lies lower by more than a step, the drop is taken to begin at the last ground that is known. A gap in the ground may be as wide as a
wheel crosses. What lies under the body now, a kerb or an edge, is no obstacle. Ground that was never seen is none either,
unless a ray has shown that it lies lower.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.go2w import BODY_LENGTH, BODY_WIDTH
from hal.types import Array, Capabilities

SPACING = 0.02
"""[m] between tracks and between the samples of one: half a cell of the map."""
BEFORE = 4
"""Samples of a track under the body, for the height it begins with."""
WITHIN = 4
"""Samples over which a face may spread: two cells of the map."""
NOISE = 0.04
"""[m] that a face on the map may be higher than the true one: a little more than the planner lets a way it found rise."""
BODY_CLEARANCE = 0.55
"""[m] above the ground: what hangs higher does not touch the robot."""
POINTS = 3
"""Returns in one cell that count as something there."""

CLEAR, FACE, DROP, SWEEP = 0, 1, 2, 3
"""What ends a track: nothing, ground that is too high, ground that is too low, points of the newest sweep."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """The ground around the robot on a lattice, frame `map`. Row grows with y, column with x."""

    height: NDArray[np.float32]
    """(rows, cols) [m]; NaN where it is not certain."""
    bound: NDArray[np.float32]
    """(rows, cols) [m] the ground is not above this; NaN where no ray tells."""
    occupied: NDArray[np.uint8]
    """(rows, cols) 1 where the newest sweep has something that stands on the ground."""
    origin: tuple[float, float]
    """x, y [m] of the centre of cell [0, 0]."""
    resolution: float


@dataclass(frozen=True, slots=True)
class Reach:
    """How far a motion goes until the body meets something, and what that is."""

    free: float
    """[m], or [rad] of a turn; as far as was looked where nothing is in the way."""
    kind: int = CLEAR
    height: float = 0.0
    """Height of the face or depth of the drop [m]."""


def straight_tracks(reach: float, sign: float) -> Array:
    """(tracks, samples, 2) x, y [m] in base_link of the end of the body that leads; `sign` 1.0 forward, -1.0 backward."""
    across = _spaced(-BODY_WIDTH / 2, BODY_WIDTH / 2)
    along = sign * (BODY_LENGTH / 2 + SPACING * np.arange(-BEFORE, math.ceil(reach / SPACING) + 1))
    x, y = np.broadcast_arrays(along[None, :], across[:, None])
    return np.stack([x, y], axis=2)


def turn_tracks(reach: float, sign: float) -> Array:
    """(tracks, samples, 2) of the parts of the rim that lead a turn; `sign` 1.0 left, -1.0 right."""
    length, width = BODY_LENGTH / 2, BODY_WIDTH / 2
    front, side = _spaced(-width, 0.0), _spaced(0.0, length)
    rim = np.concatenate(
        [
            np.column_stack([np.full_like(front, length), front]),
            np.column_stack([side, np.full_like(side, width)]),
        ]
    )
    rim = np.concatenate([rim, -rim])
    angle = turn_step() * np.arange(math.ceil(reach / turn_step()) + 1)
    c, s = np.cos(angle), np.sin(angle)
    swept = np.stack([rim[:, :1] * c - rim[:, 1:] * s, rim[:, :1] * s + rim[:, 1:] * c], axis=2)
    inwards = SPACING / np.hypot(rim[:, 0], rim[:, 1])[:, None, None]
    under = rim[:, None, :] * (1.0 - inwards * np.arange(BEFORE, 0, -1)[:, None])
    return np.concatenate([under, swept], axis=1) * (1.0, sign)


def turn_step() -> float:
    """[rad] between two samples of a turn: the corners of the body move by SPACING."""
    return SPACING / math.hypot(BODY_LENGTH / 2, BODY_WIDTH / 2)


def _spaced(low: float, high: float) -> Array:
    return np.linspace(low, high, math.ceil((high - low) / SPACING - 1e-9) + 1)


def reach_of(
    tracks: Array, step: float, around: Surroundings, pose: tuple[float, float, float], robot: Capabilities
) -> Reach:
    """How far the body goes along `tracks`, samples `step` [m or rad] apart, from `pose` x, y [m], yaw [rad] in `map`."""
    sample, kind, height = nearest_obstacle(
        tracks,
        around.height,
        around.bound,
        around.occupied,
        around.origin[0],
        around.origin[1],
        around.resolution,
        float(pose[0]),
        float(pose[1]),
        float(pose[2]),
        robot.max_step + NOISE,
        math.tan(robot.max_slope) * SPACING,
        math.ceil((robot.max_gap + around.resolution) / SPACING),
    )
    return Reach(max(0.0, (sample - BEFORE - 1) * step), kind, height)


@njit(cache=True)
def nearest_obstacle(
    tracks, height, bound, occupied, x0, y0, resolution, x, y, yaw, limit, rise, gap
):  # pragma: no cover - compiled
    """Sample of the first obstacle on any track, what it is, and its height [m]; the number of samples where there is none.

    `limit` [m]: highest face; `rise` [m]: what the steepest slope rises from sample to sample; `gap`: samples a gap may span.
    """
    rows, cols = height.shape
    count, samples = tracks.shape[0], tracks.shape[1]
    c, s = math.cos(yaw), math.sin(yaw)
    first, kind, size = samples, CLEAR, 0.0
    ground = np.empty(samples)
    low = np.empty(samples, np.bool_)
    busy = np.empty(samples, np.bool_)
    for k in range(count):
        for i in range(first):
            u, v = tracks[k, i, 0], tracks[k, i, 1]
            col = math.floor((x + c * u - s * v - x0) / resolution + 0.5)
            row = math.floor((y + s * u + c * v - y0) / resolution + 0.5)
            ground[i], low[i], busy[i] = np.nan, False, False
            if 0 <= row < rows and 0 <= col < cols:
                ground[i] = height[row, col]
                busy[i] = occupied[row, col] > 0
                if math.isnan(ground[i]):
                    ground[i] = bound[row, col]
                    low[i] = True
        last = -1  # newest sample whose ground is known
        landed = 0  # behind a gap: what lies in it is not driven on
        i = 0
        while i < first:
            if busy[i] and i > BEFORE:
                first, kind, size = i, SWEEP, 0.0
                break
            if math.isnan(ground[i]) or (low[i] and (last < 0 or ground[i] >= ground[last] - limit)):
                i += 1
                continue
            # Compare with everything known within the spread of a face, else with the last known ground.
            worst = 0.0
            if last >= 0:
                worst = ground[i] - ground[last]
                if worst > 0.0:
                    worst = max(0.0, worst - rise * max(0, i - last - WITHIN // 2))
                for j in range(max(landed, i - WITHIN), last):
                    if not low[j] and not math.isnan(ground[j]):
                        other = ground[i] - ground[j]
                        other = math.copysign(max(0.0, abs(other) - rise * WITHIN / 2), other)
                        if abs(other) > abs(worst):
                            worst = other
            if abs(worst) > limit and i <= BEFORE:
                low[i] = (
                    True  # a wall beside the body that the map shows a cell too near: nothing stands on it
                )
                i += 1
                continue
            if abs(worst) > limit:
                across = -1
                if worst < 0.0:
                    for j in range(i + 1, min(first, last + 1 + gap + 1)):
                        if (
                            not low[j]
                            and not math.isnan(ground[j])
                            and abs(ground[j] - ground[last]) <= limit
                        ):
                            across = j
                            break
                if across >= 0:
                    last, landed, i = across, across, across + 1
                    continue
                if worst > 0.0:
                    first, kind, size = i, FACE, worst
                else:
                    first, kind, size = min(i, max(last + 1, BEFORE + 1)), DROP, -worst
                break
            if not low[i]:
                last = i
            i += 1
    return first, kind, size


@njit(cache=True)
def occupy(points, ground, x0, y0, resolution, lowest, highest, least, out):  # pragma: no cover - compiled
    """Set `out` (rows, cols) to 1 where at least `least` of the points (n, 3) [m] in `map` stand on the ground.

    A point stands on it when it is `lowest` to `highest` [m] above `ground` (rows, cols), which has no NaN.
    """
    rows, cols = ground.shape
    count = np.zeros((rows, cols), np.int32)
    for i in range(points.shape[0]):
        col = math.floor((points[i, 0] - x0) / resolution + 0.5)
        row = math.floor((points[i, 1] - y0) / resolution + 0.5)
        if 0 <= row < rows and 0 <= col < cols:
            above = points[i, 2] - ground[row, col]
            if lowest < above < highest:
                count[row, col] += 1
    for row in range(rows):
        for col in range(cols):
            out[row, col] = 1 if count[row, col] >= least else 0
