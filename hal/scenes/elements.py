"""Elements of rescue lanes as height functions along a lane, and how hard they are for a controller.

An element is drawn in lane coordinates: s [m] along the lane from the element's begin, t [m] across it from the
middle, both as arrays. Dimensions follow the standard apparatus (half ramps of 0.6 m, bars and rails 0.10 m wide,
fields of 10 x 10 posts)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos, radians, sin, tan

import numpy as np
from numpy.typing import NDArray

from hal.robots import Lanes

Field = NDArray[np.float64]

HALF_RAMP = 0.6
"""Length of a half ramp [m]."""
BAR_WIDTH = 0.10
"""Width of a bar or rail [m]."""
PIT_DEPTH = -0.4
"""Depth of a gap [m]."""
TRACK_WIDTH = 0.386
"""Between the middle planes of left and right wheels [m]."""

HEIGHT_SHARES = {1: (0.30, 0.45), 2: (0.50, 0.65), 3: (0.70, 0.80), 4: (0.90, 1.00)}
"""Share of what the robot drives over that the elements of a level ask for."""
MOST_OBLIQUE = {1: 15.0, 2: 30.0, 3: 45.0, 4: 60.0}
"""Largest angle [deg] between a face and the head-on way over it."""
PASSAGE_WIDTHS = {1: 0.85, 2: 0.80, 3: 0.75, 4: 0.70}
"""Width beside a thin wall [m]; the body is 0.43 m wide."""


@dataclass(frozen=True, slots=True)
class Grade:
    """Limits of the elements of one lane."""

    level: int
    robot: Lanes
    width: float
    """Of the lane [m]."""

    def draw(self, random: np.random.Generator, what: str) -> float:
        """A value of the level for `what` of `Lanes.within`."""
        low, high = HEIGHT_SHARES[self.level]
        return self.robot.within[what] * float(random.uniform(low, high))

    def angle(self, random: np.random.Generator) -> float:
        """Signed angle [rad] of a face to the head-on way over it."""
        most = MOST_OBLIQUE[self.level]
        return radians(float(random.choice([-1.0, 1.0]) * random.uniform(max(0.0, most - 20.0), most)))


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """A piece of a lane."""

    kind: str
    length: float
    """Along the lane [m]."""
    height: Callable[[Field, Field], Field]
    """(s, t) -> height above the floor [m], for 0 <= s <= `length`."""
    beside: float = 0.0
    """t [m] at which a body passes it."""
    wall: tuple[float, float, float] | None = None
    """A wall along the lane: s of its begin and end, t [m]."""


def wave(s: Field, half: float) -> Field:
    """Triangle wave 0..1 with half period `half` [m], 0 at s <= 0."""
    phase = np.maximum(s, 0.0) / half % 2.0
    return np.minimum(phase, 2.0 - phase)


def flat(length: float) -> Element:
    """Level ground."""
    return Element("flat", length, lambda s, t: np.zeros_like(s))


def ramps(random: np.random.Generator, grade: Grade) -> Element:
    """Continuous half ramps: two ridges across the whole lane."""
    top = HALF_RAMP * tan(radians(grade.draw(random, "slope")))
    return Element("ramps", 4 * HALF_RAMP, lambda s, t: top * wave(s, HALF_RAMP))


def crossing(random: np.random.Generator, grade: Grade) -> Element:
    """Half ramps in two columns out of step: where the left one rises, the right one falls.

    The face between the columns and the roll of a robot astride it stay inside the level.
    """
    slope = radians(grade.draw(random, "slope"))
    top = min(HALF_RAMP * tan(slope), grade.draw(random, "step"), TRACK_WIDTH * tan(slope))

    def height(s: Field, t: Field) -> Field:
        left = np.where(s < 4 * HALF_RAMP, wave(s, HALF_RAMP), 0.0)
        return top * np.where(t > 0.0, left, wave(s - HALF_RAMP, HALF_RAMP))

    return Element("crossing", 5 * HALF_RAMP, height)


def bars(random: np.random.Generator, grade: Grade) -> Element:
    """Bars 0.10 m wide across the lane at an angle: two, one where the angle is large."""
    high, angle = grade.draw(random, "bar"), grade.angle(random)
    lean = abs(tan(angle)) * 0.5 * grade.width + 0.5 * BAR_WIDTH / cos(angle)
    at = [lean, lean + 0.8] if abs(angle) < radians(35.0) else [lean]

    def height(s: Field, t: Field) -> Field:
        z = np.zeros_like(s)
        for middle in at:
            z[np.abs((s - middle) * cos(angle) + t * sin(angle)) <= 0.5 * BAR_WIDTH] = high
        return z

    return Element("bars", at[-1] + lean, height)


def kerb(random: np.random.Generator, grade: Grade) -> Element:
    """A plateau of 0.8 m with vertical faces at an angle: a kerb up and a kerb down."""
    high, angle = grade.draw(random, "step"), grade.angle(random)
    lean = abs(tan(angle)) * 0.5 * grade.width
    length = 2 * lean + 0.8 / cos(angle)

    def height(s: Field, t: Field) -> Field:
        return np.where(np.abs((s - 0.5 * length) * cos(angle) + t * sin(angle)) <= 0.4, high, 0.0)

    return Element("kerb", length, height)


def rails(random: np.random.Generator, grade: Grade) -> Element:
    """K-rails: two square rails at 45 degrees, one to each side."""
    high, width = grade.draw(random, "rail"), grade.width
    side = float(random.choice([-1.0, 1.0]))

    def height(s: Field, t: Field) -> Field:
        z = np.zeros_like(s)
        for k, turn in enumerate((side, -side)):
            z[np.abs(s - (k + 0.5) * (width + 0.2) + turn * t) <= 0.5 * BAR_WIDTH * 2.0**0.5] = high
        return z

    return Element("rails", 2 * (width + 0.2), height)


def posts(random: np.random.Generator, grade: Grade) -> Element:
    """A half-cubic stepfield: 10 x 10 posts of four heights, low ones more often."""
    high, side = grade.draw(random, "posts"), grade.width / 10
    field = high * random.choice([0.0, 1 / 3, 2 / 3, 1.0], (10, 10), p=[0.4, 0.3, 0.2, 0.1])

    def height(s: Field, t: Field) -> Field:
        i = np.clip(((t + 0.5 * grade.width) / side).astype(int), 0, 9)
        return field[i, np.clip((s / side).astype(int), 0, 9)]

    return Element("posts", grade.width, height)


def gaps(random: np.random.Generator, grade: Grade) -> Element:
    """Two gaps across the lane, 1.0 m apart, and level ground behind them: the next element may begin with a gap."""
    # A gap that no cell centre lies in does not exist: at least two cells of 0.02 m.
    wide = max(grade.draw(random, "gap"), 0.04)
    return Element("gaps", 1.3 + wide, lambda s, t: np.where((s % 1.0 < wide) & (s < 1.2), PIT_DEPTH, 0.0))


def platform(random: np.random.Generator, grade: Grade) -> Element:
    """A ramp up, a level top, a ramp down."""
    up, down = (tan(radians(grade.draw(random, "slope"))) for _ in range(2))
    high, top = float(random.uniform(0.15, 0.30)), 0.9

    def height(s: Field, t: Field) -> Field:
        return np.clip(np.minimum(s * up, (high / up + top + high / down - s) * down), 0.0, high)

    return Element("platform", high / up + top + high / down, height)


def rough(random: np.random.Generator, grade: Grade) -> Element:
    """Random relief on a grid of 0.15 m, linear between, level at both ends."""
    most, grid, length = grade.draw(random, "rough"), 0.15, 1.5
    knots = most * random.uniform(-1.0, 1.0, (int(grade.width / grid) + 3, round(length / grid) + 1))
    knots[:, [0, -1]] = 0.0

    def height(s: Field, t: Field) -> Field:
        u, v = np.clip(s / grid, 0.0, knots.shape[1] - 1.001), (t + 0.5 * grade.width) / grid
        v = np.clip(v, 0.0, knots.shape[0] - 1.001)
        j, i = u.astype(int), v.astype(int)
        a, b = u - j, v - i
        low = (1 - a) * knots[i, j] + a * knots[i, j + 1]
        return (1 - b) * low + b * ((1 - a) * knots[i + 1, j] + a * knots[i + 1, j + 1])

    return Element("rough", length, height)


def thin_wall(random: np.random.Generator, grade: Grade) -> Element:
    """A wall along the lane that leaves a passage on one side and no room on the other."""
    side = float(random.choice([-1.0, 1.0]))
    passage = PASSAGE_WIDTHS[grade.level]
    at = side * (passage - 0.5 * grade.width)
    beside = at - side * 0.5 * passage
    return Element("thin_wall", 3.0, lambda s, t: np.zeros_like(s), beside, (1.2, 1.8, at))


def delayed(e: Element, by: float, length: float) -> Element:
    """The element `by` [m] further on, with level ground before and behind it, `length` [m] in all."""

    def height(s: Field, t: Field) -> Field:
        return np.where((s >= by) & (s < by + e.length), e.height(s - by, t), 0.0)

    return replace(e, length=length, height=height)


def blocker(random: np.random.Generator, grade: Grade) -> Element:
    """An element across the whole lane that the controller cannot drive over: a kerb, a bar, a gap or a ramp."""
    beyond = grade.robot.beyond
    what = str(random.choice(list(beyond)))
    value = float(random.uniform(*beyond[what]))
    if what == "slope":
        rise, run = tan(radians(value)), 0.7
        return Element(
            what, 2 * run + 0.6, lambda s, t: rise * np.clip(np.minimum(s, 2 * run + 0.6 - s), 0.0, run)
        )
    length = {"step": 0.8, "bar": BAR_WIDTH, "gap": value}[what]
    return Element(what, length, lambda s, t: np.full_like(s, PIT_DEPTH if what == "gap" else value))


Maker = Callable[[np.random.Generator, Grade], Element]
MAPS: dict[str, Maker] = {
    "ramps": ramps,
    "crossing": crossing,
    "bars": bars,
    "kerbs": kerb,
    "rails": rails,
    "stepfield": posts,
    "gaps": gaps,
    "platform": platform,
    "rough": rough,
}
"""Elements of a lane; `mixed` draws from all of them and from thin walls."""
