"""The search for a way to one goal: past ground that cannot be seen from here, to frontiers, and in other graphs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hal.types import NS
from planning.errors import NoRoute, NoRouteReason
from planning.path import (
    Path,
    PathLimits,
    ahead_of,
    backs_up,
    creeping,
    drivable,
    is_hidden,
    make_path,
    rest_of,
)
from planning.risk.body import BodyModel
from planning.search.door import OURS, Planner, planner_of
from planning.search.explain import with_chance
from planning.search.frontier import Tried
from planning.search.plan import Driven, DriveRules, Plan, PlanRequest
from rbtrg_robot import msg
from rbtrg_robot.stage_config import PlannerConfig
from rbtrg_robot.stages.map_graph import WHOLE_CELLS, MapGraph

NO_PLAN_WITHIN = 1.0
"""A plan that ends where the robot stands and farther from the goal [m] is none: another graph, or the map of later,
may have one."""
MOST_REDRAWS, AT_LEAST = 5, 2
"""Other graphs that are searched at once; fewer, but some, where more cells than `WHOLE_CELLS` would be drawn anew
together."""
LOST_MARGIN = 2.0
"""A way that is worse by more [m] than the one before (`Plan.worth`) is a reason to search other graphs: a passage may
have been lost."""
DEAR_LEG = 10.0
"""[m] A leg of a way that costs so much more than it is long, such as a turn over the edge of a kerb, is a reason as
well."""
WAYS_TRIED = 4
"""Tried, where they begin with ground that cannot be seen."""
EDGE_LEFT = 1.5
"""[m] from where it crept last, all over ground that was seen, a robot stands at no edge that nobody saw: a creep is
half a body long."""


@dataclass(frozen=True, slots=True)
class Way:
    """A plan and its path."""

    plan: Plan
    whole: Path
    """Over virtual ground too."""
    path: Path
    """The part of it that is driven."""
    creep: bool = False
    """`path` leads onto ground that nobody saw."""


class WaySearch:
    """Finds ways on a `MapGraph` for one goal after the other, and remembers for each goal what was tried."""

    def __init__(
        self,
        params: PlannerConfig,
        body: BodyModel,
        limits: PathLimits,
        creep: float = 0.0,
    ) -> None:
        """`creep` [m/s]: see `Capabilities`."""
        self._creep = creep
        self._crept: tuple[float, float] | None = None
        """x, y [m] from where a way last led onto ground that nobody saw: near there the robot may stand at an edge,
        whatever the goal is now."""
        self.rules = DriveRules(params.backward, params.turning, straight=True, guarded=True)
        self._params = params
        self._other: Planner | None = None if params.method == OURS else planner_of(params.method)
        """A planner of others knows neither frontiers nor places to keep off."""
        self._body = body
        self._limits = limits
        self._begin("")

    @property
    def crept(self) -> bool:
        """Whether the robot may stand on ground that nobody saw, because it crept there."""
        return self._crept is not None

    def _begin(self, goal: str) -> None:
        self._goal = goal
        self._tried = Tried()
        self._hidden: list[tuple[float, float, float]] = []
        """x, y, radius [m] of ground on the way that cannot be seen from where it begins; kept off until it was seen.
        """
        self._newest: Plan | None = None
        self._forward = False
        """Of the way that is searched nothing is driven backward: the robot does not know the ground behind it."""

    def find(self, terrain: MapGraph, message: msg.PlanRequest, driven: Path | None, now: int) -> Way:
        """The way from where the robot stands at `now` [ns]. What is left of the path `driven` is kept unless another
        is clearly better.

        A way that begins with ground that cannot be seen from here is left for another: one that backs onto such
        ground, for one that is driven forward alone. Raises PlanningError.
        """
        if message.goal_id != self._goal:
            self._begin(message.goal_id)
        here = message.start_x, message.start_y
        self.begins(terrain, here)
        if self._crept is not None and math.dist(here, self._crept) > EDGE_LEFT:
            self._crept = None
        self._tried.at(here, terrain.grid)
        try:
            way = self._seen(terrain, message, driven)
        except NoRoute:
            if not message.creep or (onto := self._onto_unseen(terrain, message)) is None:
                raise
            way, self._crept = onto, here
        self._tried.found(way.plan.frontier, way.plan.length, now / NS, terrain.grid)
        return replace(way, plan=self.told(terrain, way.plan))

    @staticmethod
    def begins(terrain: MapGraph, here: tuple[float, float]) -> None:
        """Raises NoRoute for a robot at x, y [m] that stands behind the fence."""
        breach, by = terrain.fence.breach(*here)
        if by is not None and breach > 0.0:
            raise NoRoute(
                NoRouteReason.START_NOT_ON_GRAPH,
                f"it is {breach:.2f} m behind {by.words}: drive it back by hand",
            )

    def told(self, terrain: MapGraph, found: Plan) -> Plan:
        """The plan with its chance."""
        if terrain.graph is None or terrain.grid is None:
            return found
        return with_chance(found, terrain.graph, terrain.grid)

    def path_of(self, terrain: MapGraph, found: Plan) -> Path:
        """The smooth path of a plan."""
        return make_path(found, terrain.ground(), self._body, self._limits, terrain.terrain())

    def _seen(self, terrain: MapGraph, message: msg.PlanRequest, driven: Path | None) -> Way:
        if self._other is not None or terrain.graph is None:
            found, whole = self._plan(terrain, message, driven)
            return Way(found, whole, whole)
        self._forward = False
        before = terrain.graph
        self._hidden = [disc for disc in self._hidden if is_hidden(before, disc[0], disc[1])]
        for way in range(WAYS_TRIED):
            try:
                found, whole = self._in_graphs(terrain, message, driven)
            except NoRoute:
                if way == 0:
                    raise
                break  # what hides the first way is the reason
            assert terrain.graph is not None
            path = drivable(
                whole, terrain.graph, terrain.ground(), self._body.width, crept=message.creep or self.crept
            )
            if path is not None:
                cut = len(path.points) < len(whole.points)
                return Way(replace(found, reaches_goal=False) if cut else found, whole, path)
            if backs_up(whole):
                self._forward = True
                continue
            self._hidden.append(ahead_of(whole, self._body.length))
        raise NoRoute(
            NoRouteReason.NO_ROUTE,
            "every way leads over ground that the robot cannot see from where it stands: drive it by hand, "
            "slowly, to where it "
            "sees the ground ahead, or choose another goal",
        )

    def _onto_unseen(self, terrain: MapGraph, message: msg.PlanRequest) -> Way | None:
        """The begin of the best way over ground that nobody saw, to be crept; None where there is none. Frontiers that
        were looked from count: on the way to them the robot sees no more, but it comes over them."""
        self._hidden, self._forward = [], True
        tried, self._tried = self._tried, Tried()
        try:
            found, whole = self._in_graphs(terrain, message, None)
        except NoRoute:
            return None
        finally:
            self._tried = tried
        if terrain.graph is None:
            return None
        path = creeping(whole, terrain.graph, self._body.width, self._creep)
        return None if path is None else Way(replace(found, reaches_goal=False), whole, path, creep=True)

    def _in_graphs(
        self, terrain: MapGraph, message: msg.PlanRequest, driven: Path | None
    ) -> tuple[Plan, Path]:
        """As `_plan`. A narrow passage may hold no edge of one graph: where there is no way, where a way was lost, and
        where a new one has a leg that is much dearer than long, other graphs are searched for one."""
        before, self._newest = self._newest, None
        found: tuple[Plan, Path] | None = None
        none = NoRoute(NoRouteReason.NO_ROUTE, "")
        try:
            found = self._plan(terrain, message, driven)
        except NoRoute as error:
            none = error
            if none.reason is not NoRouteReason.NO_ROUTE:
                raise
        if found is None or _lost(before, found[0]) or _dear(found[0]):
            kept = terrain.graph, terrain.table
            start, goal = (message.start_x, message.start_y), (message.goal_x, message.goal_y)
            for _ in range(min(MOST_REDRAWS, max(AT_LEAST, WHOLE_CELLS // terrain.sampled))):
                try:
                    terrain.sample_anew(start, goal)
                    other = self._plan(terrain, message, None)
                except NoRoute:
                    continue
                if found is None or _lost(other[0], found[0]):
                    found, kept = other, (terrain.graph, terrain.table)
                if not (_lost(before, found[0]) or _dear(found[0])):
                    break
            terrain.graph, terrain.table = kept
        if found is None:
            raise none
        self._newest = found[0]
        return found

    def _plan(self, terrain: MapGraph, message: msg.PlanRequest, driven: Path | None) -> tuple[Plan, Path]:
        """The route in the graph of now, and its path."""
        ahead = driven.ahead(message.start_x, message.start_y) if driven is not None else None
        request = PlanRequest(
            start=(message.start_x, message.start_y),
            goal=(message.goal_x, message.goal_y),
            start_yaw=message.start_yaw,
            goal_yaw=message.goal_yaw if message.has_goal_yaw else None,
            variant=self._params.variant,
            rules=replace(self.rules, backward=np.inf) if self._forward else self.rules,
            driven=Driven(*ahead) if ahead is not None and not (self._forward and ahead[1].any()) else None,
            held=(message.held_left, message.held_right),
            allow_frontier=True,
            previous_frontier=self._tried.chosen,
            tried=tuple(self._tried.places),
        )
        if self._other is not None:
            found = self._other(terrain.ground(), request)
            return found, self.path_of(terrain, found)
        found = terrain.search(request, np.vstack([message.avoid.reshape(-1, 3), *self._hidden]))
        if found.short > NO_PLAN_WITHIN and not found.transitions:
            why = "no way leads nearer to the goal than here: choose another goal, or clear the way"
            raise NoRoute(NoRouteReason.NO_ROUTE, why)
        if found.kept and driven is not None:
            pose = (message.start_x, message.start_y, message.start_yaw)
            return found, rest_of(driven, pose, terrain.ground(), self._body, terrain.terrain())
        return found, self.path_of(terrain, found)


def _lost(before: Plan | None, plan: Plan) -> bool:
    """Whether the way of the plan `before` is better than the other one: it alone leads to the goal, or less is still
    to be paid. The way to a frontier tells little of what lies behind it."""
    if before is None or before.reaches_goal is not plan.reaches_goal:
        return before is not None and before.reaches_goal
    return plan.worth > before.worth + LOST_MARGIN


def _dear(plan: Plan) -> bool:
    """Whether a plan that is not the way driven so far has a leg that costs much more than it is long."""
    return not plan.kept and any(t.cost - t.length > DEAR_LEG for t in plan.transitions)
