"""A polygon the robot must stay in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


class GeofenceError(ValueError):
    """The polygon is not usable; the message says why."""


@dataclass(frozen=True, slots=True)
class Geofence:
    """A simple polygon in the `map` frame; corners x, y [m] in order, closed by itself."""

    corners: tuple[tuple[float, float], ...]

    @staticmethod
    def of(points: Sequence[Sequence[float]]) -> Geofence:
        """Check and build. Raises GeofenceError unless there are three finite corners spanning an area."""
        try:
            corners = tuple((float(x), float(y)) for x, y in points)
        except (TypeError, ValueError) as error:
            raise GeofenceError(f"a geofence is a list of x, y pairs in metres: {error}") from error
        if len(corners) < 3 or not all(math.isfinite(v) for corner in corners for v in corner):
            raise GeofenceError("a geofence needs at least three finite corners")
        twice_area = sum(
            x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True)
        )
        if abs(twice_area) < 1e-6:
            raise GeofenceError("the geofence has no area")
        return Geofence(corners)

    def outside(self, x: float, y: float) -> float:
        """Distance out of the polygon [m]; negative inside (distance to the nearest edge)."""
        inside, nearest = False, math.inf
        previous_x, previous_y = self.corners[-1]
        for corner_x, corner_y in self.corners:
            dx, dy = corner_x - previous_x, corner_y - previous_y
            squared = dx * dx + dy * dy
            along = ((x - previous_x) * dx + (y - previous_y) * dy) / squared if squared > 0.0 else 0.0
            along = min(1.0, max(0.0, along))
            nearest = min(nearest, math.hypot(x - previous_x - along * dx, y - previous_y - along * dy))
            if (corner_y > y) != (previous_y > y) and x < previous_x + (y - previous_y) * dx / dy:
                inside = not inside
            previous_x, previous_y = corner_x, corner_y
        return -nearest if inside else nearest
