"""Find the robot in a prior map: search, registration and verification of a submap that was seen while it stood."""

from mapping.relocalise.locate import (
    ENOUGH,
    LOOKS,
    MARGIN,
    Candidate,
    PriorMap,
    Verdict,
    locate,
    possible,
    warm_up,
)
from mapping.relocalise.search import Place, same
from mapping.relocalise.submap import Submap

__all__ = [
    "ENOUGH",
    "LOOKS",
    "MARGIN",
    "Candidate",
    "Place",
    "PriorMap",
    "Submap",
    "Verdict",
    "locate",
    "possible",
    "same",
    "warm_up",
]
