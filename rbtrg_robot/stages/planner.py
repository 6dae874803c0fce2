"""The planner as a stage: map blocks in, routes out. Keeps one graph and rebuilds what changed."""

from __future__ import annotations

from typing import Any

from mapping.elevation import MapMirror
from planning.body_risk import BodyModel
from planning.graph import GraphParams, TraversalGraph
from planning.path import Path, PathLimits
from rbtrg_robot import topics as t
from rbtrg_robot.params import PlannerParams
from rbtrg_robot.reasons import Reason

REASONS: dict[str, Reason] = {r.value: r for r in Reason}
"""Planning's reasons carry the same values."""


class PlannerStage:
    """See the module."""

    inputs = (t.MAP_UPDATE, t.MAP_FULL, t.PLAN_REQUEST)
    outputs = (t.PLAN, t.ROUTE, t.ROUTE_STATUS, t.MAP_REQUEST)

    def __init__(
        self,
        params: PlannerParams,
        graph_params: GraphParams,
        body: BodyModel,
        limits: PathLimits,
        resolution: float,
    ) -> None:
        self._params = params
        self._graph_params = graph_params
        self._body = body
        self._limits = limits
        self._mirror = MapMirror(resolution)
        self._graph: TraversalGraph | None = None
        self._changed: list[tuple[int, int, int, int]] = []
        self._updated = 0
        self._now = 0
        self._started = False
        self._status_due = 0
        self._request: Any = None
        self._path: Path | None = None
        self._frontier: tuple[float, float] | None = None
        self._malformed = 0
