"""Ground around the origin as the guard sees it, and the robot on it."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.safety.contact import contact_at
from hal.safety.swept import (
    LIDAR,
    NO_WALL,
    TRACK_SPACING,
    Body,
    Reach,
    Surroundings,
    reach_of,
    shells,
    stand_of,
    straight_tracks,
    turn_step,
    turn_tracks,
)
from hal.types import Capabilities

ROBOT = Capabilities("test", max_step=0.10, max_slope=math.radians(25.0), max_gap=0.10)
BODY = Body.of(ROBOT)
RES = 0.04
N = 101
X, Y = np.meshgrid(*(2 * [(np.arange(N) - N // 2) * RES]))
CORNER = (float(X[0, 0]), float(Y[0, 0]))
FRONT, SIDE = BODY.front, BODY.left
HIGH, KERB = 0.5, 0.10


def ground(height: NDArray[Any], **layers: Any) -> Surroundings:
    """As the guard makes them of a map window; what is not given is unknown or free."""
    height = np.ascontiguousarray(height, np.float32)
    bound = np.asarray(layers.get("bound", np.full_like(height, np.nan)), np.float32)
    source = np.asarray(layers.get("source", np.where(np.isnan(height), 0, LIDAR)), np.uint8)
    occupied = np.asarray(layers.get("occupied", np.zeros_like(height)), np.uint8)
    variance = np.asarray(layers.get("variance", np.zeros_like(height)), np.float32)
    return Surroundings(height, bound, source, occupied, variance, CORNER, RES)


WAYS = {
    "ahead": (partial(straight_tracks, 1.0, 1.0), TRACK_SPACING),
    "behind": (partial(straight_tracks, 1.0, -1.0), TRACK_SPACING),
    "left": (partial(turn_tracks, 0.6, 1.0), turn_step(BODY)),
    "right": (partial(turn_tracks, 0.6, -1.0), turn_step(BODY)),
}


def look(
    around: Surroundings, pose: tuple[float, float, float] = (0.0, 0.0, 0.0), up: Any = (0.0, 0.0, 1.0)
) -> dict[str, Reach]:
    """Every way, 1 m and 0.6 rad far."""
    stand = stand_of(around, pose, np.asarray(up), BODY)
    contact = contact_at(around, pose, stand, ROBOT)
    found = {}
    for name, (tracks, step) in WAYS.items():
        straight = step == TRACK_SPACING
        body = BODY if contact is None else contact.between(RES) if straight else contact.body
        there = (around, pose, stand, ROBOT)
        wall = NO_WALL if contact is None else contact.wall
        ways = [
            reach_of(tracks(BODY), step, *there, seen=straight),
            reach_of(shells(tracks, BODY, body), step, *there, seen=straight, wall=wall),
        ]
        found[name] = max(ways, key=lambda way: way.free)
    return found
