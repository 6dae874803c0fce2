"""Courses of the locomotion envelope: one obstacle type each, driven along +x from the origin.

Every course is a heightfield of 0.02 m cells, 2.4 m wide, flat where the robot starts. A vertical
face therefore rises within one cell.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CELL_SIDE = 0.02
START_X = -0.9
"""x of the first column [m]."""
HALF_WIDTH = 1.2
OBSTACLE_X = 1.0
"""x at which the obstacle begins [m]."""
OBLIQUE_AT = 1.6
"""x [m] at which a face that may lie across the way crosses its middle."""
FACE_ANGLES = (0, 15, 30, 45, 60)
"""Of faces and bars to the head-on way [deg]."""

Field = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Terrain and the x [m] at which it counts as passed."""

    name: str
    height: NDArray[np.float32]
    origin: tuple[float, float]
    finish: float


def _wave(s: Field, half: float) -> Field:
    """Triangle wave 0..1 with half period `half`, 0 at s <= 0."""
    phase = np.maximum(s, 0.0) / half % 2.0
    return np.minimum(phase, 2.0 - phase)


def _ramp_up(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    end = OBSTACLE_X + 2.0 * np.cos(np.radians(value))
    return np.tan(np.radians(value)) * (np.clip(x, OBSTACLE_X, end) - OBSTACLE_X), end + 0.4


def _ramp_down(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    z, end = _ramp_up(x, y, value, seed)
    return z.max() - z, end


def _cross_slope(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    """The ground twists from level to the side slope within 0.8 m."""
    return np.tan(np.radians(value)) * y * np.clip((x - 0.4) / 0.8, 0.0, 1.0), OBSTACLE_X + 2.4


def _step_up(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    return np.where(x > OBSTACLE_X, value / 100.0, 0.0), OBSTACLE_X + 0.8


def _step_down(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    return np.where(x > OBSTACLE_X, 0.0, value / 100.0), OBSTACLE_X + 0.8


def _stairs_up(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    steps = np.clip(np.floor((x - OBSTACLE_X) / 0.30) + 1.0, 0.0, 4.0)
    return steps * value / 100.0, OBSTACLE_X + 0.9 + 0.7


def _stairs_down(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    z, end = _stairs_up(x, y, value, seed)
    return z.max() - z, end


def _gap(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    inside = (x > OBSTACLE_X) & (x <= OBSTACLE_X + value / 100.0 - 0.5 * CELL_SIDE)
    return np.where(inside, -0.5, 0.0), OBSTACLE_X + 0.8


def _crossing(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    """Half ramps of 0.6 m in two lanes; where the left lane rises, the right lane falls. No lane begins or ends with a
    face."""
    top = 0.6 * np.tan(np.radians(value))
    left = np.where(x < OBSTACLE_X + 2.4, _wave(x - OBSTACLE_X, 0.6), 0.0)
    right = np.where(x < OBSTACLE_X + 3.0, _wave(x - OBSTACLE_X - 0.6, 0.6), 0.0)
    return np.where(y > 0.0, left, right) * top, OBSTACLE_X + 3.4


def _pitch_roll(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    """Ridges across the way, then ridges at 45 degrees to it; flanks 0.6 m long."""
    top = 0.6 * np.tan(np.radians(value))
    pitch = _wave(x - OBSTACLE_X, 0.6)
    diagonal = _wave((x - OBSTACLE_X - 2.4 + y) / np.sqrt(2.0), 0.6)
    z = np.where(x <= OBSTACLE_X + 2.4, pitch, np.minimum(diagonal, (x - OBSTACLE_X - 2.4) / 0.6))
    return np.where(x > OBSTACLE_X, z, 0.0) * top, OBSTACLE_X + 4.8


def _krail(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    """Four rails, 0.10 m wide, at 45 degrees to the way, 0.6 m apart along it."""
    z = np.zeros_like(x)
    for k in range(4):
        z = np.where(np.abs((x - OBSTACLE_X - 0.6 - 0.6 * k + y) / np.sqrt(2.0)) <= 0.05, value / 100.0, z)
    return z, OBSTACLE_X + 0.6 * 4 + 0.8


def _face(angle: float) -> Callable[[Field, Field, float, int], tuple[Field, float]]:
    """A face up whose normal is `angle` [deg] off the way, for good."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))

    def terrain(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
        return np.where((x - OBLIQUE_AT) * c + y * s > 0.0, value / 100.0, 0.0), OBLIQUE_AT + 1.2

    return terrain


def _bar(angle: float) -> Callable[[Field, Field, float, int], tuple[Field, float]]:
    """A bar 0.10 m wide whose normal is `angle` [deg] off the way."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))

    def terrain(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
        off = (x - OBLIQUE_AT) * c + y * s
        return np.where(np.abs(off) <= 0.05, value / 100.0, 0.0), OBLIQUE_AT + 1.2

    return terrain


def _rough(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    """Uniform random heights on a 0.15 m grid, linear between; the first half metre fades in."""
    rng = np.random.default_rng(seed)
    u, v = (x[0] - x[0, 0]) / 0.15, (y[:, 0] - y[0, 0]) / 0.15
    knots = rng.uniform(-1.0, 1.0, (int(v[-1]) + 2, int(u[-1]) + 2)) * value / 100.0
    along = np.array([np.interp(u, np.arange(knots.shape[1]), row) for row in knots])
    z = np.array([np.interp(v, np.arange(knots.shape[0]), column) for column in along.T]).T
    return z * np.clip((x - 0.4) / 0.5, 0.0, 1.0), OBSTACLE_X + 3.0


def _posts(x: Field, y: Field, value: float, seed: int) -> tuple[Field, float]:
    """A stepfield 1.2 m long."""
    thirds = posts(x - OBSTACLE_X, y, 10, np.random.default_rng(seed))
    return thirds * value / 300.0, OBSTACLE_X + 2.2


def posts(x: Field, y: Field, columns: int, rng: np.random.Generator) -> Field:
    """A stepfield of so many columns from x = 0 on: posts of 0.12 m of four heights, more low than high ones [thirds of
    the highest]."""
    column, row = (np.floor(v / 0.12).astype(int) for v in (x, y - y[0, 0]))
    thirds = rng.choice(4, (row.max() + 1, columns), p=[0.4, 0.3, 0.2, 0.1])
    inside = (column >= 0) & (column < columns)
    return np.where(inside, thirds[row, np.clip(column, 0, columns - 1)], 0)


_KINDS: dict[str, Callable[[Field, Field, float, int], tuple[Field, float]]] = {
    "ramp_up": _ramp_up,
    "ramp_down": _ramp_down,
    "cross_slope": _cross_slope,
    "step_up": _step_up,
    "step_down": _step_down,
    "stairs_up": _stairs_up,
    "stairs_down": _stairs_down,
    "gap": _gap,
    "crossing": _crossing,
    "pitch_roll": _pitch_roll,
    "krail": _krail,
    "rough": _rough,
    "posts": _posts,
    **{f"face{angle}": _face(angle) for angle in FACE_ANGLES},
    **{f"bar{angle}": _bar(angle) for angle in FACE_ANGLES},
}


def course(name: str, variant: int = 0) -> Course:
    """`KIND_VALUE`, e.g. `ramp_up_25` [deg], `step_up_10` [cm]. `variant` draws another random ground of the same
    kind."""
    kind, _, value = name.rpartition("_")
    if kind not in _KINDS:
        raise ValueError(f"no course {name!r}; kinds are {', '.join(_KINDS)}, e.g. step_up_10")
    xs = np.arange(round(8.4 / CELL_SIDE)) * CELL_SIDE + START_X
    ys = np.arange(-round(HALF_WIDTH / CELL_SIDE), round(HALF_WIDTH / CELL_SIDE) + 1) * CELL_SIDE
    x, y = np.meshgrid(xs, ys)
    z, finish = _KINDS[kind](x, y, float(value), zlib.crc32(name.encode()) + variant)
    return Course(name, z.astype(np.float32), (START_X, float(ys[0])), float(finish))


def rolling_ground(seed: int = 5) -> tuple[NDArray[np.float32], tuple[float, float]]:
    """10 x 10 m of hills with slopes up to 21 degrees and +-3 cm roughness, centred on the origin; 500 x 500 cells."""
    n = 500
    axis = (np.arange(n) - (n - 1) / 2.0) * CELL_SIDE
    x, y = np.meshgrid(axis, axis)
    hills = np.sin(2.0 * np.pi * x / 4.0) * np.cos(2.0 * np.pi * y / 4.6)
    slope = np.hypot(*np.gradient(hills, CELL_SIDE)).max()
    hills *= np.tan(np.radians(21.0)) / slope
    rough, _ = _rough(x + 100.0, y, 3.0, seed)
    return (hills + rough).astype(np.float32), (float(axis[0]), float(axis[0]))
