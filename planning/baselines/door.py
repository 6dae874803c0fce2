"""The door for planners of others: the project's baselines and those of users come in by the same name.

A planner is a function `(grid: ElevationGrid, request: PlanRequest) -> Plan`, or the line it found as an array (n, 2)
or (n, 3) [m]. Its name is `package.module:function`, or that of an entry point of the group `rbtrg.planners`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hal.named import NamedError, named
from mapping.grid import ElevationGrid
from planning.baselines.route import as_plan
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.search import Plan, PlanRequest

GROUP = "rbtrg.planners"
OURS = "rb_trg"
KNOWN = {"t_hybrid": "planning.baselines.t_hybrid:plan", "art": "planning.baselines.art:plan"}
ENDS = 0.5
"""A line that begins further from the start, or ends further from the goal [m], answers another question."""
Planner = Callable[[ElevationGrid, PlanRequest], Plan]


def planner_of(method: str) -> Planner:
    """The planner of a name. Raises PlanningError for one that cannot be imported."""
    try:
        function = named(KNOWN.get(method, method), "planner", GROUP, (OURS, *KNOWN))
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
        if np.hypot(*(end[:2] - np.asarray(place))) > ENDS:
            raise PlanningError(f"planner {method}: its line does not lead to the {what}, {tuple(place)}")  # type: ignore[arg-type]
    length = float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())
    return as_plan(grid, request, line[:, :2], length, 0)
