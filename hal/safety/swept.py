"""How far the body can go before it meets what it cannot drive over: forward, backward, turning left and right.

Every point of the body's rim that leads a motion draws a track over the height map. It begins on the ground that the
robot stands on. Along a track the ground may rise and fall by no more than a step within two cells. Behind cells that
are missing it may have risen as the steepest slope does. Where it lies lower by more than a step, the drop begins
behind the last ground that the map knows. The guard lets the robot back up on ground that the map knows alone. What the
wheels felt makes neither a face nor a drop: a lifted wheel feels ground where there is none. A gap in the ground may be
as wide as a wheel crosses; behind its rim, ground at the height of the other rim is no face, however deep the map shows
what lies between. What lies under the body now, a kerb or an edge, is no obstacle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.kernels import inlined, select
from hal.raster import cell_of
from hal.types import Array, Capabilities

TRACK_SPACING = 0.02
"""[m] between tracks and between the samples of one: half a cell of the map."""
SAMPLES_BEFORE = 8
"""Samples of a track under the body, for the height it begins with: more than a gap spans, so that a gap under the
front has its rim on the track."""
FACE_SAMPLES = 4
"""Samples over which a face may spread: two cells of the map."""
FACE_NOISE = 0.04
"""[m] that a face on the map may be higher than the true one: a little more than the planner lets a way it found rise.
"""
NOISE_SIGMAS, MOST_NOISE = 3.0, 0.08
"""A difference of two cells is noise where it is less than so many of its standard deviations and less than so much
[m]: a height that one point of a LiDAR told is as uncertain as that point."""
BODY_CLEARANCE = 0.55
"""[m] above the ground: what hangs higher does not touch the robot."""
LEAST_POINTS = 3
"""Returns in one cell that count as something there."""

WHEELS, LIDAR, PLANTS, TOUCHED, HOLE = 1, 2, 5, 6, 7
"""Where the height of a cell comes from: felt by the wheels and taken for granted around them, measured, ground under
leaves, touched by the body, a hole that is measured from rim to rim and wider than the robot crosses (then the height
counts for nothing); else filled in between."""

CLEAR, FACE, DROP, SWEEP, UNSEEN, GAP = 0, 1, 2, 3, 4, 5
"""What ends a track: nothing, ground that is too high, ground that is too low, points of the newest sweep, ground
nobody saw, a hole that is too wide."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """The ground around the robot on a lattice, frame `map`. Row grows with y, column with x."""

    height: NDArray[np.float32]
    """(rows, cols) [m]; NaN where it is not certain."""
    bound: NDArray[np.float32]
    """(rows, cols) [m] the ground is not above this; NaN where no ray tells."""
    source: NDArray[np.uint8]
    """(rows, cols) where the height comes from: WHEELS, LIDAR, PLANTS or another."""
    occupied: NDArray[np.uint8]
    """(rows, cols) 1 where the newest sweep has something that stands on the ground."""
    variance: NDArray[np.float32]
    """(rows, cols) of a measured height [m^2]; 0 where none was measured."""
    origin: tuple[float, float]
    """x, y [m] of the centre of cell [0, 0]."""
    resolution: float

    def holds(self, x: float, y: float) -> bool:
        """Whether a place [m] lies on the lattice."""
        rows, cols = self.height.shape
        col, row = (x - self.origin[0]) / self.resolution, (y - self.origin[1]) / self.resolution
        return 0.0 <= col <= cols - 1 and 0.0 <= row <= rows - 1


@dataclass(frozen=True, slots=True)
class Reach:
    """How far a motion goes until the body meets something, and what that is."""

    free: float
    """[m], or [rad] of a turn; as far as was looked where nothing is in the way."""
    kind: int = CLEAR
    height: float = 0.0
    """Height of the face or depth of the drop [m]."""


class Body(NamedTuple):
    """How far the body reaches from base_link [m]."""

    front: float
    back: float
    left: float
    right: float

    @classmethod
    def of(cls, robot: Capabilities) -> Body:
        """The whole body of a robot."""
        return cls(robot.length / 2, robot.length / 2, robot.width / 2, robot.width / 2)

    @property
    def corner(self) -> float:
        """From base_link to the front left corner [m]."""
        return math.hypot(self.front, self.left)

    def grown(self, by: float) -> Body:
        """Larger by as much on each side [m]."""
        return Body(*(end + by for end in self))

    def clipped(self, rim: Array) -> Array:
        """Points (n, 2) [m] that lie outside of it, moved to its rim."""
        return np.clip(rim, (-self.back, -self.right), (self.front, self.left))


def straight_tracks(reach: float, sign: float, whole: Body, part: Body | None = None) -> Array:
    """(tracks, samples, 2) x, y [m] in base_link of the end that leads of the `whole` body, or of a `part` of it;
    `sign` 1.0 forward, -1.0 backward."""
    across = _spaced(-whole.right, whole.left)
    end = whole.front if sign > 0.0 else -whole.back
    rim = (part or whole).clipped(np.column_stack([np.full_like(across, end), across]))
    ahead = sign * TRACK_SPACING * np.arange(-SAMPLES_BEFORE, math.ceil(reach / TRACK_SPACING) + 1)
    return rim[:, None, :] + np.column_stack([ahead, np.zeros_like(ahead)])


def turn_tracks(
    reach: float, sign: float, whole: Body, part: Body | None = None, spare: float = 0.0
) -> Array:
    """(tracks, samples, 2) of the rim that leads a turn of the `whole` body, or of a `part` of it, larger by `spare`
    [m] on each side; `sign` 1.0 left, -1.0 right."""
    length, width = whole.front + spare, whole.left + spare
    front, side = _spaced(-width, 0.0), _spaced(0.0, length)
    rim = np.concatenate(
        [
            np.column_stack([np.full_like(front, length), front]),
            np.column_stack([side, np.full_like(side, width)]),
        ]
    )
    rim = (part or whole).grown(spare).clipped(np.concatenate([rim, -rim]) * (1.0, sign))
    angle = sign * turn_step(whole) * np.arange(math.ceil(reach / turn_step(whole)) + 1)
    c, s = np.cos(angle), np.sin(angle)
    swept = np.stack([rim[:, :1] * c - rim[:, 1:] * s, rim[:, :1] * s + rim[:, 1:] * c], axis=2)
    inwards = TRACK_SPACING / np.hypot(rim[:, 0], rim[:, 1])[:, None, None]
    inner = rim[:, None, :] * (1.0 - inwards * np.arange(SAMPLES_BEFORE, 0, -1)[:, None])
    return np.concatenate([inner, swept], axis=1)


def shells(tracks: Callable[[Body, Body], Array], whole: Body, part: Body) -> Array:
    """(shells, tracks, samples, 2): the tracks of a `part` of the body, and outside of it those of parts that are
    larger by TRACK_SPACING, up to the `whole` one. `tracks` takes both."""
    lacks = np.array(whole) - part
    count = math.ceil(lacks.max() / TRACK_SPACING - 1e-9)
    parts = [Body(*(whole - np.maximum(lacks - k * TRACK_SPACING, 0.0)).tolist()) for k in range(count + 1)]
    return np.stack([tracks(whole, each) for each in parts])


def turn_step(whole: Body) -> float:
    """[rad] between two samples of a turn: the corners of the body move by TRACK_SPACING."""
    return TRACK_SPACING / whole.corner


def _spaced(low: float, high: float) -> Array:
    return np.linspace(low, high, math.ceil((high - low) / TRACK_SPACING - 1e-9) + 1)


@lru_cache(maxsize=4)
def under(whole: Body) -> Array:
    """(points, 1, 2) places x, y [m] in base_link all over the body, as tracks of one sample."""
    along, across = _spaced(-whole.back, whole.front), _spaced(-whole.right, whole.left)
    return np.stack(np.meshgrid(along, across), axis=-1).reshape(-1, 1, 2)


Stand = tuple[float, float, float]
"""The plane that the robot stands on: height below base_link [m] in `map`, NaN where nothing is known; grades forward
and left [m/m]."""
FLAT: Stand = (math.nan, 0.0, 0.0)
"""Nothing is known of it."""


def stand_of(around: Surroundings, pose: tuple[float, float, float], up: Array, whole: Body) -> Stand:
    """The plane under the `whole` body at `pose` x, y [m], yaw [rad] in `map`: as tilted as the body, whose z axis
    `up` (3,) is in `map`; as high as the median of the ground that is known there."""
    x, y, yaw = (float(v) for v in pose)
    c, s = math.cos(yaw), math.sin(yaw)
    across = max(float(up[2]), 0.5)
    ahead, left = -(c * up[0] + s * up[1]) / across, -(c * up[1] - s * up[0]) / across
    height = height_under(
        around.height, *around.origin, around.resolution, x, y, yaw, ahead, left, whole.front, whole.left
    )
    return float(height), float(ahead), float(left)


NO_WALL = np.zeros((1, 1), np.uint8)
"""The body touches none."""


def reach_of(
    tracks: Array,
    step: float,
    around: Surroundings,
    pose: tuple[float, float, float],
    stand: Stand,
    robot: Capabilities,
    *,
    seen: bool,
    wall: NDArray[np.uint8] = NO_WALL,
) -> Reach:
    """How far the body goes along `tracks`, samples `step` [m or rad] apart, from `pose` x, y [m], yaw [rad] in `map`;
    `seen`: on ground that the map knows alone. Tracks of the whole body (tracks, samples, 2), with a `wall` (rows,
    cols) that the body touches the `shells` of what of it is in none.
    """
    gap = math.ceil((robot.max_gap + around.resolution) / TRACK_SPACING)
    tracks = tracks if tracks.ndim == 4 else tracks[None]
    sample, kind, height = nearest_obstacle(
        tracks,
        around.height,
        around.bound,
        around.source,
        around.occupied,
        around.variance,
        wall,
        around.origin[0],
        around.origin[1],
        around.resolution,
        float(pose[0]),
        float(pose[1]),
        float(pose[2]),
        stand,
        robot.max_step + FACE_NOISE,
        math.tan(robot.max_slope) * TRACK_SPACING,
        gap,
        gap if seen else tracks.shape[2],
    )
    return Reach(max(0.0, (sample - SAMPLES_BEFORE - 1) * step), kind, height)


def leaves_on(
    tracks: Array, step: float, around: Surroundings, pose: tuple[float, float, float], whole: Body
) -> float:
    """How far [m or rad] the `whole` body goes along `tracks`, samples `step` apart, from `pose` x, y [m], yaw [rad]
    in `map` until a part of it is over ground under leaves; 0 where one is, infinite where it meets none."""
    if not (around.source == PLANTS).any():
        return math.inf
    where = around.source, *around.origin, around.resolution, *(float(v) for v in pose)
    if first_leaf(under(whole), *where) == 0:
        return 0.0
    sample = first_leaf(tracks, *where)
    return max(0.0, (sample - SAMPLES_BEFORE) * step) if sample < tracks.shape[1] else math.inf


@njit(cache=True)
def first_leaf(tracks, source, x0, y0, resolution, x, y, yaw):  # pragma: no cover - compiled
    """First sample of any track over ground under leaves; the number of samples where there is none."""
    rows, cols = source.shape
    c, s = math.cos(yaw), math.sin(yaw)
    first = tracks.shape[1]
    for k in range(tracks.shape[0]):
        for i in range(first):
            u, v = tracks[k, i, 0], tracks[k, i, 1]
            col = cell_of(x + c * u - s * v, x0, resolution)
            row = cell_of(y + s * u + c * v, y0, resolution)
            if 0 <= row < rows and 0 <= col < cols and source[row, col] == PLANTS:
                first = i
                break
    return first


@njit(cache=True)
def height_under(
    height, x0, y0, resolution, x, y, yaw, ahead, left, length, width
):  # pragma: no cover - compiled
    """Median height [m] of the known ground under a body of half the `length` and half the `width` [m], carried to
    its middle along the grades; NaN where nothing is known."""
    rows, cols = height.shape
    c, s = math.cos(yaw), math.sin(yaw)
    reach = math.ceil(math.hypot(length, width) / resolution)
    col, row = cell_of(x, x0, resolution), cell_of(y, y0, resolution)
    known = np.empty((2 * reach + 1) ** 2)
    n = np.int64(0)
    for r in range(max(0, row - reach), min(rows, row + reach + 1)):
        for k in range(max(0, col - reach), min(cols, col + reach + 1)):
            dx, dy = x0 + k * resolution - x, y0 + r * resolution - y
            u, v = c * dx + s * dy, c * dy - s * dx
            if abs(u) <= length and abs(v) <= width and not math.isnan(height[r, k]):
                known[n] = height[r, k] - ahead * u - left * v
                n += 1
    if n == 0:
        return np.nan
    return 0.5 * (select(known, n, (n - 1) // 2) + select(known, n, n // 2))


@inlined
def _told(apart, variance, limit):  # pragma: no cover - compiled
    """A difference in height `apart` [m] with a `variance` [m^2]; of one above the `limit` nothing, where all of it may
    be noise. A face that is higher than noise can be keeps its height."""
    if limit < abs(apart) <= min(NOISE_SIGMAS * math.sqrt(variance), MOST_NOISE):
        return 0.0
    return apart


@njit(cache=True)
def nearest_obstacle(
    tracks,
    height,
    bound,
    source,
    occupied,
    variance,
    wall,
    x0,
    y0,
    resolution,
    x,
    y,
    yaw,
    stand,
    limit,
    rise,
    gap,
    blind,
):  # pragma: no cover - compiled
    """Sample of the first obstacle on any track, what it is, and its height [m]; the number of samples where there is
    none.

    `tracks` (shells, tracks, samples, 2): outside of the first shell `wall` (rows, cols), which the body touches, is no
    obstacle, nor is what lies behind it. `limit` [m]: highest face; `rise` [m]: what the steepest slope rises from
    sample to sample; `gap`: samples a gap may span; `blind`: samples that may lie between one whose ground is known and
    the next.
    """
    rows, cols = height.shape
    layers, count, samples = tracks.shape[0], tracks.shape[1], tracks.shape[2]
    c, s = math.cos(yaw), math.sin(yaw)
    first, kind, size = samples, CLEAR, 0.0
    ground, spread = np.empty(samples), np.empty(samples)
    low = np.empty(samples, np.bool_)  # nothing stands here: unknown, or not believed
    felt = np.empty(samples, np.bool_)
    busy = np.empty(samples, np.bool_)
    wide = np.empty(samples, np.bool_)
    # No obstacle, because at this sample a shell farther in is in the wall.
    walled = np.zeros((count, samples), np.bool_)
    for layer in range(layers):
        for k in range(count):
            for i in range(samples):
                u, v = tracks[layer, k, i, 0], tracks[layer, k, i, 1]
                col = cell_of(x + c * u - s * v, x0, resolution)
                row = cell_of(y + s * u + c * v, y0, resolution)
                ground[i], low[i], busy[i], felt[i], wide[i] = np.nan, False, False, False, False
                spread[i] = 0.0
                if 0 <= row < rows and 0 <= col < cols:
                    ground[i], spread[i] = height[row, col], variance[row, col]
                    busy[i] = occupied[row, col] > 0
                    felt[i] = source[row, col] == WHEELS
                    wide[i] = source[row, col] == HOLE
                    if math.isnan(ground[i]):
                        ground[i] = bound[row, col]
                        low[i] = True
                    if layer > 0 and wall[row, col] > 0:
                        walled[k, i] = True
                low[i] = low[i] or walled[k, i]
            # The newest sample whose ground is believed, and its height: first the plane that the robot stands on.
            last = 0
            level = stand[0] + stand[1] * tracks[layer, k, 0, 0] + stand[2] * tracks[layer, k, 0, 1]
            known = SAMPLES_BEFORE  # newest sample the map knows; what is under the body counts
            landed = 0  # behind a gap: what lies in it is not driven on
            # Height of a gap's near rim, and the sample up to which the far rim may lie.
            rim, over = np.nan, -1
            end, what, much = samples, CLEAR, 0.0
            i = 0
            while i < samples:
                if busy[i] and i > SAMPLES_BEFORE:
                    if i < end:
                        end, what = i, SWEEP
                    break
                if wide[i] and i > SAMPLES_BEFORE and not walled[k, i]:
                    at = min(i, known + 1)
                    if at <= end:
                        end, what = at, GAP
                    break
                if walled[k, i]:
                    known = max(known, i)
                    i += 1
                    continue
                if end == samples and i - known > blind:
                    end, what = known + 1, UNSEEN
                if math.isnan(ground[i]) or (low[i] and not ground[i] < level - limit):
                    i += 1
                    continue
                # Compare with everything known within the spread of a face, else with the last known ground.
                worst = 0.0
                if not math.isnan(level):
                    worst = ground[i] - level
                    worst = _told(worst, spread[i] + spread[last], limit)
                    if worst > 0.0 and not felt[i]:
                        worst = max(0.0, worst - rise * max(0, i - last - FACE_SAMPLES // 2))
                    for j in range(max(landed, i - FACE_SAMPLES), last):
                        if not low[j] and not math.isnan(ground[j]):
                            other = ground[i] - ground[j]
                            other = math.copysign(max(0.0, abs(other) - rise * FACE_SAMPLES / 2), other)
                            other = _told(other, spread[i] + spread[j], limit)
                            if abs(other) > abs(worst):
                                worst = other
                plane = stand[0] + stand[1] * tracks[layer, k, i, 0] + stand[2] * tracks[layer, k, i, 1]
                at_rim = i <= over and abs(ground[i] - rim) <= limit
                if worst > limit and (at_rim or (i <= SAMPLES_BEFORE and abs(ground[i] - plane) <= limit)):
                    # The far rim, with cells half over the gap before it; under the body, where the near one may lie
                    # behind the track's begin, the height that the robot stands at tells it.
                    last, level, landed, known, i = i, ground[i], i, max(known, i), i + 1
                    continue
                if worst < -limit and not felt[i] and not math.isnan(level):
                    rim, over = level, last + gap + 1
                if abs(worst) > limit and (i <= SAMPLES_BEFORE or felt[i]):
                    # A wall beside the body that the map shows a cell too near, or a wheel in the air.
                    low[i] = True
                    known = max(known, i)
                    i += 1
                    continue
                if abs(worst) > limit:
                    across = -1
                    if worst < 0.0:
                        for j in range(i + 1, min(samples, last + 1 + gap + 1)):
                            if wide[j] and j > SAMPLES_BEFORE and not walled[k, j]:
                                break
                            if (
                                not (low[j] or felt[j] or math.isnan(ground[j]))
                                and abs(ground[j] - level) <= limit
                            ):
                                across = j
                                break
                    if across >= 0:
                        last, level, landed, known, i = across, ground[across], across, across, across + 1
                        continue
                    at = i if worst > 0.0 else min(i, known + 1)
                    if at <= end:
                        end, what, much = at, FACE if worst > 0.0 else DROP, abs(worst)
                    break
                if not low[i]:
                    last, level = i, ground[i]
                    known = max(known, i)
                i += 1
            if end < first:
                first, kind, size = end, what, much
    return first, kind, size


@njit(cache=True)
def occupy(points, ground, x0, y0, resolution, lowest, highest, least, out):  # pragma: no cover - compiled
    """Set `out` (rows, cols) to 1 where at least `least` of the points (n, 3) [m] in `map` stand on the ground.

    A point stands on it when it is `lowest` (rows, cols) to `highest` [m] above `ground` (rows, cols), which have no
    NaN.
    """
    rows, cols = ground.shape
    count = np.zeros((rows, cols), np.int32)
    for i in range(points.shape[0]):
        col = cell_of(points[i, 0], x0, resolution)
        row = cell_of(points[i, 1], y0, resolution)
        if 0 <= row < rows and 0 <= col < cols:
            above = points[i, 2] - ground[row, col]
            if lowest[row, col] < above < highest:
                count[row, col] += 1
    for row in range(rows):
        for col in range(cols):
            out[row, col] = 1 if count[row, col] >= least else 0
