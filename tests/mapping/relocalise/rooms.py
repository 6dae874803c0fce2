"""Rooms as clouds, for tests: walls of 1 m around level ground."""

from __future__ import annotations

import math

import numpy as np

from mapping.grid import ElevationGrid
from mapping.relocalise import PriorMap, Submap

EYE = 0.6
"""Height of the LiDAR [m]."""
BELOW = 0.4
"""The ground under base_link [m]."""


def walls(*lines: tuple[float, float, float, float]) -> np.ndarray:
    """(n, 3) points every 8 cm on walls from x0, y0 to x1, y1."""
    out = []
    for x0, y0, x1, y1 in lines:
        n = max(2, round(math.dist((x0, y0), (x1, y1)) / 0.08))
        s, z = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, n), np.arange(0.02, 1.0, 0.08)))
        out.append(np.column_stack([x0 + s * (x1 - x0), y0 + s * (y1 - y0), z]))
    return np.concatenate(out)


def floor(x: float, y: float) -> np.ndarray:
    """(n, 3) points every 0.2 m of the ground up to +-x, +-y."""
    a, b = (v.ravel() for v in np.meshgrid(np.arange(-x, x, 0.2), np.arange(-y, y, 0.2)))
    return np.column_stack([a, b, np.zeros_like(a)])


def room(x: float, y: float) -> np.ndarray:
    """A rectangular room: it looks the same from two sides."""
    return np.concatenate(
        [walls((-x, -y, x, -y), (x, -y, x, y), (x, y, -x, y), (-x, y, -x, -y)), floor(x, y)]
    )


def corner_room() -> np.ndarray:
    """A room of 8 x 6 m with a slanted wall in one corner: no two places look alike, and nothing hides anything."""
    lines = ((-4, -3, 4, -3), (4, -3, 4, 1), (4, 1, 2, 3), (2, 3, -4, 3), (-4, 3, -4, -3))
    return np.concatenate([walls(*lines), floor(4, 3)])


def prior_of(cloud: np.ndarray, x: float = 4.0, y: float = 3.0) -> PriorMap:
    """The map of a room whose ground is known up to +-x, +-y."""
    return PriorMap(cloud.astype(np.float32), [ground_of(x, y)])


def ground_of(x: float, y: float) -> ElevationGrid:
    """Level ground."""
    shape = (round(2 * y / 0.04), round(2 * x / 0.04))
    return ElevationGrid(np.zeros(shape, np.float32), np.ones(shape, np.bool_), (-x, -y), 0.04)


def seen_from(cloud: np.ndarray, x: float, y: float, yaw: float) -> np.ndarray:
    """(n, 3) the cloud in base_link of a robot standing there, with 1 cm of noise."""
    c, s = math.cos(yaw), math.sin(yaw)
    moved = (cloud - [x, y, BELOW]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    noise = 0.01 * np.random.default_rng(5).standard_normal(moved.shape)
    return (moved + noise).astype(np.float32)


def look(submap: Submap, points: np.ndarray, odom: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    """One more stand of the robot, at x, y, yaw in `odom`."""
    x, y, yaw = odom
    q = np.array([0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)])
    submap.stand()
    submap.add(points, np.array([x, y, BELOW]), q, (0.0, 0.0, EYE - BELOW), BELOW)
