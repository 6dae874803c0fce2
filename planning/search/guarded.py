"""The turns of a route as the guard sees them: what the planner calls room to turn is what the guard lets the body turn
through."""

from __future__ import annotations

import math

import numpy as np

from hal.safety.planned import free_turn, mapped
from hal.safety.swept import Surroundings
from hal.types import Capabilities
from mapping.grid import ElevationGrid
from planning.graph.describe import HEADING_COUNT, HEADING_STEP
from planning.graph.params import GraphParams

TURN_REACH = 0.2
"""[m] beyond the corners of a body that turns: what it may drift, and a gap beside it."""
TURN_SPARE = 0.05
"""[m] by which the body may miss the place of a turn, or drift while it turns: up to 0.1 m was seen on level ground."""


def known_around(grid: ElevationGrid, xy: tuple[float, float], reach: float) -> Surroundings:
    """What the map knows for certain within `reach` [m] of x, y, and bounds of the rest."""
    near = grid.around(np.array([xy]), reach)
    unknown = np.float32(np.nan)
    bound = None if near.virtual is None else np.where(near.virtual, near.height, unknown)
    return mapped(np.where(near.trusted, near.height, unknown), near.origin, near.resolution, bound)


def guarded_turn(
    grid: ElevationGrid, params: GraphParams, xy: tuple[float, float], yaw: float, turn: float, spare: float
) -> float:
    """How far [rad], at most the size of `turn`, the guard lets a body that is larger by `spare` [m] on each side turn
    at x, y [m] on the spot from `yaw` [rad]. What lies under its wheels has a price (`TraversalGraph.turn_price`).

    The guard keeps a margin of 0.03 m, which is a turn of 0.07 rad, and slows down before. The tracker drives on when
    0.14 rad of a turn are left (`TrackerConfig.turn_release`), so a turn that meets nothing to its end is not held.
    """
    around = known_around(grid, xy, 0.5 * math.hypot(params.length, params.width) + TURN_REACH)
    return free_turn(around, (*xy, yaw), turn, drives_over(params), spare)


def drives_over(params: GraphParams) -> Capabilities:
    """What the guard asks of a robot: its body, and what it drives over."""
    return Capabilities(
        "",
        length=params.length,
        width=params.width,
        max_step=params.max_step,
        max_slope=params.max_slope,
        max_gap=params.max_gap,
    )


def without(room: np.uint64, yaw: float, turn: float, free: float) -> np.uint64:
    """The headings `room` (`TraversalGraph.free_headings`) less one, so that a turn from `yaw` by `turn` [rad] that the
    guard holds after `free` [rad] finds none: `turn_is_free` asks the headings between both ends."""
    low, high = sorted((yaw, yaw + turn))
    first, last = math.floor(low / HEADING_STEP) + 1, math.ceil(high / HEADING_STEP) - 1
    at = round((yaw + math.copysign(free, turn)) / HEADING_STEP)
    return np.uint64(int(room) & ~(1 << (min(max(at, first), last) % HEADING_COUNT)))
