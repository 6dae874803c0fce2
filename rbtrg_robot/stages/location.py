"""Finding the robot in a prior map: collects a submap while it stands, asks the search, and keeps what was found until
something changes it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.elevation.exchange import MapPatch
from mapping.elevation.sensor import Sensor
from mapping.relocalise import Candidate, PriorMap, Submap, Verdict, locate
from mapping.relocalise.door import FinderError, OwnFinder
from rbtrg_robot import msg
from rbtrg_robot.stages.navigation.reasons import LOCATED
from rbtrg_robot.wire.convert import xyz, xyzw, yaw_of
from rbtrg_robot.wire.frames import MapFrame, Planar, laid, near, offset_of, stands

LOOK_SCANS = 10
"""Scans of a look: one second, in which the rings of a LiDAR that stands do not move."""
LOOK_SPACING = 0.7
"""From one look to the next [m]."""
KEPT_LOOKS = 6
"""After so many the first ones are forgotten: odometry drifts."""
SAME_OFFSET = 0.011
"""Offsets that differ by less [m, rad] are one: the odometry takes none that is nearer."""
GLIDE_ARRIVED = 1e-6
"""The same of one that glides: it ends where it is to."""
LISTED_CANDIDATES = 3
"""Candidates that are named."""


class State(StrEnum):
    """As `MapStatus.location`."""

    NONE = ""
    SEARCHING = "searching"
    FOUND = "found"
    LOCATED = "located"
    AMBIGUOUS = "ambiguous"
    NOT_FOUND = "not_found"
    ASSUMED = "assumed"
    TOLD = "told"
    CLOSING = "closing"

    @property
    def known(self) -> bool:
        """A goal in `map` means something."""
        return self in LOCATED


class Location:
    """Where `odom` lies in a prior map."""

    def __init__(self, finder: OwnFinder | None = None) -> None:
        """`finder`: of others; None: ours."""
        self._finder = finder
        self.state = State.NONE
        self.words = ""
        self.offset: Planar | None = None
        """Of `odom` in `map`, once found."""
        self.candidates: tuple[Candidate, ...] = ()
        self._name = ""
        self._map: tuple[NDArray[np.float32], Sequence[MapPatch]] | None = None
        """Cloud and ground that are searched; None where nothing can be."""
        self._prior: PriorMap | None = None
        """Made of these at the first search: it takes seconds for a large map, and a restarted process that was located
        needs none."""
        self._hint: Planar = (0.0, 0.0, 0.0)
        self._told = False
        self._submap = Submap()
        self._looked: NDArray[np.float64] | None = None
        """Where the newest look began, x, y in `odom` [m]."""

    @classmethod
    def begin(
        cls,
        name: str,
        patches: Sequence[MapPatch],
        cloud: NDArray[np.float32],
        hint: Planar,
        finder: OwnFinder | None = None,
    ) -> Location:
        """Search in a map that came as patches, called `name`. hint: assumed offset of `odom` in `map`."""
        out = cls(finder)
        out._name, out._hint = name, hint
        if len(cloud):
            out._map = cloud, patches
            out._say(State.SEARCHING, f"searching the robot in {name}")
        else:
            out._say(
                State.ASSUMED,
                f"{name} has no cloud and cannot be searched: the robot is taken to stand where the configuration says",
            )
        return out

    def restore(self, status: msg.MapStatus) -> None:
        """What the process before this one had found. A map that it was closing comes again."""
        if status.location in LOCATED and status.location != State.CLOSING:
            self._name = self._name or "the loaded map"
            self._say(State(status.location), status.location_detail)

    def close(self, offset: Planar) -> None:
        """`odom` is to lie at `offset`, where the map of this run with its loops closed has it."""
        self.offset, self._name = offset, "the closed map"
        self._say(State.CLOSING, "the loops of the map are closed: the robot moves in it to where it is")

    def tell(self, pose: msg.PoseWithCovarianceStamped, odom: msg.Odometry) -> None:
        """An operator says where the robot stands: only around there it is searched, and without success it is
        believed."""
        place = pose.pose.pose.position
        offset = offset_of((place.x, place.y, yaw_of(pose.pose.pose.orientation)), odom)
        if not all(map(math.isfinite, offset)) or not stands(odom) or self.state is State.NONE:
            return
        if self._map is None:
            self._say(State.TOLD, f"told where the robot stands in {self._name}; the map cannot be searched")
            return
        self._hint, self._told = offset, True
        self._submap, self._looked = Submap(), None
        self._say(State.SEARCHING, f"searching the robot in {self._name} where it was told to be")

    def scan(
        self,
        odom: msg.Odometry,
        clouds: list[tuple[Sensor, NDArray[np.float32]]],
        below: float,
    ) -> None:
        """One scan of every LiDAR, points in base_link; `below`: how far the ground is under base_link [m]."""
        if self._map is None or self.state is State.FOUND or self.state.known:
            return
        position = xyz(odom.pose.pose.position)
        if not stands(odom):
            return
        if self._looked is None or math.dist(position[:2], self._looked) > LOOK_SPACING:
            if self._submap.stands >= KEPT_LOOKS:
                self._submap = Submap()
            self._submap.stand()
            self._looked = position[:2]
        elif self._submap.scans >= LOOK_SCANS:
            return  # it has been decided from here
        for sensor, points in clouds:
            self._submap.add(points, position, xyzw(odom.pose.pose.orientation), sensor.origin, below)
        if self._submap.scans >= LOOK_SCANS:
            self._decide(odom)

    def settle(self, frame: MapFrame) -> bool:
        """Whether the frames have come to what was found just now, or is being closed."""
        if self.state not in (State.FOUND, State.CLOSING) or self.offset is None:
            return False
        within = SAME_OFFSET if self.state is State.FOUND else GLIDE_ARRIVED
        if not near(self.offset, frame.offset, (within, within)):
            return False
        self._say(
            State.LOCATED, self.words if self.state is State.FOUND else "the loops of the map are closed"
        )
        return True

    def _decide(self, odom: msg.Odometry) -> None:
        try:
            verdict = self._verdict(pose_of(self._hint, odom))
        except FinderError as error:
            self._say(State.NOT_FOUND, str(error))
            return
        self.candidates = verdict.candidates
        best = verdict.candidates[0] if verdict.candidates else None
        if verdict.answer == "located" and best is not None:
            self.offset = offset_of((best.place.x, best.place.y, best.place.yaw), odom)
            alike = "; other places look the same, the pose that was set decided" if verdict.hinted else ""
            self._say(
                State.FOUND,
                f"located in {self._name} at {_words(best)}, certainty {best.certainty:.0%}{alike}",
            )
        elif self._told:
            self.offset = self._hint
            sure = f", which {best.certainty:.0%} confirm" if best else ""
            self._say(
                State.FOUND, f"told where the robot stands in {self._name}; the scans do not show it{sure}"
            )
        elif verdict.answer == "open_ground":
            self._say(
                State.ASSUMED,
                f"nothing stands around here that {self._name} could be searched for: the robot is taken to "
                "stand where "
                "the configuration says",
            )
        elif verdict.answer == "ambiguous":
            places = " and ".join(_words(c) for c in verdict.candidates[:LISTED_CANDIDATES])
            self._say(State.AMBIGUOUS, f"ambiguous in {self._name} between {places}")
        else:
            self._say(State.NOT_FOUND, f"not found in {self._name}")
        self._told = False

    def _verdict(self, hint: Planar) -> Verdict:
        """Where the robot is thought to stand: `hint`. Raises FinderError."""
        assert self._map is not None
        cloud, patches = self._map
        if self._finder is not None:
            return self._finder.locate(cloud, self._submap, hint, self._told)
        if self._prior is None:
            self._prior = PriorMap(cloud, [patch.grid() for patch in patches])
        return locate(self._prior, self._submap, hint, self._told)

    def _say(self, state: State, words: str) -> None:
        self.state, self.words = state, words

    def report(self) -> dict[str, Any]:
        """Fields of MapStatus."""
        ambiguous = self.candidates if self.state is State.AMBIGUOUS else ()
        return {
            "location": str(self.state),
            "location_detail": self.words,
            "odom_in_map": np.array(self.offset or (0.0, 0.0, 0.0)),
            "candidates": np.array(
                [value for c in ambiguous for value in (c.place.x, c.place.y, c.place.yaw)], np.float64
            ),
        }


def _words(candidate: Candidate) -> str:
    place = candidate.place
    return f"{place.x:.2f} {place.y:.2f} yaw {math.degrees(place.yaw):.0f} deg"


def pose_of(offset: Planar, odom: msg.Odometry) -> Planar:
    """Where a robot stands in `map` whose `odom` lies at `offset`."""
    here = odom.pose.pose
    return laid(offset, (here.position.x, here.position.y, yaw_of(here.orientation)))
