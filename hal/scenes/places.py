"""Ordinary places of people, another one from every seed: stairs, ramps, houses, and goals that nothing leads to.

`places:KIND,SEED` is a name. Each has one goal, `end`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hal.scenes.canvas import Canvas, Rect
from hal.scenes.scene import Scene, SceneError

GRID_RESOLUTION = 0.02
STAIR_WIDTH = 1.4
"""Stairs between their walls [m]."""
SIDE_HEIGHT = 0.9
"""Walls beside stairs above their steps [m]."""
WALL_THICKNESS = 0.08
"""Walls [m]."""
FENCE_HEIGHT = 1.4
"""Wall around everything above the highest ground [m]."""
RAMP_STEEPNESS = 1.0 / 12.0
"""Of a ramp for wheelchairs."""

Point = tuple[float, float]
Wall = tuple[float, float, float, float, float]
"""x, y of both ends, thickness [m]."""


@dataclass(slots=True, eq=False)
class Place:
    """A scene under construction, and what is known about it."""

    canvas: Canvas
    start: Point
    goal: Point
    beyond: Rect | None = None
    """What must not be entered, where nothing else leads to the goal."""
    walls: list[Wall] = field(default_factory=list)
    """What a way has to go around, cliffs too."""
    look: float = 0.0
    """[m] to drive until all that may lead to the goal was looked at."""
    scene: Scene = field(init=False)

    def wall(self, a: Point, b: Point, top: float) -> None:
        """One that stands there."""
        self.canvas.bar(a, b, WALL_THICKNESS, top)
        self.walls.append((*a, *b, WALL_THICKNESS))

    def cliffs(self, *corners: Point) -> None:
        """Edges that nothing crosses, from corner to corner."""
        self.walls += [(*a, *b, 0.0) for a, b in pairwise(corners)]


def _stairs(random: np.random.Generator, riser: float, tread: float, up: bool) -> Place:
    """A flight between two floors, walls along both of its sides."""
    count = int(random.integers(6, 9))
    high, run = count * riser, (count - 1) * tread
    middle = float(random.uniform(-0.8, 0.8))
    canvas = Canvas((-3.5, run + 3.5, -2.5, 2.5), GRID_RESOLUTION)
    canvas.height[canvas.x > run - 1e-6] = high
    left, right = middle + 0.5 * STAIR_WIDTH, middle - 0.5 * STAIR_WIDTH
    flight = canvas.inside((0.0, run, right, left))
    steps = riser * np.floor(canvas.x / tread + 1.0 + 1e-6)
    np.copyto(canvas.height, np.minimum(steps, high), where=flight)
    place = Place(canvas, _near(random, -2.3, middle), _near(random, run + 2.3, middle))
    if not up:
        place.start, place.goal = place.goal, place.start
    top = np.minimum(np.maximum(steps, 0.0), high) + SIDE_HEIGHT
    for y in (left + 0.5 * WALL_THICKNESS, right - 0.5 * WALL_THICKNESS):
        canvas.wall((0.0, y), (run, y), WALL_THICKNESS, top)
        place.walls.append((0.0, y, run, y, WALL_THICKNESS))
    place.cliffs((run, left), (run, 2.5))
    place.cliffs((run, right), (run, -2.5))
    return place


def _near(random: np.random.Generator, x: float, y: float) -> Point:
    return x + float(random.uniform(-0.4, 0.4)), y + float(random.uniform(-0.6, 0.6))


def _ramp(random: np.random.Generator, kerb: bool) -> Place:
    """A ramp for wheelchairs along a terrace, which nothing else leads to."""
    high = float(random.uniform(0.40, 0.50))
    run, width = high / RAMP_STEEPNESS, float(random.uniform(1.2, 1.5))
    canvas = Canvas((-3.5, run + 4.5, -4.0, 3.0), GRID_RESOLUTION)
    terrace = (run, run + 3.0, -0.5, 2.5)
    canvas.box(terrace, high)
    canvas.ramp((0.0, run, -0.5, width - 0.5), 0.0, high, "+x")
    if kerb:
        for y in (-0.5, width - 0.5):
            canvas.wall((0.0, y), (run, y), 0.10, np.maximum(canvas.x * RAMP_STEEPNESS, 0.0) + 0.10)
    place = Place(canvas, _near(random, run + 1.0, -2.4), (run + 1.5, 1.2))
    place.cliffs(
        (0.0, -0.5), (run + 3.0, -0.5), (run + 3.0, 2.5), (run, 2.5), (run, width - 0.5), (0.0, width - 0.5)
    )
    return place


def _moat(random: np.random.Generator) -> Place:
    """A goal on an island in a moat that closes round it."""
    side, wide = (float(random.uniform(*r)) for r in ((2.0, 3.0), (0.8, 1.2)))
    outer = 0.5 * side + wide
    canvas = _court(random, 5.0, outer + 0.8)
    canvas.height[canvas.inside((-outer, outer, -outer, outer))] = -0.6
    canvas.height[canvas.inside((-0.5 * side, 0.5 * side, -0.5 * side, 0.5 * side))] = 0.0
    island = (-outer, outer, -outer, outer)
    return Place(
        canvas, (-4.2, float(random.uniform(-3.0, 3.0))), (0.0, 0.0), island, look=8.0 * (outer + 0.5)
    )


def _pit(random: np.random.Generator) -> Place:
    """A goal at the bottom of a pit."""
    half, deep = (float(random.uniform(*r)) for r in ((1.0, 1.5), (0.5, 0.9)))
    canvas = _court(random, 5.0, half + 0.8)
    canvas.height[canvas.inside((-half, half, -half, half))] = -deep
    pit = (-half, half, -half, half)
    return Place(canvas, (-4.2, float(random.uniform(-3.0, 3.0))), (0.0, 0.0), pit, look=8.0 * (half + 0.5))


def _court(random: np.random.Generator, half: float, clear: float) -> Canvas:
    """Level ground with some boxes, none within `clear` [m] of its middle or where robots start."""
    canvas = Canvas((-half, half, -half, half), GRID_RESOLUTION)
    for _ in range(12):
        x, y = random.uniform(-half, half, 2)
        if math.hypot(x, y) > math.sqrt(2.0) * clear and x > -half + 1.8:
            canvas.block((x, y), (random.uniform(0.3, 0.8), 0.4), random.uniform(0.0, math.pi), 0.6)
    return canvas


def _house(random: np.random.Generator) -> Place:
    """Rooms on both sides of a hall, with doors 0.9 to 1.0 m wide."""
    rooms, deep, hall, door = 3, 3.0, 1.5, float(random.uniform(0.9, 1.0))
    wide = [float(v) for v in random.uniform(2.6, 3.4, rooms)]
    ends = np.concatenate([[0.0], np.cumsum(wide)])
    long = float(ends[-1])
    canvas = Canvas((-0.1, long + 0.1, -0.1, 2.0 * deep + hall + 0.1), GRID_RESOLUTION)
    place = Place(canvas, (0.0, 0.0), (0.0, 0.0))
    top = 1.8
    for south, north, inner in ((0.0, deep, deep), (deep + hall, 2.0 * deep + hall, deep + hall)):
        for x in ends[1:-1]:
            place.wall((float(x), south), (float(x), north), top)
        for a, b in pairwise(ends):
            at = float(random.uniform(a + 0.4, b - 0.4 - door))
            place.wall((float(a), inner), (at, inner), top)
            place.wall((at + door, inner), (float(b), inner), top)
    for k in range(rooms):  # a table in each room, at its outer wall
        for y in (0.5, 2.0 * deep + hall - 0.5):
            canvas.block((float(random.uniform(ends[k] + 0.9, ends[k + 1] - 0.9)), y), (0.9, 0.6), 0.0, 0.7)
    north = bool(random.integers(2))
    place.start = (0.5 * wide[0], 1.6)
    place.goal = (long - 0.5 * wide[-1], 2.0 * deep + hall - 1.6 if north else 1.6)
    return place


def _steps(rise: float, tread: float) -> dict[str, Callable[[np.random.Generator], Place]]:
    name = f"stairs_{round(100 * rise)}_{round(100 * tread)}"
    return {
        f"{name}_up": lambda random: _stairs(random, rise, tread, up=True),
        f"{name}_down": lambda random: _stairs(random, rise, tread, up=False),
    }


def _steep(up: bool) -> Callable[[np.random.Generator], Place]:
    """Stairs of 42 to 45 deg, their steps low enough for a robot that climbs kerbs."""

    def draw(random: np.random.Generator) -> Place:
        riser, tread = (float(random.choice(v)) for v in ((0.19, 0.20), (0.20, 0.22)))
        place = _stairs(random, riser, tread, up)
        (x0, y0, x1, _, _), (_, y1, _, _, _) = place.walls[1], place.walls[0]
        place.beyond = (x0, x1, y0, y1)
        return place

    return draw


PLACES: dict[str, Callable[[np.random.Generator], Place]] = {
    **_steps(0.15, 0.30),
    **_steps(0.17, 0.28),
    **_steps(0.18, 0.26),
    "steep_up": _steep(up=True),
    "steep_down": _steep(up=False),
    "ramp": lambda random: _ramp(random, kerb=False),
    "ramp_kerb": lambda random: _ramp(random, kerb=True),
    "moat": _moat,
    "pit": _pit,
    "house": _house,
}
"""Kinds."""


def place(kind: str, seed: int) -> Place:
    """The place of a kind and a seed. Raises SceneError."""
    if kind not in PLACES:
        raise SceneError(f"there is no place {kind!r}: use one of {', '.join(PLACES)}")
    random = np.random.default_rng([seed, *kind.encode()])
    found = PLACES[kind](random)
    canvas = found.canvas
    canvas.roughen(_all(canvas), 0.003, 0.2, seed)
    canvas.border(WALL_THICKNESS, float(canvas.height.max()) + FENCE_HEIGHT)
    x0, x1, y0, y1 = _all(canvas)
    found.scene = Scene(
        name="places",
        height=canvas.array(),
        resolution=GRID_RESOLUTION,
        origin=canvas.origin,
        start=(*found.start, float(random.uniform(-math.pi, math.pi))),
        goals={"end": (*found.goal, None)},
        description=f"{kind}, seed {seed}",
        allowed_area=((x0, y0), (x1, y0), (x1, y1), (x0, y1)),
    )
    return found


def bounds(place: Place) -> NDArray[np.float64]:
    """(n, 5) walls and cliffs as `hal.scenes.shortest` takes them."""
    return np.array(place.walls).reshape(-1, 5)


def _all(canvas: Canvas) -> Rect:
    x0, y0 = canvas.origin
    return x0, float(canvas.x[0, -1]), y0, float(canvas.y[-1, 0])


def named(text: str) -> Place:
    """The place that a scene's name asks for: `places:KIND,SEED`. Raises SceneError."""
    kind, _, seed = text.partition(":")[2].partition(",")
    if seed and not seed.isdecimal():
        raise SceneError(f"{text!r}: write places:KIND,SEED")
    return place(kind or next(iter(PLACES)), int(seed or 0))
