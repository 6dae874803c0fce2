"""What the baselines share: the places of a request."""

from __future__ import annotations

import numpy as np

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.search import PlanRequest


def places(grid: ElevationGrid, request: PlanRequest) -> tuple[tuple[float, float], tuple[float, float]]:
    """Start and goal x, y [m]. Raises PlanningError for node indices, NoRoute off the map."""
    out = []
    x0, y0, x1, y1 = grid.extent
    for name, place in (("start", request.start), ("goal", request.goal)):
        if isinstance(place, (int, np.integer)):
            raise PlanningError(f"the {name} must be x, y in metres: a baseline has no nodes")
        x, y = float(place[0]), float(place[1])
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            raise NoRoute(
                NoRouteReason.OUTSIDE_MAP, f"{name} ({x:.2f}, {y:.2f}) is outside the map: move it inside"
            )
        out.append((x, y))
    return out[0], out[1]
