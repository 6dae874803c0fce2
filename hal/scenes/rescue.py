"""Four benchmark scenes built from the dimensions of rescue-robot test lanes (RoboCup Rescue, ASTM E54, NIST).

Each has forty start and goal pairs, the first ten are those of the studies, and a survey with unseen cells; the
numbers below are metres unless said."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, radians, tan

import numpy as np

from hal.lidar.caster import Surface
from hal.scenes.canvas import Canvas, Rect
from hal.scenes.scene import Goal, Pose, Scene
from hal.scenes.survey import draw_pairs, survey

GRID_RESOLUTION = 0.02
HEIGHT_NOISE = 0.007
"""Standard deviation of the surveyed heights."""
WALL_THICKNESS = 0.04
"""Thickness of a wall: two cells."""
TILE_SIDE = 1.2
HALF_RISE = 0.6 * tan(radians(15.0))
"""Rise of a half ramp, 0.6 long."""

Quadrants = Sequence[Sequence[str]]


def _finish(
    canvas: Canvas,
    name: str,
    description: str,
    *,
    start: Pose,
    goals: dict[str, Goal],
    stations: Sequence[tuple[float, float, float]],
    lanes: Sequence[Rect],
    must: Sequence[Rect] = (),
    seed: int,
    grazing: float,
    relief: float = 0.45,
) -> Scene:
    """Survey, queries and the scene. `grazing` [deg] is the flattest look that still measures a height: chosen so
    that about a tenth of the ground along the pairs stays unseen, as in the published benchmark."""
    surface = Surface(canvas.array(), canvas.resolution, canvas.origin)
    x0, y0 = canvas.origin
    x1, y1 = float(canvas.x[0, -1]), float(canvas.y[-1, 0])
    return Scene(
        name=name,
        height=surface.height,
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=start,
        goals=goals,
        description=description,
        allowed_area=((x0, y0), (x1, y0), (x1, y1), (x0, y1)),
        survey=survey(surface, stations, seed, noise=HEIGHT_NOISE, grazing=radians(grazing)),
        pairs=draw_pairs(surface, lanes, seed, must=must, highest=relief),
    )


def _quarters(canvas: Canvas, x: float, y: float, uphill: Quadrants, base: Sequence[Sequence[float]]) -> None:
    """One tile of four half-size ramps; `uphill[row][column]` and `base[row][column]`, row 0 at low y."""
    half = 0.5 * TILE_SIDE
    for i in range(2):
        for j in range(2):
            rect = (x + j * half, x + (j + 1) * half, y + i * half, y + (i + 1) * half)
            canvas.ramp(rect, base[i][j], base[i][j] + HALF_RISE, uphill[i][j])


def slopes() -> Scene:
    """8.4 x 3.6: one lane of continuous 15 deg ramps beside one of crossing half ramps with a pinwheel; linked at
    both ends."""
    canvas = Canvas((0.0, 8.4, 0.0, 3.6), GRID_RESOLUTION)
    for k in range(5):
        x = TILE_SIDE * (1 + k)
        canvas.ramp((x, x + 0.6, 0.6, 1.8), 0.02, 0.02 + HALF_RISE, "+x")
        canvas.ramp((x + 0.6, x + 1.2, 0.6, 1.8), 0.02, 0.02 + HALF_RISE, "-x")
    flat = ((0.0, 0.0), (0.0, 0.0))
    crossing: Quadrants = (("+x", "-x"), ("-y", "+x"))
    turned: Quadrants = (("-x", "+y"), ("+x", "-x"))
    for k, pattern in enumerate((crossing, turned, None, crossing, turned)):
        x = TILE_SIDE * (1 + k)
        if pattern is None:  # pinwheel: two quarters rise to one half ramp, two go on to twice that
            _quarters(canvas, x, 1.8, (("+x", "+y"), ("-y", "-x")), ((0.0, HALF_RISE), (HALF_RISE, 0.0)))
        else:
            _quarters(canvas, x, 1.8, pattern, flat)
    for y in (0.6, 3.0):
        canvas.bar((0.0, y), (8.4, y), WALL_THICKNESS, 0.5)
    for x in (0.02, 8.38):
        canvas.bar((x, 0.6), (x, 3.0), WALL_THICKNESS, 0.5)
    canvas.bar((TILE_SIDE, 1.8), (6 * TILE_SIDE, 1.8), WALL_THICKNESS, 0.5)
    return _finish(
        canvas,
        "rescue_slopes",
        "rescue lanes: continuous 15 deg ramps beside crossing half ramps and a pinwheel",
        start=(0.6, 1.2, 0.0),
        goals={"ramps_end": (7.8, 1.2, 0.0), "crossing_end": (7.8, 2.4, 0.0), "home": (0.6, 1.2, pi)},
        stations=(
            *((0.5, 1.2, 0.8), (0.5, 2.4, 0.8), (7.9, 1.2, 0.8), (7.9, 2.4, 0.8)),
            *((3.0, 1.2, 0.7), (5.4, 1.2, 0.7)),
            *((2.4, 2.4, 0.7), (4.2, 2.4, 0.7), (6.0, 2.4, 0.7)),
        ),
        lanes=((0.3, 8.1, 0.9, 1.5), (0.3, 8.1, 2.1, 2.7)),
        seed=101,
        grazing=15.0,
    )


def platform() -> Scene:
    """8.4 x 4.8: a 20 deg ramp over a 0.40 platform, or a lane with three curbs of 0.05 to 0.10, one of them at 45
    deg."""
    canvas = Canvas((0.0, 8.4, 0.0, 4.8), GRID_RESOLUTION)
    top, run = 0.40, 0.40 / tan(radians(20.0))
    canvas.ramp((2.0, 2.0 + run, 3.0, 4.2), 0.0, top, "+x")
    canvas.box((2.0 + run, 5.3, 3.0, 4.2), top)
    canvas.ramp((5.3, 5.3 + top / tan(radians(15.0)), 3.0, 4.2), 0.0, top, "-x")
    canvas.bar((2.6, 0.4), (2.6, 2.2), 0.10, 0.05)
    canvas.bar((3.5, 0.4), (5.3, 2.2), 0.10, 0.095)
    canvas.bar((6.2, 0.4), (6.2, 2.2), 0.10, 0.10)
    for y in (0.4, 2.2, 3.0, 4.2):
        canvas.bar((1.6, y), (6.8, y), WALL_THICKNESS, 0.6 if y < 2.5 else 1.0)
    canvas.border(WALL_THICKNESS, 0.6)
    return _finish(
        canvas,
        "rescue_platform",
        "rescue lanes: 20 deg ramp over a 0.40 m platform beside a lane with curbs",
        start=(0.8, 2.4, 0.0),
        goals={
            "platform": (4.2, 3.6, 0.0),
            "far": (7.6, 2.4, 0.0),
            "curbs": (4.2, 0.9, None),
            "home": (0.8, 2.4, pi),
        },
        stations=(
            (0.6, 2.4, 0.9),
            (7.8, 2.4, 0.9),
            (2.2, 1.3, 0.7),
            (5.9, 1.4, 0.7),
            (4.0, 3.6, 0.6),
            (1.2, 3.7, 1.0),
            (7.2, 3.7, 0.8),
        ),
        lanes=((0.4, 1.4, 0.5, 4.3), (7.0, 8.0, 0.5, 4.3), (1.6, 6.8, 0.7, 1.9), (3.2, 5.2, 3.3, 3.9)),
        must=((2.3, 2.9, 3.4, 3.8), (2.3, 2.9, 3.4, 3.8)),
        seed=102,
        grazing=9.3,
    )


def _pallet(canvas: Canvas, x: float, y: float, posts: np.ndarray) -> None:
    """A stepfield pallet: 10 x 10 posts of 0.12 on a 0.05 base, heights above it in `posts` (10, 10)."""
    side = TILE_SIDE / 10
    for i in range(10):
        for j in range(10):
            canvas.box(
                (x + j * side, x + (j + 1) * side, y + i * side, y + (i + 1) * side), 0.05 + posts[i, j]
            )


def steps() -> Scene:
    """8.4 x 4.8: 3 x 3 stepfield pallets, then K-rails of 0.10 every 0.6; a flat detour 0.6 wide runs beside all of
    it."""
    canvas = Canvas((0.0, 8.4, 0.0, 4.8), GRID_RESOLUTION)
    random = np.random.default_rng(3)
    along = np.arange(10)
    for i in range(3):
        for j in range(3):
            if (i, j) == (1, 1):  # diagonal hill: 0.4 on the diagonal, falling by a post height per two rows
                away = np.abs(along[:, None] - along[None, :])
                posts = np.array([0.4, 0.4, 0.3, 0.2, 0.1, 0.05])[np.minimum(away, 5)]
            else:  # half-cubic: 5 to 20 cm in half units, low at the rim of the field
                posts = random.choice([0.0, 0.05, 0.10, 0.15], (10, 10), p=[0.4, 0.3, 0.2, 0.1])
            _pallet(canvas, 1.5 + TILE_SIDE * j, 0.10 + TILE_SIDE * i, posts)
    for x in (5.6, 6.2, 6.8):
        canvas.bar((x, 0.10), (x + 0.5, 3.70), 0.10, 0.10)
    canvas.box((1.5, 7.4, 4.30, 4.8), 0.6)
    canvas.border(WALL_THICKNESS, 0.6)
    return _finish(
        canvas,
        "rescue_steps",
        "rescue lanes: stepfields and K-rails, with a narrow flat detour",
        start=(0.7, 2.0, 0.0),
        goals={"far": (7.9, 2.0, 0.0), "detour": (4.5, 4.0, 0.0), "home": (0.7, 2.0, pi)},
        stations=(
            *((0.7, 1.0, 0.9), (0.7, 3.0, 0.9), (7.9, 1.0, 1.0), (7.9, 3.0, 1.0)),
            *((2.1, 0.7, 1.0), (2.1, 3.1, 1.0), (4.5, 0.7, 1.0), (4.5, 3.1, 1.0)),
            (3.3, 4.0, 1.0),
        ),
        lanes=((0.4, 1.2, 0.4, 4.3), (7.7, 8.0, 0.4, 4.3), (1.5, 7.3, 0.5, 3.4), (1.5, 7.3, 3.95, 4.05)),
        seed=103,
        grazing=14.0,
    )


def elevated() -> Scene:
    """8.4 x 4.8: 41 deg stairs to 1.03, a bridge 0.6 wide, a 27 deg ramp down; 0.2 hurdles below; a 45 deg ramp."""
    canvas = Canvas((0.0, 8.4, 0.0, 4.8), GRID_RESOLUTION)
    top, tread = 1.03, 0.23
    for k in range(5):  # 0.23, then four risers of 0.20
        canvas.box((1.4 + tread * k, 2.6, 3.0, 4.18), 0.23 + 0.20 * k)
    canvas.box((2.55, 3.6, 2.7, 4.18), top)
    canvas.ramp((2.6, 3.6, 2.7 - top, 2.7), 0.0, top, "+y")
    canvas.box((3.6, 4.8, 3.3, 3.9), top)
    canvas.box((4.8, 5.3, 3.0, 4.18), top)
    canvas.ramp((5.3, 5.3 + top / tan(radians(27.0)), 3.0, 4.18), 0.0, top, "-x")
    for x in (3.0, 4.2, 5.4):
        canvas.bar((x, 0.04), (x, 1.4), 0.10, 0.20)
    canvas.bar((3.7, 1.4), (7.0, 1.4), WALL_THICKNESS, 0.6)
    canvas.border(WALL_THICKNESS, 0.6)
    return _finish(
        canvas,
        "rescue_elevated",
        "rescue lanes: stairs, a narrow bridge and a ramp 1.03 m up, hurdles below",
        start=(0.7, 2.0, 0.0),
        goals={"bridge": (4.2, 3.6, 0.0), "far": (7.8, 2.2, 0.0), "home": (0.7, 2.0, pi)},
        stations=(
            (0.6, 2.0, 1.0),
            (7.8, 2.4, 1.0),
            (3.0, 3.6, 0.8),
            (5.0, 3.6, 0.8),
            (4.8, 2.2, 0.8),
            (2.0, 0.7, 0.9),
            (6.2, 0.7, 0.9),
            (0.8, 4.2, 1.0),
        ),
        lanes=(
            (0.4, 1.2, 0.4, 4.3),
            (7.5, 8.0, 0.4, 4.3),
            (2.8, 3.4, 3.0, 3.9),
            (5.6, 7.0, 3.4, 3.8),
            (3.9, 6.8, 0.4, 1.1),
            (4.0, 7.0, 1.8, 2.7),
        ),
        must=(
            *((1.6, 2.3, 3.4, 3.8),) * 3,
            *((2.9, 3.3, 1.9, 2.4),) * 3,
        ),
        seed=104,
        grazing=11.0,
        relief=0.7,
    )
