"""People who walk past the robot: the same ones for the same seed. They step aside for it, so it is never pushed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hal.lidar.caster import OrientedBox

PERSON_SIZE = (0.3, 0.45, 1.7)
"""Of a person: deep, wide, tall [m]."""
WALK_SPEEDS = 0.5, 1.6
"""Slowest and fastest walk [m/s]."""
PASSING_DISTANCES = 0.8, 3.0
"""Nearest and farthest that a walk passes the place where the robot was when it began [m]."""
WALK_REACH = 4.0
"""Half the length of a walk [m]."""
LEAST_ROOM = 0.8
"""Nobody comes nearer to the middle of the robot [m]."""


@dataclass(slots=True)
class _Walk:
    begin: float
    """[s]; the first ones began before the robot was there."""
    end: float
    start: tuple[float, float]
    """[m]"""
    velocity: tuple[float, float]
    """[m/s]"""


class People:
    """`count` people, each on one straight walk after the other."""

    def __init__(self, count: int, seed: int) -> None:
        streams = np.random.SeedSequence([seed, 0x9E0]).spawn(count)
        self._draws = [np.random.default_rng(stream) for stream in streams]
        self._walks = [_Walk(-math.inf, -math.inf, (0.0, 0.0), (0.0, 0.0)) for _ in range(count)]

    def at(self, time: float, robot: tuple[float, float]) -> list[OrientedBox]:
        """Where they are `time` [s] after connect; `robot` x, y [m] is there."""
        return [self._one(k, time, robot) for k in range(len(self._walks))]

    def _one(self, k: int, time: float, robot: tuple[float, float]) -> OrientedBox:
        walk = self._walks[k]
        if time >= walk.end:
            walk = self._walks[k] = self._next(k, time, robot)
        vx, vy = walk.velocity
        x = walk.start[0] + vx * (time - walk.begin)
        y = walk.start[1] + vy * (time - walk.begin)
        dx, dy = x - robot[0], y - robot[1]
        apart = math.hypot(dx, dy)
        if apart < LEAST_ROOM:
            far = LEAST_ROOM / max(apart, 1e-6)
            x, y = robot[0] + far * dx, robot[1] + far * dy
        return OrientedBox((x, y, 0.5 * PERSON_SIZE[2]), PERSON_SIZE, math.atan2(vy, vx))

    def _next(self, k: int, time: float, robot: tuple[float, float]) -> _Walk:
        draw = self._draws[k]
        heading, speed = draw.uniform(-math.pi, math.pi), draw.uniform(*WALK_SPEEDS)
        side = draw.choice((-1.0, 1.0)) * draw.uniform(*PASSING_DISTANCES)
        c, s = math.cos(heading), math.sin(heading)
        start = robot[0] - WALK_REACH * c - side * s, robot[1] - WALK_REACH * s + side * c
        lasts = 2.0 * WALK_REACH / speed
        begin = time if math.isfinite(self._walks[k].end) else time - draw.uniform(0.0, lasts)
        return _Walk(begin, begin + lasts, start, (speed * c, speed * s))
