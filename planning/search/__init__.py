"""The search over ordered pairs of nodes (paper eq. 5), its frontier and its explanation."""

from planning.search.plan import plan
from planning.search.request import Driven, DriveRules, Plan, PlanRequest, Transition

__all__ = ["DriveRules", "Driven", "Plan", "PlanRequest", "Transition", "plan"]
