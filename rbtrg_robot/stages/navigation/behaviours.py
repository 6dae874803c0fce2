"""What the navigator does where a goal does not get on: one table, read from the top, and one memory of what was tried.

A row counts if its trigger is what happened and it needs nothing that is missing. It has a budget: so many times at a
place, in a row of plans without a route, or for the whole goal. The first row with some of its budget left is done.
Where none is left, the goal ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from hal.rotation import wrap
from hal.safety.monitors import TOUCHED
from rbtrg_robot.stage_config import NavigatorConfig
from rbtrg_robot.stages.navigation.progress import Pose2

PLACE_RADIUS, HEADING_NEAR = 0.5, math.radians(45.0)
"""[m], [rad]: what was tried nearer than this was tried here."""


class Trigger(StrEnum):
    """What happened."""

    NO_ROUTE = "the planner finds no route"
    STUCK = "the robot is told to drive and does not"
    TURN_STUCK = "it is told to turn on the spot and does not"
    EDGE = "its wheels feel an edge that goes down"
    TOUCHED = "its body touches what the map does not show"


class Action(StrEnum):
    """What is done then; the planner is asked anew after each but the last."""

    LOOK = "waits for a newer map: noise closes a passage for a moment"
    LOOK_DOWN = "tilts its trunk and looks at the ground ahead"
    ALLOW = "allows the places that routes keep off: they may be the only way"
    CREEP = "allows ways onto ground that nobody saw, slowly"
    MOVE_ON = "moves a little straight ahead, where the turn may be free"
    MOVE_OUT = "moves straight over ground that its body covered"
    GIVE_UP = "ends the goal"


class Per(StrEnum):
    """What a budget is for."""

    ROW = "in a row"
    STAND = "in a row at a place"
    PLACE = "at a place"
    GOAL = "for a goal"


class Need(StrEnum):
    """What must be there."""

    NOTHING = ""
    TILT = "the trunk tilts"
    KEPT_OFF = "routes keep off a place"
    FEELS = "the wheels feel edges, and felt none yet"
    ROOM_AHEAD = "the guard lets it forward"


@dataclass(frozen=True, slots=True)
class Behaviour:
    """One row."""

    trigger: Trigger
    action: Action
    times: int | str
    """A number, or the name of a setting in `NavigatorConfig`."""
    per: Per
    needs: Need = Need.NOTHING


TABLE = (
    Behaviour(Trigger.NO_ROUTE, Action.LOOK, 1, Per.STAND),
    Behaviour(Trigger.NO_ROUTE, Action.LOOK_DOWN, 1, Per.PLACE, Need.TILT),
    Behaviour(Trigger.NO_ROUTE, Action.LOOK, "no_route_retries", Per.STAND),
    Behaviour(Trigger.NO_ROUTE, Action.ALLOW, 1, Per.ROW, Need.KEPT_OFF),
    Behaviour(Trigger.NO_ROUTE, Action.CREEP, 1, Per.GOAL, Need.FEELS),
    Behaviour(Trigger.NO_ROUTE, Action.MOVE_OUT, 1, Per.ROW),
    Behaviour(Trigger.STUCK, Action.MOVE_OUT, "max_recoveries", Per.PLACE),
    Behaviour(Trigger.TURN_STUCK, Action.MOVE_ON, 1, Per.PLACE, Need.ROOM_AHEAD),
    Behaviour(Trigger.TURN_STUCK, Action.MOVE_OUT, "max_recoveries", Per.PLACE),
    Behaviour(Trigger.EDGE, Action.MOVE_OUT, "max_recoveries", Per.GOAL),
    Behaviour(Trigger.TOUCHED, Action.MOVE_OUT, "max_touches", Per.GOAL),
)


class Behaviours:
    """Reads the table and keeps what was tried for one goal, and what routes must keep off."""

    def __init__(self, config: NavigatorConfig, *, feels_edges: bool = False, tilts: bool = False) -> None:
        """`feels_edges`: the wheels do; `tilts`: the trunk does."""
        self._config = config
        self._feels, self._tilts = feels_edges, tilts
        self._tried: list[tuple[int, Pose2]] = []
        """Rows of the table, and where."""
        self._row_began = 0
        """Of `_tried`, where the present row of plans without a route begins."""
        self._held: list[tuple[Pose2, bool]] = []
        """Turns on the spot that the guard held, whether to the left."""
        self._avoid: list[float] = []
        self._edges: list[Pose2] = []
        """Where base_link was."""
        self._touched: list[tuple[float, float]] = []
        """Where it was touched."""
        self.crept = False
        """Ways onto ground that nobody saw were asked for."""

    def next(self, trigger: Trigger, here: Pose2, *, way: float = 0.0, room_ahead: bool = False) -> Action:
        """What to do at the pose `here`, which is noted as tried.

        `way`: 1.0 while the robot was driven forward, -1.0 backward; what holds it lies there, and routes keep off it.
        `room_ahead`: the guard lets it forward.
        """
        there = {
            Need.NOTHING: True,
            Need.TILT: self._tilts,
            Need.KEPT_OFF: bool(self._avoid),
            Need.FEELS: self._feels and not self._edges,
            Need.ROOM_AHEAD: room_ahead and not self._edges,
        }
        for k, row in enumerate(TABLE):
            if row.trigger is trigger and there[row.needs] and self._spent(k, row, here) < self._times(row):
                self._tried.append((k, here))
                return self._do(row.action, here, way)
        return Action.GIVE_UP

    def _do(self, action: Action, here: Pose2, way: float) -> Action:
        if action is Action.ALLOW:
            self._avoid = []
        elif action is Action.CREEP:
            self.crept = True
        elif action is Action.MOVE_OUT and way:
            self._avoid += self._disc(here, way)
        return action

    def _times(self, row: Behaviour) -> int:
        return row.times if isinstance(row.times, int) else int(getattr(self._config, row.times))

    def _spent(self, k: int, row: Behaviour, here: Pose2) -> int:
        in_row, at_place = row.per in (Per.ROW, Per.STAND), row.per in (Per.STAND, Per.PLACE)
        tried = self._tried[self._row_began :] if in_row else self._tried
        return sum(k == other and (not at_place or _near(here, place)) for other, place in tried)

    def found(self) -> None:
        """There is a route."""
        self._row_began = len(self._tried)

    def hold_turn(self, pose: Pose2, *, left: bool) -> None:
        """The guard holds a turn on the spot from `pose` to the left, or to the right: it sees more than the map."""
        self._held.append((pose, left))

    def held_turns(self, pose: Pose2) -> tuple[bool, bool]:
        """Whether turns from about `pose` to the left, to the right, were held."""
        sides = {left for other, left in self._held if _near(pose, other)}
        return True in sides, False in sides

    def edge(self, pose: Pose2) -> Action:
        """The wheels felt an edge ahead of `pose`."""
        self._edges.append(pose)
        return self.next(Trigger.EDGE, pose)

    def touched(self, pose: Pose2, x: float, y: float) -> Action:
        """Something that the map does not explain was touched at x, y [m]; it is in the map by now."""
        self._touched.append((x, y))
        return self.next(Trigger.TOUCHED, pose)

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

    def _disc(self, pose: Pose2, way: float) -> list[float]:
        (x, y, yaw), ahead = pose, way * self._config.avoid_ahead
        return [x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), self._config.avoid_radius]


def _near(a: Pose2, b: Pose2) -> bool:
    return math.dist(a[:2], b[:2]) < PLACE_RADIUS and abs(wrap(a[2] - b[2])) < HEADING_NEAR
