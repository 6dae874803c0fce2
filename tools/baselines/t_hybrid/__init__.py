"""T-Hybrid (nubot-nudt/T-Hybrid-planner): terrain assessment by local planes, hybrid A* over it, smoothing."""

from tools.baselines.t_hybrid.params import PROFILES, THybridParams
from tools.baselines.t_hybrid.plan import plan
from tools.baselines.t_hybrid.terrain import HybridMap, assess, assess_points

__all__ = ["PROFILES", "HybridMap", "THybridParams", "assess", "assess_points", "plan"]
