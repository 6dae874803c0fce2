"""The door for planners of others.

A planner is a function `(grid: ElevationGrid, request: PlanRequest) -> Plan`, or the line it found as an array (n, 2)
or (n, 3) [m]. Its name is `package.module:function`, or that of an entry point of the group `rbtrg.planners`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.named import NamedError, named
from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.graph import SNAP_DISTANCE
from planning.risk.terrain import Terrain, heights_at
from planning.search import Plan, PlanRequest

GROUP = "rbtrg.planners"
OURS = "rb_trg"
Planner = Callable[[ElevationGrid, PlanRequest], Plan]


def planner_of(method: str) -> Planner:
    """The planner of a name. Raises PlanningError for one that cannot be imported."""
    try:
        function = named(method, "planner", GROUP, (OURS,))
    except NamedError as error:
        raise PlanningError(str(error)) from error
    return lambda grid, request: _ask(method, function, grid, request)


def _ask(method: str, function: Any, grid: ElevationGrid, request: PlanRequest) -> Plan:
    """What a planner of others answers, checked. Whatever it raises is a PlanningError: its fault ends no process."""
    try:
        answer = function(grid, request)
        if answer is None:
            raise NoRoute(NoRouteReason.NO_ROUTE, f"planner {method} found no way: choose another goal")
        if isinstance(answer, Plan):
            return answer
        line = np.asarray(answer, np.float64)
    except PlanningError:
        raise
    except Exception as error:
        raise PlanningError(f"planner {method} failed: {type(error).__name__}: {error}") from error
    if line.ndim != 2 or line.shape[1] not in (2, 3) or len(line) < 1 or not np.isfinite(line).all():
        raise PlanningError(f"planner {method} answered neither a Plan nor a line (n, 2) of finite metres")
    for what, place, end in (("start", request.start, line[0]), ("goal", request.goal, line[-1])):
        if np.hypot(*(end[:2] - np.asarray(place))) > SNAP_DISTANCE:  # it answers another question
            raise PlanningError(f"planner {method}: its line does not lead to the {what}, {tuple(place)}")  # type: ignore[arg-type]
    length = float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())
    return as_plan(grid, request, line[:, :2], length, 0)


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
    return Plan((), cost, cost, length, (), np.column_stack([line, z]), request, expanded=expanded)
