"""The ways that the robot drove, and along them the shortest one home: no planner is asked, and there always is one."""

from __future__ import annotations

import heapq
import math
from collections import defaultdict

from rbtrg_robot.stages.navigation.progress import Pose2

Place = tuple[float, float]

PLACE_SPACING = 0.3
"""[m] between two places, and within which two of them are joined: less than the body is wide, so no wall stands
between."""
AT_HOME = 0.6
"""[m] A place so near to home is joined to it."""
SET_JUMP = 1.0
"""[m] A pose farther than this from the one before was set and not driven to."""
DETOUR_FACTOR = 1.5
"""Home is thought to be so many times farther than straight on where the robot never was there."""


class WayHome:
    """Takes poses in `map`."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self._home: Place | None = None
        self._known = False
        """The robot was at home: its way there is no guess."""
        self._pose: Place | None = None
        self._places: list[Place] = []
        self._joined: list[set[int]] = []
        self._near: dict[tuple[int, int], list[int]] = defaultdict(list)
        self._cost: list[float] = []
        """[m] home from each place, and the place that comes next; -1 = home."""
        self._next: list[int] = []
        self._at = -1

    def take(self, pose: Pose2, home: Pose2 | None) -> None:
        """Where the robot is, and where home is."""
        here = pose[:2]
        if self._pose is not None and math.dist(here, self._pose) >= SET_JUMP:
            self._begin()  # what was driven lies elsewhere now
        self._pose = here
        if self._at < 0 or math.dist(here, self._places[self._at]) >= PLACE_SPACING:
            self._step(here)
        place = None if home is None else home[:2]
        if place != self._home:
            self._home = place
            self._aim()

    def _step(self, here: Place) -> None:
        close = [k for k in self._around(here) if math.dist(here, self._places[k]) <= PLACE_SPACING]
        before, self._at = self._at, len(self._places)
        self._places.append(here)
        self._joined.append(set())
        self._cost.append(math.inf)
        self._next.append(-1)
        self._near[_cell(here)].append(self._at)
        for k in {*close, *([before] if before >= 0 else [])}:
            self._joined[k].add(self._at)
            self._joined[self._at].add(k)
        if self._home is not None and not self._known:
            if math.dist(here, self._home) <= AT_HOME:
                return self._aim()
            self._cost[self._at] = DETOUR_FACTOR * math.dist(here, self._home)
        for k in self._joined[self._at]:
            self._relax(k, self._at)
        self._spread([self._at])
        return None

    def _around(self, here: Place) -> list[int]:
        i, j = _cell(here)
        return [k for di in (-1, 0, 1) for dj in (-1, 0, 1) for k in self._near.get((i + di, j + dj), ())]

    def _aim(self) -> None:
        """Home is elsewhere now."""
        count = len(self._places)
        self._cost, self._next = [math.inf] * count, [-1] * count
        self._known = False
        if self._home is None or not count:
            return
        away = [math.dist(place, self._home) for place in self._places]
        nearest = min(range(count), key=away.__getitem__)
        self._known = away[nearest] <= AT_HOME
        starts = [nearest] if self._known else range(count)
        for k in starts:
            self._cost[k] = away[k] if self._known else DETOUR_FACTOR * away[k]
        self._spread(list(starts))

    def _relax(self, start: int, end: int) -> bool:
        cost = self._cost[start] + math.dist(self._places[start], self._places[end])
        if not cost < self._cost[end]:
            return False
        self._cost[end], self._next[end] = cost, start
        return True

    def _spread(self, starts: list[int]) -> None:
        heap = [(self._cost[k], k) for k in starts]
        heapq.heapify(heap)
        while heap:
            cost, k = heapq.heappop(heap)
            if cost > self._cost[k]:
                continue
            for other in self._joined[k]:
                if self._relax(k, other):
                    heapq.heappush(heap, (self._cost[other], other))

    @property
    def length(self) -> float:
        """[m] home from the robot; NaN where home or robot are not known."""
        if self._pose is None or self._home is None or self._at < 0:
            return math.nan
        return self._cost[self._at] + math.dist(self._pose, self._places[self._at])

    def places(self, every: float) -> list[Place]:
        """On the way home, one about every so many metres, home the last one."""
        found: list[Place] = []
        if self._home is None or self._at < 0:
            return found
        k, driven = self._at, 0.0
        while self._next[k] >= 0:
            driven += math.dist(self._places[k], self._places[self._next[k]])
            k = self._next[k]
            if driven >= every:
                found.append(self._places[k])
                driven = 0.0
        if found and math.dist(found[-1], self._home) < every / 2:
            found.pop()
        return [*found, self._home]


def _cell(place: Place) -> tuple[int, int]:
    return math.floor(place[0] / PLACE_SPACING), math.floor(place[1] / PLACE_SPACING)
