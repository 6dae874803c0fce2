"""The traversal-risk graph: where the robot may stand and go (Lee et al., TRG-planner, RA-L 2025)."""

from planning.graph.graph import SNAP_DISTANCE, TraversalGraph
from planning.graph.params import GraphParams

__all__ = ["SNAP_DISTANCE", "GraphParams", "TraversalGraph"]
