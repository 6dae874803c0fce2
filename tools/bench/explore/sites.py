"""Sites to explore, different for every seed: rooms, yards, rubble and a basement with two exits."""

from __future__ import annotations

import math

import numpy as np

from hal.scenes.canvas import Canvas, Rect
from hal.scenes.scene import Scene

CELL_SIDE = 0.05
WALL_WIDTH, WALL_HEIGHT = 0.16, 1.5
"""[m] thick and high."""
DOOR_WIDTH = 1.1
SITES: tuple[tuple[str, int, float], ...] = (
    *(("rooms", 0, 20.0), ("rooms", 1, 30.0), ("rooms", 2, 40.0), ("rooms", 3, 60.0)),
    *(("yard", 4, 20.0), ("yard", 5, 35.0), ("yard", 6, 50.0)),
    *(("rubble", 7, 20.0), ("rubble", 8, 30.0)),
    ("basement", 9, 24.0),
)
"""Kind, seed, side [m]."""


def site(kind: str, seed: int, side: float) -> Scene:
    """A walled square of `side` [m]; the robot begins in its south-west corner."""
    random = np.random.default_rng(seed)
    canvas = Canvas((0.0, side, 0.0, side), CELL_SIDE)
    {"rooms": _rooms, "yard": _yard, "rubble": _rubble, "basement": _basement}[kind](canvas, side, random)
    start = (1.2, 1.2)
    canvas.height[np.hypot(canvas.x - start[0], canvas.y - start[1]) < 0.9] = canvas.height[
        round(start[1] / CELL_SIDE), round(start[0] / CELL_SIDE)
    ]
    canvas.border(WALL_WIDTH, canvas.height.max() + WALL_HEIGHT)
    return Scene(
        name=f"{kind}-{seed}",
        height=canvas.array(),
        resolution=CELL_SIDE,
        origin=canvas.origin,
        start=(*start, 0.25 * math.pi),
        goals={},
        description=f"{kind}, {side:.0f} m, seed {seed}",
    )


def _split(canvas: Canvas, rect: Rect, random: np.random.Generator, top: float, least: float) -> None:
    """Walls with a door each, until rooms are hardly larger than `least` [m]."""
    x0, x1, y0, y1 = rect
    across = x1 - x0 >= y1 - y0
    low, high = (x0, x1) if across else (y0, y1)
    if high - low < 2.0 * least + 1.0:
        return
    at = random.uniform(low + least, high - least)
    side0, side1 = (y0, y1) if across else (x0, x1)
    doors = [random.uniform(side0 + 0.4, side1 - 0.4 - DOOR_WIDTH)]
    if side1 - side0 > 10.0:
        doors.append(random.uniform(side0 + 0.4, side1 - 0.4 - DOOR_WIDTH))
    ends = [side0, *(v for d in sorted(doors) for v in (d, d + DOOR_WIDTH)), side1]
    for a, b in zip(ends[::2], ends[1::2], strict=True):
        if b > a:
            canvas.box((at, at + WALL_WIDTH, a, b) if across else (a, b, at, at + WALL_WIDTH), top)
    parts = (
        [(x0, at, y0, y1), (at + WALL_WIDTH, x1, y0, y1)]
        if across
        else [(x0, x1, y0, at), (x0, x1, at + WALL_WIDTH, y1)]
    )
    for part in parts:
        _split(canvas, part, random, top, least)


def _blocks(canvas: Canvas, rect: Rect, random: np.random.Generator, count: int, most: float) -> None:
    x0, x1, y0, y1 = rect
    for _ in range(count):
        place = (random.uniform(x0, x1), random.uniform(y0, y1))
        size = (random.uniform(0.3, most), random.uniform(0.3, most))
        canvas.block(place, size, random.uniform(0.0, math.pi), random.uniform(0.3, 1.2))


def _rooms(canvas: Canvas, side: float, random: np.random.Generator) -> None:
    _split(canvas, (0.0, side, 0.0, side), random, WALL_HEIGHT, 3.5)
    _blocks(canvas, (2.5, side, 2.5, side), random, int(side * side / 40.0), 0.9)


def _yard(canvas: Canvas, side: float, random: np.random.Generator) -> None:
    for _ in range(int(side * side / 120.0) + 2):  # sheds
        x, y = random.uniform(3.0, side - 6.0, 2)
        w, h = random.uniform(2.0, 6.0, 2)
        canvas.box((x, x + w, y, y + h), 2.5)
    _blocks(canvas, (2.5, side, 2.5, side), random, int(side * side / 60.0), 1.5)
    canvas.roughen((3.0, side - 1.0, 3.0, side - 1.0), 0.03, 0.5, int(random.integers(1000)))


def _rubble(canvas: Canvas, side: float, random: np.random.Generator) -> None:
    canvas.roughen((2.5, side - 0.5, 2.5, side - 0.5), 0.06, 0.6, int(random.integers(1000)))
    _blocks(canvas, (2.5, side, 2.5, side), random, int(side * side / 7.0), 1.4)


def _basement(canvas: Canvas, side: float, random: np.random.Generator) -> None:
    """A yard 1.2 m above cellar rooms, with a ramp down on either side."""
    depth, half = 1.2, 0.5 * side
    canvas.box((0.0, side, 0.0, half), depth)
    _blocks(canvas, (3.0, side - 3.0, 2.0, half - 3.0), random, 6, 1.2)
    canvas.box((0.0, side, half, half + WALL_WIDTH), depth + 1.0)
    for x in (2.0, side - 4.0):
        canvas.height[canvas.inside((x, x + 2.0, half - 5.5, half + WALL_WIDTH))] = 0.0
        canvas.ramp((x, x + 2.0, half - 5.5, half), 0.0, depth, "-y")
        for edge in (x - WALL_WIDTH, x + 2.0):
            canvas.box((edge, edge + WALL_WIDTH, half - 5.0, half), depth + 0.4)
    _split(canvas, (0.0, side, half + 2.5, side), random, WALL_HEIGHT, 3.5)
