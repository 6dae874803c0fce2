"""Rescue lanes without end: one from every seed, graded by what a controller can drive.

`lanes:17` is a name; `lanes:17,level=4,controller=policy,map=bars` says more. Lanes are 1.1 to 1.2 m wide between
walls of 0.5 m and come as one straight lane (`single`), two beside each other that overlap (`double`), one that comes
back (`folded`), and the same with a dead end (`fork`). Forty seeds in a row hold every layout with every kind of
element once. Level 1 asks for a third of the controller's envelope, level 4 for all of it. In level 5 one element of
the way is beyond what the controller's capabilities allow: such a lane must be refused.

docs/measurements/lanes.json names the first seeds that nobody has driven: they are neither run nor drawn nor looked at
before a result is taken, and no test uses seeds from 200 on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.robots import DEFAULT, describe
from hal.scenes.canvas import Canvas, Rect
from hal.scenes.elements import (
    HALF_RAMP,
    MAPS,
    Element,
    Grade,
    Maker,
    blocker,
    delayed,
    flat,
    thin_wall,
)
from hal.scenes.scene import Scene, SceneError
from hal.scenes.survey import highest_near

GRID_RESOLUTION = 0.02
WALL_HEIGHT = 0.5
"""Above the highest ground within 0.3 m [m]."""
OUTER_THICKNESS, INNER_THICKNESS = 0.04, 0.02
"""Walls around lanes; walls inside a lane [m]."""
ZONE_LENGTH = 1.3
"""Length of the level zones at start and end [m]."""
PAUSE_LENGTH = 0.4
"""Level ground between two elements [m]."""
LANDING_LENGTH = 1.2
"""Level ground on which the robot changes from one lane to the other [m]."""
FLOOR_MARGIN, FENCE_HEIGHT = 1.0, 1.2
"""Floor around the lanes and height of the fence around it [m]: without a hall the odometry sees two parallel walls
only."""
FLOOR_GRAIN = (0.002, 0.006)
"""Relief of the floor itself [m], on a grain of 0.2 m."""
LAYOUTS = ("single", "double", "folded", "fork")
LEVELS = (1, 2, 3, 4, 5)

Point = tuple[float, float]
Wall = tuple[Point, Point, float]
"""Both ends and the thickness [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Lane:
    """A scene and what is known about it."""

    scene: Scene
    level: int
    controller: str
    map: str
    layout: str
    width: float
    """Between the middles of the walls [m]."""
    line: NDArray[np.float64]
    """(n, 2) corners [m] of a way from start to goal `end` on which a body turns at corners only."""
    walls: NDArray[np.float64]
    """(n, 5) x, y of both ends, thickness [m]."""
    floor: NDArray[np.float32]
    """(rows, cols) heights without the walls [m]."""
    elements: tuple[str, ...]
    """Kinds, as they lie on the way."""
    beyond: Rect | None
    """Place of the element that must not be tried; level 5 only."""


@dataclass(frozen=True, slots=True)
class _Row:
    """Elements one behind the other along +x (`way` 1) or -x (-1) from x, y."""

    x: float
    y: float
    way: int
    elements: Sequence[Element]

    @property
    def begins(self) -> list[float]:
        """s [m] of every element's begin, and of the end."""
        return [0.0, *(float(s) for s in np.cumsum([e.length for e in self.elements]))]

    @property
    def end(self) -> float:
        """x [m]."""
        return self.x + self.way * self.begins[-1]

    def at(self, s: float, t: float = 0.0) -> Point:
        """Lane coordinates to x, y [m]."""
        return self.x + self.way * s, self.y + self.way * t

    def rect(self, index: int, width: float) -> Rect:
        """Place of an element."""
        a, b = self.at(self.begins[index])[0], self.at(self.begins[index + 1])[0]
        return min(a, b), max(a, b), self.y - 0.5 * width, self.y + 0.5 * width

    def way_through(self, first: int, last: int) -> list[Point]:
        """Corners of a way from the begin of element `first` to the end of element `last`."""
        out = []
        for k in range(first, last + 1):
            e, s = self.elements[k], self.begins[k]
            # All of the body is beside the wall's line before its front meets the wall.
            a, b = (e.wall[0] - 0.4, e.wall[1] + 0.4) if e.wall else (0.0, e.length)
            out += [self.at(s + a, e.beside), self.at(s + b, e.beside)]
        return out

    def thin_walls(self) -> list[Wall]:
        """Walls inside the row."""
        return [
            (self.at(s + e.wall[0], e.wall[2]), self.at(s + e.wall[1], e.wall[2]), INNER_THICKNESS)
            for s, e in zip(self.begins, self.elements, strict=False)
            if e.wall
        ]


@dataclass(frozen=True, slots=True)
class _Course:
    """Rows, the walls around them, and a way from the first zone's middle to the last one's."""

    rows: list[_Row]
    walls: list[Wall]
    line: list[Point]


def lane(seed: int, *, level: int = 2, controller: str = "vmc", map: str = "") -> Lane:
    """The lane of a seed. `map`: a name in `hal.scenes.elements.MAPS` or `mixed`; empty: the seed's own. Raises
    SceneError."""
    kinds = (*MAPS, "mixed")
    if map not in ("", *kinds):
        raise SceneError(f"lanes have no map {map!r}: use one of {', '.join(kinds)}")
    robot, _, name = controller.rpartition("/")
    able = describe(robot or DEFAULT)
    if level not in LEVELS or name not in able.own:
        raise SceneError(
            f"lanes have levels 1 to 5 for {', '.join(able.own)} of {able.name}; got level {level} for {controller}"
        )
    layout, kind = LAYOUTS[seed % len(LAYOUTS)], map or kinds[seed // len(LAYOUTS) % len(kinds)]
    random = np.random.default_rng([seed, kinds.index(kind)])
    width = round(float(random.uniform(1.10, 1.20)), 2)
    grade = Grade(level if level < 5 else 2, able.lanes(name), width)
    own, other = ([MAPS[kind]], [MAPS[kind]] * 2) if kind in MAPS else (list(MAPS.values()),) * 2

    def draw(makers: Sequence[Maker]) -> Element:
        return makers[int(random.integers(len(makers)))](random, grade)

    side, flip, seam_first = (int(random.choice([-1, 1])) for _ in range(3))
    grain = float(random.uniform(*FLOOR_GRAIN))
    must = [draw(own), draw([*other, thin_wall])][::flip]
    more = [draw(own), draw(own)]
    hard = blocker(random, grade)
    if level == 5:
        must[int(random.integers(len(must)))] = hard
    first, second = ([one, flat(PAUSE_LENGTH)] for one in must)
    if layout == "single":
        course = _single([flat(ZONE_LENGTH), *first, *second, flat(ZONE_LENGTH)], width)
    elif layout == "double":
        course = _double(
            [flat(ZONE_LENGTH), *first], [*second, flat(ZONE_LENGTH)], more, width, side, seam_first > 0
        )
    else:
        dead_end = more if layout == "fork" else []
        course = _folded([flat(ZONE_LENGTH), *first], [*second, flat(ZONE_LENGTH)], dead_end, width, side)
    beyond = next((r.rect(r.elements.index(hard), width) for r in course.rows if hard in r.elements), None)
    canvas, walls, floor = _paint(course, width, grain, seed)
    x0, y0 = canvas.origin
    x1, y1 = float(canvas.x[0, -1]), float(canvas.y[-1, 0])
    scene = Scene(
        name="lanes",
        height=canvas.array(),
        resolution=GRID_RESOLUTION,
        origin=canvas.origin,
        start=(*course.line[0], 0.0),
        goals={"end": (*course.line[-1], None), "home": (*course.line[0], None)},
        description=f"rescue lane, seed {seed}, level {level} for {controller}: {layout}, {kind}",
        allowed_area=((x0, y0), (x1, y0), (x1, y1), (x0, y1)),
    )
    return Lane(
        scene,
        level,
        controller,
        kind,
        layout,
        width,
        np.array(course.line),
        walls,
        floor,
        tuple(e.kind for e in must),
        beyond,
    )


def _single(elements: Sequence[Element], width: float) -> _Course:
    """One straight lane."""
    row = _Row(0.0, 0.0, 1, elements)
    last = len(elements) - 1
    line = [
        row.at(0.5 * ZONE_LENGTH),
        *row.way_through(1, last - 1),
        row.at(row.begins[last] + 0.5 * ZONE_LENGTH),
    ]
    return _Course([row], _box(row, width), line)


def _double(
    first: list[Element],
    second: list[Element],
    seam: list[Element],
    width: float,
    side: int,
    seam_first: bool,
) -> _Course:
    """Two lanes that overlap: level ground in both, before or behind elements out of step."""
    length = max(e.length for e in seam) + HALF_RAMP
    a, b = delayed(seam[0], 0.0, length), delayed(seam[1], HALF_RAMP, length)
    # Level ground on both sides: the robot turns beside elements, not astride them.
    overlap = (lambda e: [e, flat(LANDING_LENGTH)]) if seam_first else (lambda e: [flat(LANDING_LENGTH), e])
    out = _Row(0.0, 0.0, 1, [*first, *overlap(a)])
    begin, end = out.begins[len(first)], out.end
    on = _Row(begin, side * width, 1, [*overlap(b), *second])
    landing = 1 if seam_first else 0
    cross = out.begins[len(first) + landing] + 0.5 * LANDING_LENGTH
    last = len(on.elements) - 1
    line = [
        out.at(0.5 * ZONE_LENGTH),
        *out.way_through(1, len(first) - 1 + landing),
        (cross, 0.0),
        (cross, side * width),
        *on.way_through(1 + landing, last - 1),
        on.at(on.begins[last] + 0.5 * ZONE_LENGTH),
    ]
    h = 0.5 * width * side
    walls = [
        ((0.0, -h), (end, -h), OUTER_THICKNESS),
        ((0.0, h), (begin, h), OUTER_THICKNESS),
        ((0.0, -h), (0.0, h), OUTER_THICKNESS),
        ((end, -h), (end, h), OUTER_THICKNESS),
        ((begin, 3 * h), (on.end, 3 * h), OUTER_THICKNESS),
        ((end, h), (on.end, h), OUTER_THICKNESS),
        ((begin, h), (begin, 3 * h), OUTER_THICKNESS),
        ((on.end, h), (on.end, 3 * h), OUTER_THICKNESS),
    ]
    return _Course([out, on], walls, line)


def _folded(
    first: list[Element], second: list[Element], dead_end: list[Element], width: float, side: int
) -> _Course:
    """Out, round a thin wall, back; with `dead_end` another lane on the other side that leads nowhere."""
    out = _Row(0.0, 0.0, 1, [*first, flat(width)])
    turn = out.begins[len(first)]
    rows = [out, _Row(turn, side * width, -1, second)]
    if dead_end:
        rows.append(_Row(turn, -side * width, -1, [flat(PAUSE_LENGTH), *dead_end, flat(ZONE_LENGTH)]))
    back, middle = rows[1], turn + 0.5 * width
    last = len(second) - 1
    line = [
        out.at(0.5 * ZONE_LENGTH),
        *out.way_through(1, len(first) - 1),
        (middle, 0.0),
        (middle, side * width),
        *back.way_through(0, last - 1),
        back.at(back.begins[last] + 0.5 * ZONE_LENGTH),
    ]
    h = 0.5 * width
    walls = [((0.0, -h), (0.0, h), OUTER_THICKNESS)]
    for y in (-h, h):  # each as far as the longer lane beside it goes
        beside = next((r for r in rows[1:] if r.y * y > 0.0), None)
        far = turn if beside else out.end
        walls.append(((min(0.0, beside.end) if beside else 0.0, y), (far, y), OUTER_THICKNESS))
    for row in rows[1:]:
        edge = row.y + (h if row.y > 0.0 else -h)
        inner = row.y - (h if row.y > 0.0 else -h)
        walls += [
            ((row.end, edge), (out.end, edge), OUTER_THICKNESS),
            ((row.end, inner), (row.end, edge), OUTER_THICKNESS),
        ]
    walls.append(
        ((out.end, min(r.y for r in rows) - h), (out.end, max(r.y for r in rows) + h), OUTER_THICKNESS)
    )
    return _Course(rows, walls, line)


def _box(row: _Row, width: float) -> list[Wall]:
    h = 0.5 * width
    corners = [(row.x, -h), (row.end, -h), (row.end, h), (row.x, h)]
    return [(corners[k], corners[(k + 1) % 4], OUTER_THICKNESS) for k in range(4)]


def _paint(
    course: _Course, width: float, grain: float, seed: int
) -> tuple[Canvas, NDArray[np.float64], NDArray[np.float32]]:
    """Floor, elements, walls, fence; also the walls as (n, 5), and the heights without them."""
    walls = [*course.walls, *(w for row in course.rows for w in row.thin_walls())]
    ends = np.array([[p, q] for p, q, _ in walls])
    low = np.floor((ends.min(axis=(0, 1)) - FLOOR_MARGIN) / GRID_RESOLUTION) * GRID_RESOLUTION
    high = np.ceil((ends.max(axis=(0, 1)) + FLOOR_MARGIN) / GRID_RESOLUTION) * GRID_RESOLUTION
    rect = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    canvas = Canvas(rect, GRID_RESOLUTION)
    canvas.roughen(rect, grain, 0.2, seed)
    for row in course.rows:
        for k, (s, e) in enumerate(zip(row.begins, row.elements, strict=False)):
            inside = canvas.inside(row.rect(k, width))
            along, across = row.way * (canvas.x - row.x) - s, row.way * (canvas.y - row.y)
            canvas.height[inside] += e.height(along[inside], across[inside])
    floor = canvas.array()
    top = WALL_HEIGHT + highest_near(canvas.height, round(0.3 / GRID_RESOLUTION))
    for start, end, thick in walls:
        canvas.wall(start, end, thick, top)
    canvas.border(OUTER_THICKNESS, FENCE_HEIGHT)
    return canvas, np.array([[*p, *q, thick] for p, q, thick in walls]), floor


def named(text: str) -> Lane:
    """The lane that a scene's name asks for: `lanes:SEED[,level=N][,controller=NAME][,map=NAME]`. Raises SceneError."""
    words = text.partition(":")[2].split(",") if ":" in text else []
    seed, options = (words[0] or "0") if words else "0", dict(w.partition("=")[::2] for w in words[1:])
    if not seed.isdecimal() or not set(options) <= {"level", "controller", "map"}:
        raise SceneError(f"{text!r}: write lanes:SEED,level=1..5,controller=NAME or ROBOT/NAME,map=NAME")
    level = options.pop("level", "2")
    if not level.isdecimal():
        raise SceneError(f"{text!r}: the level must be a whole number")
    return lane(int(seed), level=int(level), **options)  # type: ignore[arg-type]
