"""Terrain of the synthetic runs: the benchmark arena, a long corridor, and one feature at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hal.lidar.caster import OrientedBox
from hal.scenes import Scene
from hal.scenes.canvas import Canvas, Rect

OBSTACLE = OrientedBox((1.9, 0.0, 0.4), (0.4, 0.4, 0.8))
"""Stands inside the eastern lobe of the figure-eight until it is taken away."""


def arena() -> Scene:
    """10 x 10 m with 1.2 m walls, crates and ramps around a figure-eight of level ground."""
    canvas = Canvas((-5.0, 5.0, -5.0, 5.0), 0.02)
    canvas.border(0.10, 1.2)
    for centre, size, yaw, top in (
        ((-4.3, 3.9), (0.6, 0.6), 0.2, 0.60),
        ((4.3, 3.4), (0.5, 0.8), -0.3, 0.45),
        ((3.6, -3.9), (0.8, 0.4), 0.5, 0.80),
        ((-2.6, -4.2), (0.4, 0.4), 0.0, 0.50),
        ((-4.4, -2.0), (0.4, 0.6), 0.1, 0.35),
        ((0.2, 4.2), (1.0, 0.4), 0.0, 0.70),
        ((0.1, -2.4), (0.4, 0.4), 0.7, 0.40),
        ((-1.9, 0.1), (0.4, 0.5), 0.3, 0.30),
        ((4.5, 0.3), (0.3, 0.3), 0.0, 1.00),
    ):
        canvas.block(centre, size, yaw, top)
    canvas.ramp((-2.8, -1.4, 2.9, 3.9), 0.0, 0.30, "-x")
    canvas.ramp((1.6, 2.6, 2.8, 4.0), 0.0, 0.25, "+y")
    canvas.ramp((0.8, 2.4, -4.2, -3.2), 0.0, 0.35, "+x")
    return Scene(
        name="arena",
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=(0.0, 0.0, float(np.arctan2(3.0, 3.2))),
        goals={},
        description="benchmark arena, 10 x 10 m",
    )


def corridor(length: float, seed: int = 0) -> Scene:
    """A corridor 6 m wide along +x with crates, recesses and low plates left and right of a 2 m lane."""
    canvas = Canvas((-6.0, length + 6.0, -3.0, 3.0), 0.05)
    canvas.border(0.10, 1.2)
    random = np.random.default_rng(seed)
    for x in np.arange(-4.0, length + 4.0, 1.7):
        side = 1.0 if random.random() < 0.5 else -1.0
        size = random.uniform(0.3, 0.8, 2)
        centre = (x + random.uniform(-0.5, 0.5), side * random.uniform(1.7, 2.7))
        canvas.block(centre, (size[0], size[1]), random.uniform(0.0, 1.5), random.uniform(0.05, 1.2))
    return Scene(
        name="corridor",
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=(0.0, 0.0, 0.0),
        goals={},
        description=f"corridor of {length:.0f} m",
    )


@dataclass(frozen=True, slots=True)
class Feature:
    """Something the map must show."""

    rect: Rect
    """x_min, x_max, y_min, y_max [m] of the ground it covers."""
    top: float
    """Its height above the ground [m]; negative for a pit."""
    face: float
    """x [m] of the side the robot comes from."""


FACE_X = 2.0
FEATURES: dict[str, Feature] = {
    "pole": Feature((FACE_X, FACE_X + 0.05, -0.025, 0.025), 1.2, FACE_X),
    "step": Feature((FACE_X, FACE_X + 2.0, -1.5, 1.5), 0.10, FACE_X),
    "kerb": Feature((FACE_X, FACE_X + 0.10, -1.5, 1.5), 0.10, FACE_X),
    "pit": Feature((FACE_X, FACE_X + 0.60, -0.50, 0.50), -0.30, FACE_X),
}
"""All stand at x = 2 m, across the way of a robot that comes along the x axis."""


def feature_scene(name: str) -> tuple[Scene, tuple[OrientedBox, ...]]:
    """A walled 12 x 8 m hall with one feature; the pole comes as a box because it is as thin as two cells."""
    feature = FEATURES[name]
    canvas = Canvas((-6.0, 6.0, -4.0, 4.0), 0.02)
    boxes: tuple[OrientedBox, ...] = ()
    x0, x1, y0, y1 = feature.rect
    if name == "pole":
        boxes = (
            OrientedBox(
                (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * feature.top), (x1 - x0, y1 - y0, feature.top)
            ),
        )
    elif feature.top > 0.0:
        canvas.box(feature.rect, feature.top)
    else:
        np.copyto(canvas.height, feature.top, where=canvas.inside(feature.rect))
    for centre, size, yaw, top in (
        ((-5.0, 2.8), (0.6, 0.5), 0.3, 0.8),
        ((-2.2, -3.2), (0.5, 0.5), 0.0, 0.6),
        ((0.6, 3.2), (0.8, 0.4), 0.4, 0.7),
        ((4.9, -3.0), (0.5, 0.6), 0.8, 1.0),
    ):
        canvas.block(centre, size, yaw, top)
    canvas.border(0.10, 1.2)
    scene = Scene(
        name=name,
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=(-3.5, 0.0, 0.0),
        goals={},
        description=f"hall with one {name}",
    )
    return scene, boxes
