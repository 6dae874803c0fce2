"""Where in a prior map does the robot stand? Search, register, verify, decide.

submap ──> places that match the map's columns ──> registered exactly ──> what speaks for and against ──> one, several,
none
          (search: branch and bound)              (verify: small_gicp)    (verify)                        (here)"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from mapping.grid import ElevationGrid
from mapping.relocalise.search import Columns, Place, find_places, same
from mapping.relocalise.submap import GROUND_BAND, Submap
from mapping.relocalise.verify import Surfaces, bare_ground

ENOUGH_CERTAINTY = 0.5
"""A place is possible when this share more of the submap speaks for it than against it."""
CERTAINTY_MARGIN, MOST_LOOKS = 0.24, 3
"""Candidates whose certainty differs by less than CERTAINTY_MARGIN / min(looks, MOST_LOOKS) are ambiguous: errors from
moved boxes average out over looks. In 480 places of a lane that looks the same from its ends the wrong end led by at
most 0.21, 0.06 and 0.01."""
STRUCTURE_POINTS = 150
"""Points of a submap that stand on the ground below which nothing can be told: open ground."""
NEAR_HINT = (1.0, math.radians(30.0))
"""A place within this of where the robot is said to stand is that place [m], [rad]."""

Answer = Literal["located", "ambiguous", "not_found", "open_ground"]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A place that is possible."""

    place: Place
    """Of the ground under the robot, in `map`."""
    certainty: float
    """Share of the submap's structure that lies on the map, less the share that contradicts it [-1..1]."""
    against: float
    """Share that contradicts."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was found; candidates best first. Located: the first one is it."""

    answer: Answer
    candidates: tuple[Candidate, ...] = ()
    hinted: bool = False
    """Places look the same, and the hint decided."""


class PriorMap:
    """What the search needs of a map, worked out once."""

    def __init__(self, cloud: NDArray[np.float32], ground: Sequence[ElevationGrid]) -> None:
        """cloud (n, 3) [m] and blocks of ground on one lattice, all in `map`."""
        self.columns = Columns.of(cloud, ground)
        self.surfaces = Surfaces(cloud, ground)


def locate(
    prior: PriorMap, submap: Submap, hint: tuple[float, float, float] | None = None, told: bool = False
) -> Verdict:
    """Search the whole map. hint: x, y [m], yaw [rad] of the assumed pose; it decides between places that look the
    same. `told`: by an operator; then nothing else is searched."""
    found = possible(prior, submap, hint if told else None)
    return Verdict("open_ground") if found is None else decide(found, submap.stands, hint)


def decide(found: list[Candidate], stands: int, hint: tuple[float, float, float] | None = None) -> Verdict:
    """Whether one of these places, the most certain first, is it after `stands` looks."""
    if not found or found[0].certainty < ENOUGH_CERTAINTY:
        return Verdict("not_found", tuple(found))
    margin = CERTAINTY_MARGIN / max(1, min(stands, MOST_LOOKS))
    alike = [c for c in found if found[0].certainty - c.certainty < margin]
    if len(alike) == 1:
        return Verdict("located", tuple(found))
    said = [c for c in alike if hint is not None and near(c.place, hint)]
    if said:
        return Verdict("located", (said[0], *(c for c in found if c is not said[0])), hinted=True)
    return Verdict("ambiguous", tuple(alike))


def possible(
    prior: PriorMap,
    submap: Submap,
    near: tuple[float, float, float] | None = None,
    radius: float = 1.5,
    turn: float = math.radians(30.0),
) -> list[Candidate] | None:
    """Places of a submap, registered, the most certain first; None where too little stands around. near: x, y [m], yaw
    [rad], only within `radius` [m] and `turn` [rad] of which is searched.
    """
    cloud, eyes = submap.cloud()
    structure = cloud[cloud[:, 2] > GROUND_BAND]
    if len(structure) < STRUCTURE_POINTS:
        return None
    bare = bare_ground(cloud)
    found: list[Candidate] = []
    for place in find_places(prior.columns, structure, near, radius, turn):
        exact = prior.surfaces.register(cloud, place)
        if any(same(exact, other.place) for other in found):
            continue
        agree, against = prior.surfaces.evidence(cloud, eyes, bare, exact)
        found.append(Candidate(exact, agree - against, against))
    return sorted(found, key=lambda c: -c.certainty)


def near(place: Place, hint: tuple[float, float, float]) -> bool:
    """Whether a place is where the robot is said to stand."""
    apart = math.hypot(place.x - hint[0], place.y - hint[1])
    return apart < NEAR_HINT[0] and abs(wrap(place.yaw - hint[2])) < NEAR_HINT[1]


def warm_up() -> None:
    """Compile or load every kernel on a small room."""
    side = np.linspace(-2.0, 2.0, 40, dtype=np.float32)
    x, z = (a.ravel() for a in np.meshgrid(side, np.linspace(0.0, 1.0, 10, dtype=np.float32)))
    walls = np.concatenate(
        [np.column_stack([x, np.full_like(x, 2.0), z]), np.column_stack([np.full_like(x, -2.0), x, z])]
    )
    ground = ElevationGrid(
        np.zeros((100, 100), np.float32), np.ones((100, 100), np.bool_), (-2.0, -2.0), 0.04
    )
    submap = Submap()
    submap.add(
        walls - np.array([0.0, 0.0, 0.4], np.float32),
        np.array([0.0, 0.0, 0.4]),
        np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3),
        0.4,
    )
    locate(PriorMap(walls, [ground]), submap)
