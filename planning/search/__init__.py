"""The search over ordered pairs of nodes (paper eq. 5), its frontier and its explanation."""

from planning.search.plan import plan, plan_many
from planning.search.request import Plan, PlanRequest, Transition

__all__ = ["Plan", "PlanRequest", "Transition", "plan", "plan_many"]
