"""Attempts of the navigator where there is no route or no progress, the cheapest first."""

from __future__ import annotations

import math
from enum import StrEnum

from hal.safety.monitors import TOUCHED
from rbtrg_robot.stage_config import NavigatorConfig
from rbtrg_robot.stages.navigation.progress import PLACE, Pose2

LOOK_DOWN_AT = 2
"""Which try in a row without a route: noise closes many a passage for a moment, and another graph often has a way."""


class Measure(StrEnum):
    """The next attempt."""

    LOOK = "look"
    """Stand, wait for a newer map and ask again; the planner draws another graph meanwhile."""
    LOOK_DOWN = "look_down"
    """The same with the nose down, where the trunk tilts."""
    CREEP = "creep"
    """Ask for a way onto ground that nobody saw, too."""
    MOVE_ON = "move_on"
    """Move a little straight ahead, where the turn that is held may be free, then ask again."""
    MOVE_OUT = "move_out"
    """Move straight over ground the body covered, then ask again."""
    GIVE_UP = "give_up"


class Recovery:
    """Keeps what was tried for one goal, and what routes must keep off.

    No route: look again a few times, once of these with the nose down; then once more without the places to keep off,
    because they may be the only way; then creep onto
    ground that nobody saw, from now on, where the wheels feel edges; then move out of the
    place once, because it may only lack the room to turn; then give up. An edge that was felt is kept off for good, and
    ends the creeping. What was touched is in the map. Stuck: keep off the place and move out, a few times at each
    place. A turn
    that is held goes on a little farther ahead first: behind the corner of a wall a robot that turned 0.1 m too early
    has its tail at it, and
    came back to the same place each time that it had backed out.
    """

    def __init__(self, config: NavigatorConfig, *, feels_edges: bool = False) -> None:
        self._config = config
        self._feels = feels_edges
        self.crept = False
        """Ways onto ground that nobody saw were asked for."""
        self._avoid: list[float] = []
        self._edges: list[Pose2] = []
        """Where base_link was."""
        self._touched: list[tuple[float, float]] = []
        """Where it was touched."""
        self._failed = 0
        self._stuck_at: list[Pose2] = []
        self._lost_at: list[Pose2] = []

    @property
    def creep(self) -> bool:
        """Whether ways onto ground that nobody saw are asked for where there are no others."""
        return self.crept and not self._edges

    @property
    def avoid(self) -> list[float]:
        """x, y, radius [m] of places that routes keep off, one after the other."""
        return self._avoid + [v for pose in self._edges for v in self._disc(pose, 1.0)]

    @property
    def at_edge(self) -> bool:
        """Whether the wheels felt an edge."""
        return bool(self._edges)

    @property
    def felt(self) -> str:
        """In words where the wheels felt edges, and where something was touched; empty where they did not."""
        edges = " and ".join(f"at x {x:.2f} y {y:.2f}" for x, y, _ in self._edges)
        said = [f"the wheels felt an edge that goes down {edges}"] if edges else []
        if self._touched:
            where = " and ".join(f"({x:.1f}, {y:.1f})" for x, y in self._touched)
            said.append(TOUCHED.tell(where=where))
        return "; ".join(said)

    def touched(self, x: float, y: float) -> Measure:
        """Something that the map does not explain was touched there."""
        self._touched.append((x, y))
        return Measure.GIVE_UP if len(self._touched) > self._config.max_touches else Measure.MOVE_OUT

    def edge(self, pose: Pose2) -> Measure:
        """The wheels felt an edge ahead of `pose`."""
        self._edges.append(pose)
        return Measure.GIVE_UP if len(self._edges) > self._config.max_recoveries else Measure.MOVE_OUT

    def _disc(self, pose: Pose2, way: float) -> list[float]:
        (x, y, yaw), ahead = pose, way * self._config.avoid_ahead
        return [x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), self._config.avoid_radius]

    def found(self) -> None:
        """There is a route."""
        self._failed = 0

    def no_route(self, pose: Pose2 | None) -> Measure:
        """The planner found none from `pose`."""
        self._failed += 1
        if self._failed <= self._config.no_route_retries:
            return Measure.LOOK_DOWN if self._failed == LOOK_DOWN_AT else Measure.LOOK
        self._failed = 0
        if self._avoid:
            self._avoid = []
            return Measure.LOOK
        if self._feels and not self.crept:
            self.crept = True
            return Measure.CREEP
        return Measure.MOVE_OUT if pose and _visit(self._lost_at, pose) == 1 else Measure.GIVE_UP

    def stuck(self, pose: Pose2, way: float, *, room_ahead: bool) -> Measure:
        """No progress at `pose` although it drove forward, `way` 1.0, backward, -1.0, or turned, 0.0. What stalls a
        turn lies under the
        robot or beside it, not ahead: nothing is kept off then. `room_ahead`: the guard lets it forward."""
        tries = _visit(self._stuck_at, pose)
        if tries > self._config.max_recoveries:
            return Measure.GIVE_UP
        if not way and room_ahead and tries == 1:
            return Measure.MOVE_ON
        if way:
            self._avoid += self._disc(pose, way)
        return Measure.MOVE_OUT


def _visit(places: list[Pose2], pose: Pose2) -> int:
    """Note the pose; how often the robot was at this place, this time included."""
    places.append(pose)
    return sum(math.dist(pose[:2], other[:2]) < PLACE for other in places)
