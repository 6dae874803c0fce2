"""Typed planning errors: a machine-readable reason beside a sentence that tells the operator what to do."""

from __future__ import annotations

from enum import StrEnum

from hal.errors import OperatorError


class NoRouteReason(StrEnum):
    """Why a request has no route; the same words on every surface."""

    BAD_INPUT = "bad_input"
    """NaN, wrong shape or dtype, or a node index that does not exist."""
    NO_TERRAIN = "no_terrain"
    """The map is empty or holds nothing trusted."""
    OUTSIDE_MAP = "outside_map"
    START_NOT_ON_GRAPH = "start_not_on_graph"
    """No valid node within the snap distance of the start."""
    NOT_CONNECTED = "not_connected"
    """The ground there can be driven on, but no way leads to it."""
    GOAL_IN_OBSTACLE = "goal_in_obstacle"
    """No valid node within the snap distance of a goal in known terrain."""
    GOAL_UNKNOWN = "goal_unknown"
    """The goal's terrain was never seen and frontier goals were not allowed."""
    NO_ROUTE = "no_route"
    """Start and goal are on the graph but not connected, and no frontier is left."""


class PlanningError(OperatorError):
    """The input of a planning call does not make sense; the message says which and what was expected."""


class NoRoute(PlanningError):
    """There is no plan for this request. `reason` is stable, the message is for people."""

    def __init__(self, reason: NoRouteReason, message: str) -> None:
        super().__init__(message)
        self.reason = reason
