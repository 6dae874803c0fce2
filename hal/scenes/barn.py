"""Worlds of the BARN navigation challenge: a field of cylinders between two walls that a robot crosses in ten metres.

Made by the published rules (Perille, Truong, Xiao and Stone 2020, "Benchmarking metric ground navigation"): a
cellular automaton fills a grid of 30 x 30 cells of 0.15 m, each filled one is a cylinder of 0.075 m radius, and only
worlds count whose free cells, with the robot's two cells of clearance, join both ends. Or read from the challenge's
own `world_N.world` files. The world lies along the x axis: start at (-2, 0), goal at (8, 0), the field from 0 to 4.5.
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from hal.scenes.canvas import Canvas
from hal.scenes.scene import Goal, Scene, SceneError

GRID_CELLS, CELL_SIZE = 30, 0.15
"""Of the grid, and their size [m]."""
CYLINDER_RADIUS = 0.075
"""Of a cylinder [m]."""
CYLINDER_HEIGHT = 1.0
"""Of cylinders and walls [m]."""
CLEARANCE_CELLS = 2
"""Cells by which obstacles are grown for the robot of the challenge."""
FILL_SHARES, SMOOTHING_ROUNDS = (0.15, 0.20, 0.25, 0.30), (2, 3, 4)
"""Share that is filled at random, and rounds of smoothing."""
BORN_NEIGHBOURS, DEATH_NEIGHBOURS = 5, 1
"""A free cell with at least so many filled ones around it is filled, a filled one with at most so many is freed."""
START_POSE, GOAL_POSE = (-2.0, 0.0, 0.0), (8.0, 0.0, None)
HALF_SIDE = 0.5 * GRID_CELLS * CELL_SIZE
GRID_RESOLUTION = 0.05
MOST_TRIES = 1000


def barn(seed: int = 0) -> Scene:
    """The world of a seed; every twelfth has the same fill and smoothing."""
    random = np.random.default_rng(seed)
    fill, rounds = (
        FILL_SHARES[seed % len(FILL_SHARES)],
        SMOOTHING_ROUNDS[seed // len(FILL_SHARES) % len(SMOOTHING_ROUNDS)],
    )
    for _ in range(MOST_TRIES):
        grid = random.random((GRID_CELLS, GRID_CELLS)) < fill
        for _ in range(rounds):
            around = (
                ndimage.convolve(grid.astype(np.int64), np.ones((3, 3), np.int64), mode="constant") - grid
            )
            grid = np.where(grid, around > DEATH_NEIGHBOURS, around >= BORN_NEIGHBOURS)
        if grid.any() and math.isfinite(shortest_way(grid)):
            y, x = np.argwhere(grid).T
            places = np.column_stack([(x + 0.5) * CELL_SIZE, (y + 0.5) * CELL_SIZE - HALF_SIDE])
            return scene_of(places, f"seed {seed}: {fill:.0%} filled, smoothed {rounds} times")
    raise SceneError(f"barn:{seed}: none of {MOST_TRIES} worlds can be crossed")


def read_world(file: Path) -> Scene:
    """One `world_N.world` of the challenge. Raises SceneError."""
    try:
        root = Xml.parse(file).getroot()
    except (OSError, Xml.ParseError) as error:
        raise SceneError(f"cannot read {file}: {error}; name a world of the BARN challenge") from error
    places = []
    for model in root.iter("model"):
        if "cylinder" in model.get("name", "") and (pose := model.find("pose")) is not None and pose.text:
            x, y = (float(word) for word in pose.text.split()[:2])
            # There the robot starts at (-2.25, 3) and looks along y.
            places.append((y - 5.0, -2.25 - x))
    if not places:
        raise SceneError(f"{file}: holds no cylinders: name a world of the BARN challenge")
    return scene_of(np.array(places), file.name)


def scene_of(places: NDArray[np.float64], description: str) -> Scene:
    """The world with cylinders at x, y (n, 2) [m]."""
    canvas = Canvas(
        (START_POSE[0] - 1.5, GOAL_POSE[0] + 1.5, -HALF_SIDE - 0.2, HALF_SIDE + 0.2), GRID_RESOLUTION
    )
    for x, y in places:
        canvas.raise_to(np.hypot(canvas.x - x, canvas.y - y) <= CYLINDER_RADIUS, CYLINDER_HEIGHT)
    canvas.raise_to(np.abs(canvas.y) > HALF_SIDE, CYLINDER_HEIGHT)
    canvas.border(0.1, CYLINDER_HEIGHT)
    goals: dict[str, Goal] = {"end": GOAL_POSE}
    return Scene(
        name="barn",
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=START_POSE,
        goals=goals,
        description=f"world of the BARN challenge, {description}",
    )


def shortest_way(grid: NDArray[np.bool_]) -> float:
    """Shortest way [m] from start to goal over the cells (y, x) open to the challenge's robot; infinite if there is
    none."""
    free = ~ndimage.binary_dilation(grid, np.ones((2 * CLEARANCE_CELLS + 1,) * 2, bool))
    free[:CLEARANCE_CELLS] = free[-CLEARANCE_CELLS:] = False  # the walls
    number = np.full(free.shape, -1)
    number[free] = np.arange(np.count_nonzero(free))
    rows, cols, lengths = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = number[: GRID_CELLS - dy, max(0, -dx) : GRID_CELLS - max(0, dx)]
        b = number[dy:, max(0, dx) : GRID_CELLS + min(0, dx)]
        joined = (a >= 0) & (b >= 0)
        rows.append(a[joined])
        cols.append(b[joined])
        lengths.append(np.full(np.count_nonzero(joined), CELL_SIZE * math.hypot(dx, dy)))
    count = int(free.sum())
    if not (free[:, 0].any() and free[:, -1].any()):
        return math.inf
    graph = csr_matrix(
        (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(cols))), (count, count)
    )
    y = (np.arange(GRID_CELLS) + 0.5) * CELL_SIZE - HALF_SIDE
    into, out = number[free[:, 0], 0], number[free[:, -1], -1]
    begin = np.hypot(0.5 * CELL_SIZE - START_POSE[0], y[free[:, 0]] - START_POSE[1])
    end = np.hypot(GOAL_POSE[0] - (GRID_CELLS - 0.5) * CELL_SIZE, y[free[:, -1]] - GOAL_POSE[1])
    between = dijkstra(graph, directed=False, indices=into)[:, out]
    return float((begin[:, None] + between + end).min())


def grid_of(scene: Scene) -> NDArray[np.bool_]:
    """(30, 30) cells (y, x) of a world that hold a cylinder's middle or stand in it."""
    y, x = np.meshgrid(*(2 * [np.arange(GRID_CELLS)]), indexing="ij")
    col = np.round(((x + 0.5) * CELL_SIZE - scene.origin[0]) / scene.resolution).astype(int)
    row = np.round(((y + 0.5) * CELL_SIZE - HALF_SIDE - scene.origin[1]) / scene.resolution).astype(int)
    return np.asarray(scene.height[row, col] > 0.5 * CYLINDER_HEIGHT)
