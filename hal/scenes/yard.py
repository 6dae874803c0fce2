"""The two scenes for every day: `flat` and `yard`."""

from __future__ import annotations

from math import pi, radians, tan

from hal.scenes.canvas import Canvas
from hal.scenes.scene import Scene

GRID_RESOLUTION = 0.02
"""[m]; a vertical face is one cell wide."""


def _square(half: float) -> tuple[tuple[float, float], ...]:
    return ((-half, -half), (half, -half), (half, half), (-half, half))


def flat() -> Scene:
    """16 x 16 m of level ground; walls and posts at the rim give the LiDAR something to hold on to."""
    canvas = Canvas((-8.0, 8.0, -8.0, 8.0), 0.04)
    canvas.border(0.12, 1.2)
    for x, y in ((-6.5, 4.0), (-3.0, -6.8), (5.2, -6.2), (6.8, 2.4), (1.0, 6.6)):
        canvas.box((x - 0.2, x + 0.2, y - 0.2, y + 0.2), 1.2)
    return Scene(
        name="flat",
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=(0.0, 0.0, 0.0),
        goals={
            "home": (0.0, 0.0, 0.0),
            "a": (3.0, 0.0, 0.0),
            "b": (3.0, 3.0, 0.5 * pi),
            "c": (-3.0, -2.0, pi),
            "far": (-5.0, 5.0, None),
        },
        description="level ground, 16 x 16 m, walls and posts at the rim",
        allowed_area=_square(7.5),
    )


def field(sight: str = "") -> Scene:
    """48 x 48 m of level ground, farther than the LiDAR is used: nothing in sight, one wall ("wall") or two far posts
    ("posts")."""
    canvas = Canvas((-24.0, 24.0, -24.0, 24.0), 0.05)
    if sight == "wall":
        canvas.box((-24.0, 24.0, 8.0, 8.4), 1.5)
    elif sight == "posts":
        canvas.box((12.0, 12.3, 5.0, 5.3), 1.5)
        canvas.box((14.0, 14.3, -6.0, -5.7), 1.5)
    return Scene(
        name=f"field_{sight}" if sight else "field",
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=(0.0, 0.0, 0.0),
        goals={"home": (0.0, 0.0, 0.0), "ahead": (5.0, 0.0, 0.0)},
        description={"wall": "level ground beside one wall", "posts": "level ground, two far posts"}.get(
            sight, "level ground, nothing in sight"
        ),
    )


def yard() -> Scene:
    """12 x 12 m: a walled yard with a ramp to a platform, steps, rough ground, blocks and a hidden wall."""
    canvas = Canvas((-6.0, 6.0, -6.0, 6.0), GRID_RESOLUTION)
    # Rough ground first: relief is added to what is there, solids stand on it.
    canvas.roughen((1.6, 5.0, -2.6, 0.8), 0.03, 0.25, seed=11)
    # Platform with a 15 deg ramp from the west.
    top = 0.40
    run = top / tan(radians(15.0))
    canvas.box((2.6, 5.9, 2.2, 4.8), top)
    canvas.ramp((2.6 - run, 2.6, 2.7, 4.3), 0.0, top, "+x")
    # Steps: a 5 cm plate with a second one 10 cm above it.
    canvas.box((-0.4, 1.2, -2.4, 0.4), 0.05)
    canvas.box((0.0, 0.8, -1.6, -0.2), 0.15)
    # From the start the screen hides the long wall; the way to `behind_wall` leads around both.
    canvas.bar((-6.0, -2.0), (-3.1, -2.0), 0.12, 1.0)
    canvas.bar((-6.0, 1.6), (-1.4, 1.6), 0.12, 1.0)
    for centre, size, yaw, height in (
        ((1.9, -4.9), (0.5, 0.4), 0.3, 0.40),
        ((2.4, -3.4), (0.5, 0.5), 0.8, 0.50),
        ((4.9, 1.4), (0.5, 0.3), 0.0, 0.30),
        ((-2.3, 3.9), (0.6, 0.4), 0.5, 0.30),
        ((0.2, 5.1), (0.4, 0.4), 0.2, 0.60),
        ((-1.9, -0.6), (0.4, 0.4), 0.6, 0.45),
    ):
        canvas.block(centre, size, yaw, height)
    canvas.border(0.10, 1.0)
    return Scene(
        name="yard",
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=(-4.5, -4.5, 0.0),
        goals={
            "home": (-4.5, -4.5, 0.0),
            "a": (-0.5, -4.4, 0.0),
            "b": (4.4, -4.2, 0.5 * pi),
            "rough": (3.3, -0.9, 0.5 * pi),
            "platform": (3.9, 3.5, 0.0),
            "behind_wall": (-4.3, 4.2, pi),
        },
        description="walled yard, 12 x 12 m: ramp to a platform, steps, rough ground, blocks, a hidden wall",
        allowed_area=_square(5.6),
    )
