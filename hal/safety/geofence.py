"""Polygons that the robot must stay in, and such that it must keep out of; its whole body counts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from hal.errors import OperatorError


class GeofenceError(OperatorError):
    """The polygon is not usable; the message says why."""


Corner = tuple[float, float]
Side = tuple[Corner, Corner]
Size = tuple[float, float]
"""Length and width of the body [m]."""
Pose = tuple[float, float, float]
"""x, y [m], yaw [rad] in `map`."""
ROOM_BESIDE = 0.05
"""[m] that a driven body keeps on each side: a robot along a side can still turn off it, with its tail that swings out.
"""
SAME_DEPTH = 1e-3
"""[m] A robot over a side may move where it comes no deeper than so much."""
LEAST_SPEED = 0.02
"""[m/s] Nearer to a side a robot that would be slower stands."""
STEP_COUNT = 4
"""Of a turn, or of the way out, that are looked at."""


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
    keep_out: bool = False
    """The robot stays out of it; else inside."""
    name: str = ""

    @staticmethod
    def of(points: Sequence[Sequence[float]], *, keep_out: bool = False, name: str = "") -> Geofence:
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
        return Geofence(corners, keep_out, name)

    @property
    def words(self) -> str:
        """What lies behind its sides."""
        if self.keep_out:
            return f"the keep-out area {self.name}".rstrip()
        return "the edge of the allowed area" + (f" {self.name}" if self.name else "")

    def breach(self, x: float, y: float) -> float:
        """How far a place is on the wrong side [m]; negative on the right one (distance to the nearest side)."""
        outside = self.outside(x, y)
        return -outside if self.keep_out else outside

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

    def free(self, pose: Pose, course: float, margin: float, most: float, width: float) -> float:
        """How far [m], up to `most`, the body, `width` [m] wide, may move in direction `course` [rad, base_link] with
        its end `margin` [m] ahead of base_link. A body that is over a side already may move if it comes no deeper."""
        x, y, yaw = pose
        here = self.breach(x, y)
        if here < -(margin + most + width):  # no side is near
            return most
        c, s = math.cos(yaw + course), math.sin(yaw + course)
        free = 0.0 if here > 0.0 else most
        for (x0, y0), (x1, y1) in self._sides():
            across = 0.5 * width + ROOM_BESIDE
            a, b = (
                (c * (x0 - x) + s * (y0 - y), c * (y0 - y) - s * (x0 - x)),
                (c * (x1 - x) + s * (y1 - y), c * (y1 - y) - s * (x1 - x)),
            )
            low, high = _clipped(a, b, across)
            if high >= 0.0:
                free = min(free, max(0.0, max(low, 0.0) - margin))
        if free > 0.0:
            return free
        ways = (
            self.breach(x + k / STEP_COUNT * most * c, y + k / STEP_COUNT * most * s)
            for k in range(1, STEP_COUNT + 1)
        )
        return (
            most if all(way <= here + (SAME_DEPTH if here <= 0.0 else -SAME_DEPTH) for way in ways) else 0.0
        )

    def free_turn(self, pose: Pose, most: float, size: Size) -> float:
        """How far [rad] of the turn `most` (positive to the left) the body of `size` stays on the right side. A body
        that is over a side already may turn if it comes no deeper."""
        x, y, yaw = pose
        if not most or self.breach(x, y) < -0.5 * math.hypot(*size):
            return most
        here = self._room((x, y, yaw), size)
        for k in range(1, STEP_COUNT + 1):
            if self._room((x, y, yaw + k / STEP_COUNT * most), size) < min(1.0, here - 1e-6):
                return (k - 1) / STEP_COUNT * most
        return most

    def _room(self, pose: Pose, size: Size) -> float:
        """By what the body could be scaled until it met a side; negative where its middle is on the wrong side."""
        (x, y, yaw), (length, width) = pose, size
        c, s = 2.0 * math.cos(yaw), 2.0 * math.sin(yaw)
        room = math.inf
        for (x0, y0), (x1, y1) in self._sides():
            # in half bodies: the body is the square from -1 to 1
            a = (c * (x0 - x) + s * (y0 - y)) / length, (c * (y0 - y) - s * (x0 - x)) / width
            b = (c * (x1 - x) + s * (y1 - y)) / length, (c * (y1 - y) - s * (x1 - x)) / width
            u, v = b[0] - a[0], b[1] - a[1]
            # max(|x|, |y|) along a side is least at an end, on an axis, or where both are as large
            for up, down in (
                (0.0, 1.0),
                (1.0, 1.0),
                (-a[0], u),
                (-a[1], v),
                (a[1] - a[0], u - v),
                (-a[0] - a[1], u + v),
            ):
                at = up / down if down else 0.0
                if 0.0 <= at <= 1.0:
                    room = min(room, max(abs(a[0] + at * u), abs(a[1] + at * v)))
        return -room if self.breach(x, y) > 0.0 else room

    def _sides(self) -> Iterator[Side]:
        previous = self.corners[-1]
        for corner in self.corners:
            yield previous, corner
            previous = corner


def _clipped(a: Corner, b: Corner, across: float) -> tuple[float, float]:
    """Least and most x of the part of a side with y from -`across` to `across`; most is below least if there is
    none."""
    (x0, y0), (x1, y1) = sorted((a, b), key=lambda p: p[1])
    if y0 > across or y1 < -across:
        return math.inf, -math.inf
    slope = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
    ends = x0 + slope * (max(y0, -across) - y0), x1 + slope * (min(y1, across) - y1)
    return (min(ends), max(ends)) if y1 > y0 else (min(x0, x1), max(x0, x1))


@dataclass(frozen=True, slots=True)
class Fence:
    """All polygons together; none means no fence."""

    polygons: tuple[Geofence, ...] = ()

    @staticmethod
    def of(area: Sequence[Corner] | None, keepout: Mapping[str, Sequence[Corner]] | None = None) -> Fence:
        """From a configuration. Raises GeofenceError."""
        stay = [Geofence.of(area)] if area is not None else []
        return Fence((*stay, *(Geofence.of(p, keep_out=True, name=n) for n, p in (keepout or {}).items())))

    def __bool__(self) -> bool:
        return bool(self.polygons)

    def and_all_of(self, other: Fence) -> Fence:
        """Both count."""
        return Fence(self.polygons + other.polygons)

    def breach(self, x: float, y: float) -> tuple[float, Geofence | None]:
        """Depth [m] of a place beyond the nearest side of all polygons, negative while it is on the right side; and
        that polygon."""
        return max(
            ((p.breach(x, y), p) for p in self.polygons), key=lambda b: b[0], default=(-math.inf, None)
        )

    def speed(
        self, pose: Pose, speed: float, course: float, margin: float, horizon: float, width: float
    ) -> tuple[float, Geofence | None]:
        """The most of `speed` [m/s] in direction `course` [rad, base_link] that keeps the body on the right side, and
        what sets it.

        What lies up to `margin` [m] ahead of base_link must stay there for `horizon` [s]."""
        most, by = speed, None
        known = all(map(math.isfinite, pose))
        for polygon in self.polygons:
            free = polygon.free(pose, course, margin, speed * horizon, width) / horizon if known else 0.0
            if free < most:
                most, by = free if free > LEAST_SPEED else 0.0, polygon
        return most, by

    def turn(self, pose: Pose, rate: float, horizon: float, size: Size) -> tuple[float, Geofence | None]:
        """The most of the yaw rate `rate` [rad/s] that keeps the body on the right side for `horizon` [s], and what
        sets it."""
        most, by = rate, None
        known = all(map(math.isfinite, pose))
        for polygon in self.polygons:
            free = polygon.free_turn(pose, rate * horizon, size) / horizon if known else 0.0
            if abs(free) < abs(most):
                most, by = free, polygon
        return most, by


NO_FENCE = Fence()
