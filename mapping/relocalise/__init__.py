"""Find the robot in a prior map: search, registration and verification of a submap that was seen while it stood."""

from mapping.relocalise.locate import (
    CERTAINTY_MARGIN,
    ENOUGH_CERTAINTY,
    MOST_LOOKS,
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
    "CERTAINTY_MARGIN",
    "ENOUGH_CERTAINTY",
    "MOST_LOOKS",
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
