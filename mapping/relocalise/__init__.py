"""Find the robot in a prior map: search, registration and verification of a submap that was seen while it stood."""

from mapping.relocalise.locate import Candidate, PriorMap, Verdict, locate, warm_up
from mapping.relocalise.search import Place
from mapping.relocalise.submap import Submap

__all__ = ["Candidate", "Place", "PriorMap", "Submap", "Verdict", "locate", "warm_up"]
