"""A polygon the robot must stay in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hal.errors import OperatorError
from hal.go2w import BODY_WIDTH


class GeofenceError(OperatorError):
    """The polygon is not usable; the message says why."""


Corner = tuple[float, float]
Side = tuple[Corner, Corner]


def _turn(a: Corner, b: Corner, c: Corner) -> float:
    """Positive where a, b, c turn left, negative where they turn right, 0 on a line."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _within(p: Corner, side: Side) -> bool:
    """Whether a point on the line of `side` lies on `side`."""
    return all(min(a, b) <= v <= max(a, b) for v, a, b in zip(p, *side, strict=True))


def _meet(one: Side, other: Side) -> bool:
    """Whether two sides have a point in common."""
    a, b = (_turn(*one, p) for p in other)
    c, d = (_turn(*other, p) for p in one)
    if a * b < 0.0 and c * d < 0.0:
        return True
    touching = [(a, other[0], one), (b, other[1], one), (c, one[0], other), (d, one[1], other)]
    return any(turn == 0.0 and _within(p, side) for turn, p, side in touching)


def _doubles_back(one: Side, other: Side) -> bool:
    """Whether two sides with a corner in common have more than that in common."""
    ends = [p for p in one if p not in other], [p for p in other if p not in one]
    return any(
        _turn(*side, p) == 0.0 and _within(p, side) for side, (p,) in zip((other, one), ends, strict=True)
    )


@dataclass(frozen=True, slots=True)
class Geofence:
    """A simple polygon in the `map` frame; corners x, y [m] in order, closed by itself."""

    corners: tuple[tuple[float, float], ...]

    @staticmethod
    def of(points: Sequence[Sequence[float]]) -> Geofence:
        """Check and build. Raises GeofenceError unless finite corners span an area with sides that do not meet.

        Corners that repeat the one before, and a last one that repeats the first, are left out.
        """
        try:
            corners = tuple((float(x), float(y)) for x, y in points)
        except (TypeError, ValueError) as error:
            raise GeofenceError(f"a geofence is a list of x, y pairs in metres: {error}") from error
        if len(corners) < 3 or not all(math.isfinite(v) for corner in corners for v in corner):
            raise GeofenceError("a geofence needs at least three finite corners")
        corners = tuple(a for a, b in zip(corners, corners[1:] + corners[:1], strict=True) if a != b)
        sides = list(zip(corners, corners[1:] + corners[:1], strict=True))
        twice_area = sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in sides)
        if abs(twice_area) < 1e-6:
            raise GeofenceError("the geofence has no area")
        for i, one in enumerate(sides):
            for j in range(i + 1, len(sides)):
                neighbours = j == i + 1 or (i == 0 and j == len(sides) - 1)
                if _doubles_back(one, sides[j]) if neighbours else _meet(one, sides[j]):
                    raise GeofenceError(
                        f"sides of the geofence cross: {one[0]} - {one[1]} and {sides[j][0]} - {sides[j][1]}; "
                        "give its corners in order around it"
                    )
        return Geofence(corners)

    def outside(self, x: float, y: float) -> float:
        """Distance out of the polygon [m]; negative inside (distance to the nearest edge)."""
        # Plain comparisons: `min` and `max` take half of the time, and this runs two times at each tick of the gate.
        inside, nearest = False, math.inf
        previous_x, previous_y = self.corners[-1]
        for corner_x, corner_y in self.corners:
            dx, dy = corner_x - previous_x, corner_y - previous_y
            squared = dx * dx + dy * dy
            along = ((x - previous_x) * dx + (y - previous_y) * dy) / squared if squared > 0.0 else 0.0
            along = 0.0 if along < 0.0 else 1.0 if along > 1.0 else along
            away = math.hypot(x - previous_x - along * dx, y - previous_y - along * dy)
            nearest = away if away < nearest else nearest
            if (corner_y > y) != (previous_y > y) and x < previous_x + (y - previous_y) * dx / dy:
                inside = not inside
            previous_x, previous_y = corner_x, corner_y
        return -nearest if inside else nearest

    def speed(
        self, pose: tuple[float, float, float], speed: float, course: float, margin: float, horizon: float
    ) -> float:
        """The most of `speed` [m/s] in direction `course` [rad, base_link] that keeps the front of the body inside.

        `pose`: x, y [m], yaw [rad]; what lies up to `margin` [m] ahead must stay inside for `horizon` [s].
        """
        x, y, yaw = pose
        if not all(map(math.isfinite, pose)):
            return 0.0
        c, s = math.cos(yaw + course), math.sin(yaw + course)
        most, soon = speed, margin + speed * horizon
        if self.outside(x, y) < -(soon + BODY_WIDTH):  # no side is near
            return most
        for side in (0.0, 0.5 * BODY_WIDTH, -0.5 * BODY_WIDTH):
            ahead = self.outside(x + soon * c - side * s, y + soon * s + side * c)
            if ahead <= 0.0:
                continue
            here = self.outside(x + margin * c - side * s, y + margin * s + side * c)
            if ahead >= here:
                most = min(most, max(0.0, -here) / horizon)
        return most
