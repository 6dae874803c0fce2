"""What baselines share: positions in, a `Plan` without a graph out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.risk.terrain import Terrain, heights_at
from planning.search import Plan, PlanRequest


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


def as_plan(
    grid: ElevationGrid, request: PlanRequest, xy: NDArray[np.float64], cost: float, expanded: int
) -> Plan:
    """A plan along the points (n, 2) [m], draped on the map. Points closer than 1 mm to the one before are left out."""
    keep = [xy[0]]
    for p in xy[1:]:
        if np.hypot(*(p - keep[-1])) > 1e-3:
            keep.append(p)
    keep[-1] = xy[-1]
    line = np.array(keep)
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    z = heights_at(Terrain.from_grid(grid, 0.5), line)
    return Plan(
        (), cost, cost, length, (), np.column_stack([line, z]), request, exact=True, expanded=expanded
    )
