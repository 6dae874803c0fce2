"""`meadow`: clumps of grass on level ground, and boxes that stand in it."""

from __future__ import annotations

from hal.scenes.canvas import Canvas
from hal.scenes.scene import Scene

LEAF_DENSITY = 3.0
"""Leaves met per metre; a ray crosses a clump of half a metre in one of five times."""
CLUMPS = (
    (-2.0, 0.0, 0.5, 2.4, 0.30),
    (-0.5, -0.6, 0.6, 0.6, 0.20),
    (-0.4, 1.1, 0.4, 0.5, 0.35),
    (1.2, 0.2, 0.5, 3.0, 0.25),
    (2.2, -1.4, 0.7, 0.7, 0.30),
)
"""Middle x, y, size x, y, height [m]."""
BOXES = ((-2.0, 1.9, 0.4, 0.4, 0.30), (1.2, -2.2, 0.4, 0.4, 0.30), (2.6, 1.2, 0.4, 0.4, 0.25))
"""The same of solid boxes: beside a clump, at the end of one, and behind one."""


def meadow() -> Scene:
    """8 x 6 m inside walls. Two belts of grass lie between the start and each goal."""
    from hal.lidar.plants import Clump  # brings numba, which lists of scenes do without

    canvas = Canvas((-4.0, 4.0, -3.0, 3.0), 0.02)
    canvas.border(0.10, 1.0)
    for x, y, a, b, top in BOXES:
        canvas.box((x - a / 2, x + a / 2, y - b / 2, y + b / 2), top)
    return Scene(
        name="meadow",
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=(-3.2, 0.0, 0.0),
        goals={"home": (-3.2, 0.0, 0.0), "through": (3.2, 0.0, 0.0)},
        description="level ground, 8 x 6 m, clumps of grass that the LiDAR sees and boxes among them",
        plants=tuple(Clump((x, y, top / 2), (a, b, top), LEAF_DENSITY) for x, y, a, b, top in CLUMPS),
    )
