"""Traversal-risk graph, body risk, search, smoothing and path tracking, on numpy values."""

from planning.errors import NoRoute, NoRouteReason, PlanningError

__all__ = ["NoRoute", "NoRouteReason", "PlanningError"]
