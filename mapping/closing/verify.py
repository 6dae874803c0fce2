"""Is one keyframe where another was? The relocaliser says where; both directions, every rival and the walls' grip say
whether to believe it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hal.rotation import wrap
from hal.types import Array
from mapping.closing.graph import after, back
from mapping.closing.keyframes import Keyframe, Surroundings
from mapping.relocalise import ENOUGH_CERTAINTY, Candidate, Place, possible, same

DIRECTION_GAP = (0.1, 0.1, 0.1, math.radians(1.0))
"""The two directions of a registration differ by less along x, y, z [m] and in yaw [rad]."""
LEAST_GRIP = 0.05
"""Least share of the walls' normals along the direction that they hold least. Normals of one plane scatter by 0.01."""
LEAST_LEAD = 0.12
"""A place is more certain than any other by at least this: of the looks of one keyframe none is far from the others, so
they count as two."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """One keyframe in the frame of another."""

    first: int
    second: int
    """Keyframes, by their number; the second one was searched in the map of the first."""
    relative: Array
    """(4,) x, y, z [m], yaw [rad]."""
    certainty: float


@dataclass(frozen=True, slots=True)
class Refusal:
    """A loop that was not closed, and why."""

    first: int
    second: int
    why: str
    certainty: float = 0.0


class Verifier:
    """Compares keyframes."""

    def __init__(self, keyframes: list[Keyframe], around: Surroundings) -> None:
        self._keyframes = keyframes
        self._around = around

    def search(
        self, first: int, second: int, near: Array, radius: float, turn: float
    ) -> list[Candidate] | None:
        """Where keyframe `second` may be in the map of `first`, within `radius` [m] and `turn` [rad] of `near` (4,);
        None: too little stands there."""
        prior = self._around.map(self._keyframes[first])
        if prior is None:
            return None
        submap = self._around.submap(self._keyframes[second])
        hint = (float(near[0]), float(near[1]), float(near[3]))
        return possible(prior, submap, hint, radius, turn)

    def check(self, match: Match) -> str:
        """What speaks against a match, in plain words; empty where nothing does."""
        prior = self._around.map(self._keyframes[match.first])
        assert prior is not None  # it was searched
        submap = self._around.submap(self._keyframes[match.second])
        grip = prior.surfaces.grip(submap.cloud()[0], place_of(match.relative))
        if grip < LEAST_GRIP:
            return f"slides: the walls hold it in one direction only ({grip:.0%} of them in the other)"
        other = back(match.relative)
        found = self.search(match.second, match.first, other, 1.0, math.radians(10.0))
        best = found[0] if found else None
        if best is None or best.certainty < ENOUGH_CERTAINTY:
            return f"one way only: searched the other way round it is {best.certainty if best else 0.0:.0%} certain"
        off = pose_of(best.place) - other
        off[3] = wrap(off[3])
        if (np.abs(off) > DIRECTION_GAP).any():
            return f"the two ways differ by {np.linalg.norm(off[:3]):.2f} m and {abs(math.degrees(off[3])):.1f} deg"
        return ""


def rivals(nodes: Array, found: list[Match]) -> tuple[Match, Match | None]:
    """The most certain of some matches of one keyframe, and the most certain one that puts the keyframe elsewhere.
    nodes (n, 4): where the graph has them."""
    ranked = sorted(found, key=lambda match: -match.certainty)
    best = ranked[0]
    here = place_of(after(nodes[best.first], best.relative))
    for match in ranked[1:]:
        if not same(place_of(after(nodes[match.first], match.relative)), here):
            return best, match
    return best, None


def place_of(pose: Array) -> Place:
    """A pose (4,) as the relocaliser has it."""
    x, y, z, yaw = pose.tolist()
    return Place(x, y, z, yaw, 0.0)


def pose_of(place: Place) -> Array:
    """(4,) x, y, z [m], yaw [rad]."""
    return np.array([place.x, place.y, place.z, place.yaw])
