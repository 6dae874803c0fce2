"""Ground of the training: lanes of one kind and one level beside each other, and an open field. All in one heightfield.

Crossing ramps, gaps and rails in a mix are held out: no lane has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.types import Array

CELL_SIDE = 0.04
LANE_WIDTH = 2.4
"""Of a lane [m]."""
LANE_LENGTH = 13.2
OBSTACLE_X = 1.0
"""x [m] at which obstacles begin; robots start around 0."""
LEVEL_BEFORE = 1.2
"""Level ground behind x = 0 [m]."""
LEVEL_COUNT = 10
KINDS = ("steps", "stairs", "bars", "posts", "ramps")
DEALT_KINDS = (0, 1, 2, 3, 3, 4)
"""Kinds as they are dealt to the robots: posts take longest to learn."""
OPEN = len(KINDS)
"""The kind of the open field."""
FIELD_SIDE = 14.0
"""Side of the open field along y [m]."""
OBSTACLE_ANGLES = (0.0, 20.0, -35.0, 50.0, -60.0)
"""To the head-on way [deg]: of bars by level, of plateaus one after the other."""
PLATEAU_LENGTHS = (1.2, 0.8)
"""Length of plateaus along the lane, and the same between two of them [m], by level."""


def lane(kind: str, level: int) -> NDArray[np.float32]:
    """(rows, cols) heights [m] of a lane; rows run along y."""
    cols, rows = round(LANE_LENGTH / CELL_SIDE), round(LANE_WIDTH / CELL_SIDE)
    x, y = np.meshgrid(
        np.arange(cols) * CELL_SIDE - LEVEL_BEFORE, (np.arange(rows) - 0.5 * (rows - 1)) * CELL_SIDE
    )
    s = x - OBSTACLE_X
    rng = np.random.default_rng(100 * KINDS.index(kind) + level)
    if kind == "steps":
        up, length = np.zeros(s.shape, bool), PLATEAU_LENGTHS[level % len(PLATEAU_LENGTHS)]
        for k in range(int(LANE_LENGTH / (2.0 * length))):
            angle = np.radians(OBSTACLE_ANGLES[(k + 2 * level + 2) % len(OBSTACLE_ANGLES)])
            across = (s - (2.0 * k + 0.5) * length) * np.cos(angle) + y * np.sin(angle)
            up |= np.abs(across) < 0.5 * length * np.cos(angle)
        z = up * (0.04 + 0.026 * level)
    elif kind == "stairs":
        within = s % 4.8
        up = np.clip(np.floor(within / 0.3) + 1.0, 0.0, 4.0)
        down = np.clip(np.floor((within - 2.4) / 0.3) + 1.0, 0.0, 4.0)
        z = (0.03 + 0.017 * level) * (up - np.where(within > 2.4, down, 0.0))
    elif kind == "bars":
        angle = np.radians(OBSTACLE_ANGLES[level % len(OBSTACLE_ANGLES)])
        pitch = 0.9 * np.cos(angle)
        across = (s - 0.6) * np.cos(angle) + y * np.sin(angle)
        z = (np.abs((across + 0.5 * pitch) % pitch - 0.5 * pitch) < 0.08) * (s > 0.2) * (0.03 + 0.012 * level)
    elif kind == "posts":
        side = 0.12 if level % 2 else 0.3
        heights = rng.choice([0.0, 1 / 3, 2 / 3, 1.0], (rows, cols), p=[0.4, 0.3, 0.2, 0.1])
        r = np.clip(((y + 0.5 * LANE_WIDTH) / side).astype(int), 0, rows - 1)
        c = np.clip((np.maximum(s, 0.0) / side).astype(int), 0, cols - 1)
        z = heights[r, c] * (0.05 + 0.02 * level)
    elif kind == "ramps":
        rise = np.tan(np.radians(8.0 + 3.5 * level))
        within = np.maximum(s, 0.0) % 4.0
        z = np.minimum(within, 4.0 - within) * rise
        knots = rng.uniform(-1.0, 1.0, (int(LANE_WIDTH / 0.15) + 2, int(LANE_LENGTH / 0.15) + 2))
        along = np.array(
            [np.interp(x[0], np.arange(knots.shape[1]) * 0.15 - LEVEL_BEFORE, row) for row in knots]
        )
        rough = np.array(
            [
                np.interp(y[:, 0], np.arange(knots.shape[0]) * 0.15 - 0.5 * LANE_WIDTH, column)
                for column in along.T
            ]
        ).T
        z = z + rough * (0.01 + 0.004 * level) * np.clip(s, 0.0, 1.0)
    else:
        raise ValueError(f"no kind {kind!r}: there are {', '.join(KINDS)}")
    return np.where(s > 0.0, z, 0.0).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """All lanes, kind after kind and level after level along y, then the open field."""

    height: NDArray[np.float32]
    origin: tuple[float, float]
    """x, y [m] of the centre of cell [0, 0]."""

    @staticmethod
    def build() -> Ground:
        """The same every time."""
        lanes = [lane(kind, level) for kind in KINDS for level in range(LEVEL_COUNT)]
        open_field = np.zeros((round(FIELD_SIDE / CELL_SIDE), lanes[0].shape[1]), np.float32)
        return Ground(
            np.concatenate([*lanes, open_field]), (-LEVEL_BEFORE, -0.5 * LANE_WIDTH + 0.5 * CELL_SIDE)
        )

    def middle(self, kind: NDArray[np.int64], level: NDArray[np.int64]) -> Array:
        """y [m] of the middle of each robot's lane or of the field, (n,)."""
        lanes = len(KINDS) * LEVEL_COUNT
        return np.where(
            kind == OPEN,
            lanes * LANE_WIDTH + 0.5 * (FIELD_SIDE - LANE_WIDTH),
            (kind * LEVEL_COUNT + level) * LANE_WIDTH,
        ).astype(float)

    def at(self, x: Array, y: Array) -> Array:
        """Height [m] at x, y [m], of the nearest cell."""
        c = np.rint((x - self.origin[0]) / CELL_SIDE).astype(int)
        r = np.rint((y - self.origin[1]) / CELL_SIDE).astype(int)
        rows, cols = self.height.shape
        return self.height[np.clip(r, 0, rows - 1), np.clip(c, 0, cols - 1)].astype(float)
