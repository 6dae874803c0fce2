"""The planner as a stage: map blocks in, routes out. Keeps one graph and rebuilds only what changed."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.safety.planned import free_turn, known_behind, mapped
from hal.safety.swept import Body
from hal.types import NS
from mapping.elevation.exchange import PATCH_LAYERS, MapError, MapPatch
from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.graph.graph import GraphParams
from planning.path import (
    Path,
    PathLimits,
    face_in_the_way,
    in_fields,
    new_field,
    still_safe,
)
from planning.risk.body import BodyModel
from planning.search.guarded import drives_over
from planning.search.plan import DriveRules, Plan, PlanRequest
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import fence_of
from rbtrg_robot.config import StackConfig
from rbtrg_robot.stage_config import PlannerConfig
from rbtrg_robot.stages.look_around import views_of
from rbtrg_robot.stages.map_blocks import MapBlocks
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.stages.navigation.goal import Goal, GoalArea
from rbtrg_robot.stages.navigation.reasons import Reason
from rbtrg_robot.stages.route_report import REASONS, RouteBase, path_msg, plan_fields, too_risky, worst_of
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.stages.way import WaySearch
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP, LayoutError, map_parts, map_patch
from rbtrg_robot.wire.messages import header

PARTS_PER_TICK = 2
"""Parts of the map that a restarted elevation process gets in one tick."""
MAP_SETTLED = 300_000_000
"""[ns] without a block of the map: the whole of a prior map has come. While the robot maps, blocks come every 0.5 s."""
ASK_AGAIN = 1_500_000_000
"""From the last part until all are sent, or asked for, once more [ns]; shorter than a restarted elevation process waits
for one."""


class PlannerStage:
    """Blocks of the map and requests in, plans out.
    In: changed blocks and the window of the map, plan requests, people's questions, where to explore. Out: plans and
    paths, why they are so, whether the present path still holds, a copy of the map for a restarted elevation process.
    It decides the route on the map of now, and keeps one graph that it rebuilds only where cells changed. It never owns
    a goal and never commands motion.
    """

    inputs = (
        t.MAP_UPDATE,
        t.MAP_WINDOW,
        t.MAP_PARTS,
        t.MAP_STATUS,
        t.PLAN_REQUEST,
        t.ROUTE_QUESTION,
        t.EXPLORE_QUESTION,
        t.AREAS,
    )
    outputs = (t.PLAN, t.ROUTE, t.ROUTE_REPORT, t.ROUTE_STATUS, t.MAP_REQUEST, t.MAP_MIRROR, t.VIEWPOINTS)
    needs_all = (t.MAP_UPDATE, t.MAP_STATUS)
    """Without a block the copy of the map is wrong for good, without the status that tells of a new epoch the blocks
    before the next one go."""

    def __init__(
        self,
        params: PlannerConfig,
        graph_params: GraphParams,
        body: BodyModel,
        limits: PathLimits,
        seed: int = 0,
        creep: float = 0.0,
        area: GoalArea = GoalArea(),
    ) -> None:
        """`seed` of the graph's samples; `creep` [m/s]: see `Capabilities`; `area`: what the configuration keeps the
        robot in and out of."""
        self._area, self._configured = area, area
        self._params = params
        self._body = body
        self._limits = limits
        self._map = MapGraph(graph_params, body, seed)
        self._map.enclose(area.fence)
        self._ways = WaySearch(params, body, limits, creep)
        self._epoch = 0
        self._updated = 0
        self._patched = 0
        """When the newest block of the map came [ns]."""
        self._unprepared = False
        """The graph follows the map, its edges were not evaluated yet."""
        self._start: tuple[float, float] | None = None
        self._now = 0
        self._status_due = 0
        self._answered: tuple[str, int] = ("", 0)
        self._whole: Path | None = None
        """The newest path, over virtual ground too."""
        self._path: Path | None = None
        """The part of it that is driven."""
        self._fields = np.zeros(0, np.bool_)
        """Of the poses that are watched on `_path`: those in stepfields that were known when it was made."""
        self._malformed = 0
        self._incomplete = False
        """Something of the map was lost on its way: all of it is asked for."""
        self._parts = 0
        """How many parts come."""
        self._came: set[int] = set()
        """Those that have come."""
        self._heard = -ASK_AGAIN
        """When the newest one came [ns]."""
        self._returning = MapBlocks()
        self._returned = -ASK_AGAIN
        """When its newest part was sent [ns]."""
        self._verdict = (True, "")
        self._checked_version = -1

    def warm_up(self) -> None:
        """Plan on made-up ground."""
        stage = self._on_made_up_ground()
        # A goal on the map, again with what is driven and without, then one off it: the second needs no search, the
        # third carries evaluations and search
        # over, the last looks for a frontier.
        for number, (goal, driven) in enumerate(((3.0, False), (3.0, True), (3.0, False), (9.0, False))):
            height, grid, _ = _made_up(number + 1)
            stage._map.refresh((2.0, 2.0), grid, [(5, 5, 10, 10)])
            stage._whole = stage._whole if driven else None
            stage._answer(msg.PlanRequest(start_x=1.0, start_y=1.0, goal_x=goal, goal_y=goal))
        stage._question(msg.RouteQuestion(start_x=1.0, start_y=1.0, goal_x=3.0, goal_y=3.0))
        around, here = mapped(height, grid.origin, grid.resolution), (2.0, 2.0, 0.0)
        robot = drives_over(stage._map.params)
        known_behind(around, here, Body.of(robot), robot.max_gap, 0.1)
        free_turn(around, here, 1.0, robot)
        # Kernels of the elevation map, which has compiled them by now.
        _made_up(0)[2].grid(filled=True)

    def warm_up_rest(self) -> None:
        """Look for where to explore on made-up ground."""
        stage = self._on_made_up_ground()
        where = msg.ExploreQuestion(start_x=1.0, start_y=1.0, has_home=True, home_x=1.0, home_y=1.0)
        views = views_of(stage._map, where, self._body, 0)
        if len(views.x):  # not the first: it must be ordered
            where.has_target, where.target_x, where.target_y = True, float(views.x[-1]), float(views.y[-1])
            views_of(stage._map, where, self._body, 0)

    def _on_made_up_ground(self) -> PlannerStage:
        stage = PlannerStage(self._params, self._map.params, self._body, self._limits, self._map.seed)
        stage._map.refresh((2.0, 2.0), _made_up(0)[1], [(5, 5, 10, 10)])
        return stage

    @property
    def terrain(self) -> MapGraph:
        """The map of now and the graph on it."""
        return self._map

    @property
    def now(self) -> int:
        """[ns] of the newest tick."""
        return self._now

    def put_on(self, folder: FilePath) -> None:
        """See `KeepsMap`."""
        self._map.mirror.put_on(folder)

    def close(self) -> None:
        """Nothing to release."""

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        if t.MAP_UPDATE.carried(message, topic):
            self._take_patch(message)
        elif t.MAP_PARTS.carried(message, topic):
            self._take_part(message)
        elif t.MAP_WINDOW.carried(message, topic):
            return self._watch(message)
        elif t.MAP_STATUS.carried(message, topic):
            self._epoch = int(message.epoch)
            if not message.restoring:
                self._returning.stop()
            elif self._map.known:
                return self._return_map()
        elif t.AREAS.carried(message, topic):
            self._area = self._configured.beside(fence_of(message.areas))
            self._map.enclose(self._area.fence)
        elif t.PLAN_REQUEST.carried(message, topic):
            return self._answer(message)
        elif t.ROUTE_QUESTION.carried(message, topic):
            return self._question(message)
        elif t.EXPLORE_QUESTION.carried(message, topic):
            self._start = self._start or (message.start_x, message.start_y)
            return [(t.VIEWPOINTS, views_of(self._map, message, self._body, self._now))]
        return []

    def _return_map(self) -> Outputs:
        """The map for an elevation process that lost it, part by part. It may have all of it and be slow: what is lost
        is sent again later."""
        if (due := self._next_parts()) or 0 <= self._now - self._returned < ASK_AGAIN:
            return due
        self._returned = self._now
        mirror = self._map.mirror
        parts = map_parts(mirror.windows(), mirror.read, mirror.stamp)
        return self._returning.begin("mirror", ((t.MAP_MIRROR, part) for part in parts))

    def _next_parts(self) -> Outputs:
        parts = self._returning.due(PARTS_PER_TICK)
        self._returned = self._now if parts else self._returned
        return parts

    def _take_patch(self, message: msg.GridMap) -> bool:
        """False where it is none."""
        self._patched = self._now
        try:
            self._map.apply(map_patch(message, max(self._epoch, self._map.mirror.epoch)))
        except (LayoutError, MapError):
            self._malformed += 1
            return False
        return True

    def missed(self, topic: Topic) -> None:
        """A block of the map, or its status, was lost."""
        self._incomplete = True
        self._came.clear()

    def _take_part(self, message: msg.MapPart) -> None:
        """One of all, where they were asked for; others ask for them, too."""
        if not self._incomplete and self._map.known:
            return
        if message.parts != self._parts:  # the map has grown: they are others
            self._parts = message.parts
            self._came.clear()
        self._heard = self._now
        self._incomplete = True
        # What has come stays: on a busy computer one of each sending was lost, and all of it was never there at once.
        if message.part in self._came or (message.part < message.parts and self._take_patch(message.map)):
            self._came.add(message.part)
            self._incomplete = len(self._came) < message.parts

    def _watch(self, message: msg.GridMap) -> Outputs:
        """Look whether something came into the way of the path, at the rate of the scans."""
        if self._path is None:  # the robot may be driven by hand, or carried to its place in a prior map
            place = message.info.pose.position
            self._start = (place.x, place.y) if math.isfinite(place.x + place.y) else self._start
        watching = self._path is not None and self._verdict[0]
        if not watching and self._map.window is None:
            return []
        try:
            window = map_patch(message, self._map.mirror.epoch)
        except LayoutError:
            self._malformed += 1
            return []
        if self._map.window is not None:
            self._map.window = window
        if self._path is None or not watching:
            return []
        self._path = self._path.beyond(*window.middle)
        face = face_in_the_way(self._path, window.grid(), self._body)  # faces are between known cells
        if not face:
            return []
        self._map.window = window
        self._verdict = (False, face)
        return [(t.ROUTE_STATUS, self._status(self._now))]

    # --- graph ------------------------------------------------------------------------------------------------

    def tick(self, now: int) -> Outputs:
        """Let the graph follow the map while a path is driven on it; report twice a second."""
        self._now = now
        due = now - self._updated >= self._params.update_period * NS or now < self._updated
        if due and self._path is not None and self._start is not None and self._map.stale:
            self._sync(self._start)
        self._prepare(due)
        outputs = self._next_parts()
        if now < self._status_due and now > self._status_due - NS:
            return outputs
        self._status_due = now + NS // 2
        outputs.append((t.ROUTE_STATUS, self._status(now)))
        # Just started, it asks for what was published before.
        if (self._incomplete or not self._map.known) and not 0 <= now - self._heard < ASK_AGAIN:
            outputs.append((t.MAP_REQUEST, msg.MapRequest(header=header(now, MAP), action="parts")))
        return outputs

    def _prepare(self, due: bool) -> None:
        """Once much new ground has come (a prior map), build the graph on it and evaluate its edges before a goal needs
        them; a step a tick."""
        if self._unprepared:
            self._unprepared = False
            self._map.prepare()
        elif (
            due
            and self._map.much_is_new
            and self._start is not None
            and self._now - self._patched >= MAP_SETTLED
        ):
            self._sync(self._start)
            self._unprepared = True

    def _sync(self, start: tuple[float, float]) -> None:
        self._updated = self._now
        self._malformed += not self._map.sync(start)

    def _status(self, now: int) -> msg.RouteStatus:
        graph, grid = self._map.graph, self._map.grid
        if graph is not None and self._path is not None and graph.version != self._checked_version:
            self._checked_version = graph.version
            assert grid is not None
            if self._params.method == "rb_trg":
                _, why = still_safe(self._path, graph, grid, self._body)
                why = why or new_field(self._path, graph, self._fields)
                self._verdict = (not why, why)
            else:  # its routes keep to no graph
                face = face_in_the_way(self._path, grid, self._body)
                self._verdict = (not face, face)
        valid, detail = self._verdict
        return msg.RouteStatus(
            header=header(now, MAP),
            goal_id=self._answered[0],
            sequence=self._answered[1],
            valid=valid,
            detail=detail,
            nodes=0 if graph is None else len(graph.nodes),
            edges=0 if graph is None else len(graph.indices) // 2,
            map_version=0 if graph is None else graph.version,
            crept=self._ways.crept,
        )

    # --- requests ---------------------------------------------------------------------------------------------

    def _answer(self, message: msg.PlanRequest) -> Outputs:
        numbers = (message.start_x, message.start_y, message.start_yaw, message.goal_x, message.goal_y)
        sound = all(map(math.isfinite, (*numbers, message.goal_yaw))) and len(message.avoid) % 3 == 0
        if not (sound and np.isfinite(message.avoid).all()):
            self._malformed += 1
            return []
        self._start = (message.start_x, message.start_y)
        driven = self._whole if self._verdict[0] and message.goal_id == self._answered[0] else None
        self._answered = (message.goal_id, int(message.sequence))
        self._path, self._whole, self._verdict = None, None, (True, "")
        if self._map.stale or self._map.window is not None or self._map.graph is None:
            self._sync(self._start)
        base: dict[str, Any] = {
            "header": header(self._now, MAP),
            "goal_id": message.goal_id,
            "sequence": message.sequence,
        }
        try:
            way = self._ways.find(self._map, message, driven, self._now)
        except NoRoute as none:
            reason = REASONS[none.reason]
            return [(t.PLAN, msg.Plan(**base, ok=False, reason=reason.value, detail=self._why(none)))]
        except PlanningError as error:
            reason = Reason.INVALID
            return [(t.PLAN, msg.Plan(**base, ok=False, reason=reason.value, detail=str(error)))]
        found = way.plan
        if found.p_fail > self._params.accept_risk and not message.accept_risk:
            told: dict[str, Any] = {"p_fail": found.p_fail, "worst": worst_of(found)}
            reason, why = Reason.TOO_RISKY, too_risky(found, self._params.accept_risk)
            return [(t.PLAN, msg.Plan(**base, **told, ok=False, reason=reason.value, detail=why))]
        self._whole, self._path = way.whole, way.path
        if self._map.graph is not None:
            self._fields = in_fields(way.path, self._map.graph)
        self._checked_version = -1
        outputs: Outputs = [
            (t.PLAN, msg.Plan(**base, **plan_fields(found, way.path, message), creep=way.creep)),
            (t.ROUTE, path_msg(way.path, self._now)),
        ]
        if self._map.table is not None and self._params.method == "rb_trg":
            report = RouteBase(base["header"], message.goal_id).report(found, way.path, self._map.table)
            outputs.append((t.ROUTE_REPORT, report))
        if way.creep:  # the map hears of it before the wheels come there
            outputs.append((t.ROUTE_STATUS, self._status(self._now)))
        return outputs

    def _why(self, none: NoRoute) -> str:
        """In words, also for who does not see the fence."""
        kept = none.reason is not NoRouteReason.START_NOT_ON_GRAPH and any(
            p.keep_out for p in self._map.fence.polygons
        )
        return f"{none}; keep-out areas are as walls" if kept else str(none)

    def _question(self, message: msg.RouteQuestion) -> Outputs:
        """How a route would go. The plan that is driven, and what it is watched by, stay as they are."""
        start, goal = (message.start_x, message.start_y), (message.goal_x, message.goal_y)
        self._start = self._start or start
        if self._map.stale or self._map.graph is None:
            self._sync(self._start)
        base = RouteBase(header(self._now, MAP), message.id, question=True)
        graph = self._map.graph if message.graph else None
        yaw = message.goal_yaw if message.has_goal_yaw else None
        native: Plan | None = None
        rules = self._ways.rules
        variant = self._params.variant
        wanted = PlanRequest(start, goal, message.start_yaw, yaw, variant, rules=rules, allow_frontier=True)
        if (wrong := Goal("", *goal, yaw, 0).misplaced(self._area)) is not None:
            return [(t.ROUTE_REPORT, base.refused(*wrong, graph))]
        try:
            self._ways.begins(self._map, start)
            found = self._ways.told(self._map, self._map.search(wanted))
            path = self._ways.path_of(self._map, found)
        except NoRoute as none:
            return [(t.ROUTE_REPORT, base.refused(REASONS[none.reason], self._why(none), graph))]
        except PlanningError as error:
            return [(t.ROUTE_REPORT, base.refused(Reason.INVALID, str(error), graph))]
        try:
            native = self._map.search(replace(wanted, variant="native", rules=DriveRules()))
        except PlanningError:
            native = None
        assert self._map.table is not None
        return [(t.ROUTE_REPORT, base.report(found, path, self._map.table, native, graph))]


def _made_up(bumps: int) -> tuple[NDArray[np.float32], ElevationGrid, MapPatch]:
    """Ground for a rehearsal: height (100, 100) [m], the map of it, and how it would be sent."""
    x = np.linspace(-0.05, 0.05, 100, dtype=np.float32)
    height = x[:, None] * x[None, :]
    height[5:10, 5:10] += np.float32(0.001 * bumps)
    layers = dict.fromkeys(PATCH_LAYERS, np.ones_like(height)) | {"elevation": height}
    patch = MapPatch((0.0, 0.0), 0.04, 0, 0, layers)
    return height, replace(patch.grid(), virtual=np.zeros(height.shape, np.bool_)), patch


def build(config: StackConfig) -> PlannerStage:
    """From the stack's configuration."""
    graph, robot = config.graph_params(), config.capabilities()
    return PlannerStage(
        config.planner,
        graph,
        config.body,
        limits_of(config),
        config.seed,
        robot.creep,
        GoalArea.of(config),
    )


def limits_of(config: StackConfig) -> PathLimits:
    """What a path keeps to."""
    graph, fastest = config.graph_params(), config.tracker.max_speed
    return PathLimits(
        max_speed=fastest,
        max_step=graph.max_step,
        max_slope=graph.max_slope,
        step_speed=min(config.capabilities().step_vx, fastest),
    )
