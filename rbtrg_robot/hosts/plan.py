"""Plans on a map without a robot: the stack's own planner on any file that `--map` or `--scene` reads."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hal.rotation import wrap
from hal.safety.geofence import Fence
from hal.scenes import SceneError, load_scene, scene_names
from hal.scenes.picture import GREEN, RED, WHITE, TopView
from mapping.elevation.exchange import MapError
from mapping.elevation.map import ElevationMap
from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.path import PathLimits
from planning.risk.body import BodyModel
from planning.risk.table import RiskTable
from rbtrg_robot import msg
from rbtrg_robot.areas import fence_of, read_areas
from rbtrg_robot.config import ConfigError, StackConfig, load
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.stages.navigation.goal import Goal, GoalArea, arrival
from rbtrg_robot.stages.navigation.reasons import Reason, words
from rbtrg_robot.stages.planner import limits_of
from rbtrg_robot.stages.route_report import REASONS, RouteBase
from rbtrg_robot.stages.way import Way, WaySearch

FEATURES = {  # in the order of the body's scales
    "d_fb": "pitch from front to back",
    "a_lr": "roll from left to right",
    "p_int": "ground that comes near the body",
}
UNITS = {"d_fb": "m", "a_lr": "deg", "p_int": "m"}
STARTS_TRIED, HEADINGS_TRIED = 20, 8
"""Places, and headings at each, before no other start is named."""
START_SPACING = 0.5
"""Of these places [m]."""
PATH_COLOUR, BEST, WORST = (255, 170, 40), (80, 200, 120), (235, 60, 60)


@dataclass(frozen=True, slots=True)
class Route:
    """The answer to one question; lengths in metres, angles in degrees."""

    ok: bool
    reason: str = ""
    """Empty for a route to the goal; else as a goal's: no_route, start_off_graph ..."""
    detail: str = ""
    advice: str = ""
    """Where to start instead; a part of `detail`."""
    reaches_goal: bool = False
    length: float = 0.0
    duration: float = 0.0
    """[s] at the path's own speeds."""
    cost: float = 0.0
    p_fail: float | None = None
    """Probability that it fails, of this controller; None: not known."""
    chance: str = ""
    """The same in words, with the place where that is most likely."""
    p_fail_each: list[float] = field(default_factory=list)
    """Of each transition."""
    worst: dict[str, Any] = field(default_factory=dict)
    """Where the body is worst off: x, y, yaw, body (risk), and why."""
    path: list[tuple[float, float, float, float]] = field(default_factory=list, repr=False)
    """x, y, z, yaw [rad] every 0.1 m."""

    @property
    def words(self) -> str:
        """One line for people."""
        if not self.ok:
            return f"no route ({self.reason}): {self.detail}"
        end = "" if self.reaches_goal else ", to a frontier: over known ground there is no way to the goal"
        worst = self.worst
        why = (
            f"; most body risk, {worst['body']:.2f}, at ({worst['x']:.2f}, {worst['y']:.2f}): {worst['why']}"
            if worst
            else ""
        )
        chance = f"; {self.chance}" if self.chance else ""
        return f"{self.length:.2f} m, {self.duration:.0f} s{end}{chance}{why}"


class MapPlanner:
    """One map, many questions."""

    def __init__(
        self,
        ground: str | ElevationGrid,
        config: StackConfig | None = None,
        start: tuple[float, float] | None = None,
    ) -> None:
        """`ground`: a built-in scene, a scene file or a saved map to read, or a grid of heights. `start` x, y [m]:
        where the questions begin; a file without a level place to start on needs it. Raises ConfigError, SceneError,
        MapError."""
        self.config = config = config or load()
        self._body: BodyModel = config.body
        self._limits: PathLimits = limits_of(config)
        elevation = ElevationMap(config.elevation, config.crossing())
        self.start, self.goals, self.taken = _fill(elevation, ground, config, start)
        drawn = read_areas(Path(ground)) if isinstance(ground, str) and Path(ground).is_file() else []
        fence = Fence.of(config.area, config.keepout).and_all_of(fence_of(drawn))
        self._area = GoalArea.of(config, fence)
        self._asked: tuple[float, float] | None = None
        """The goal of the newest question that was searched."""
        self._patches = [elevation.read(box) for box in elevation.boxes()]
        if not self._patches:
            raise ConfigError(
                f"{ground if isinstance(ground, str) else 'the grid'} holds no ground to plan on"
            )
        self._terrain: MapGraph | None = None
        self._known = np.vstack(
            [
                patch.resolution * np.argwhere(np.isfinite(patch.layers["elevation"]))[:, ::-1] + patch.origin
                for patch in self._patches
            ]
        )
        """(n, 2) x, y [m] of the cells."""
        half = 0.5 * config.elevation.resolution
        low, high = self._known.min(axis=0) - half, self._known.max(axis=0) + half
        self.extent: tuple[float, float, float, float] = (*map(float, low), *map(float, high))  # type: ignore[assignment]
        """x, y of the lowest and of the highest corner [m]."""

    @classmethod
    def of_array(
        cls, height: NDArray[np.floating], resolution: float, origin: tuple[float, float] = (0.0, 0.0)
    ) -> MapPlanner:
        """Of heights (rows, cols) [m], NaN where the ground is not known; row and column grow with y and x.
        `resolution`: cell size [m]; `origin`: x, y [m] of the centre of cell [0, 0]. Raises GridError, ConfigError."""
        return cls(ElevationGrid(height, np.isfinite(height), origin, resolution))

    def plan(
        self,
        start: tuple[float, float],
        goal: tuple[float, float],
        start_yaw: float = 0.0,
        goal_yaw: float | None = None,
        *,
        other_start: bool = True,
    ) -> Route:
        """A route; yaw in radians. It depends on start and goal alone, not on what was asked before. `other_start`: of
        a start that leads nowhere tell another one, which draws up to `STARTS_TRIED` graphs."""
        x0, y0, x1, y1 = self.extent
        for name, (x, y), why in (("start", start, Reason.START_OFF_GRAPH), ("goal", goal, Reason.INVALID)):
            if not (x0 <= x <= x1 and y0 <= y <= y1):
                reach = f"({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f})"
                return Route(
                    False,
                    why.value,
                    f"the {name} ({x:g}, {y:g}) lies outside the map, which reaches from {reach}",
                )
        if (wrong := Goal("", *goal, goal_yaw, 0).misplaced(self._area)) is not None:
            return Route(False, wrong[0].value, words(*wrong))
        terrain = MapGraph(self.config.graph_params(), self._body, self.config.seed)
        terrain.enclose(self._area.fence)
        for patch in self._patches:
            terrain.apply(patch)
        terrain.sync(start)
        self._terrain, self._asked = terrain, goal
        asked = msg.PlanRequest(
            goal_id="plan",
            start_x=float(start[0]),
            start_y=float(start[1]),
            start_yaw=float(start_yaw),
            goal_x=float(goal[0]),
            goal_y=float(goal[1]),
            has_goal_yaw=goal_yaw is not None,
            goal_yaw=0.0 if goal_yaw is None else float(goal_yaw),
        )
        ways = WaySearch(self.config.planner, self._body, self._limits)
        try:
            way = ways.find(terrain, asked, None, 0)
        except PlanningError as error:
            if not isinstance(error, NoRoute):
                return Route(False, Reason.INVALID.value, str(error))
            # There is no robot that could look or be driven: the stage's advice helps nobody here.
            where = f"the start ({start[0]:g}, {start[1]:g})"
            told = {
                NoRouteReason.NO_TERRAIN: f"the map knows no ground around {where}",
                NoRouteReason.START_NOT_ON_GRAPH: f"no straight move leads from {where} to drivable ground",
            }.get(error.reason)
            advice = self._other_start(terrain, ways, asked) if told is not None and other_start else ""
            detail = ": ".join(filter(None, (told or str(error), advice)))
            return Route(False, REASONS[error.reason].value, detail, advice=advice)
        return self._route(way, terrain)

    def _route(self, way: Way, terrain: MapGraph) -> Route:
        grid, graph = terrain.ground(), terrain.graph
        assert graph is not None
        table = terrain.table
        if table is None or table.grid is not grid:  # a baseline makes none
            table = RiskTable(graph, grid, terrain.body, None)
        told = RouteBase(msg.Header(), "plan").report(way.plan, way.path, table)
        return Route(
            ok=True,
            reason="" if told.reaches_goal else "frontier",
            reaches_goal=told.reaches_goal,
            length=float(told.length),
            duration=told.duration,
            cost=float(told.cost),
            p_fail=None if math.isnan(told.p_fail) else told.p_fail,
            chance=self._chance(told),
            p_fail_each=told.transition_p_fail.tolist(),
            worst=_worst(told, terrain.body),
            path=list(zip(*(x.tolist() for x in (told.x, told.y, told.z, told.yaw)), strict=True)),
        )

    def _other_start(self, terrain: MapGraph, ways: WaySearch, asked: msg.PlanRequest) -> str:
        """What to ask instead of a start that leads nowhere: another heading there, or a place near it with a way."""
        start, yaw = (asked.start_x, asked.start_y), asked.start_yaw
        for place in (start, *_apart(self._known, start)):
            terrain.graph = None  # a graph has what is reached from where it began
            terrain.sync(place)
            if terrain.graph is None:
                continue
            for x, y in (place, *_apart(terrain.graph.nodes[:, :2], start)[:1]):
                for turn in np.linspace(0.0, 2.0 * math.pi, HEADINGS_TRIED, endpoint=False).tolist():
                    heading = wrap(yaw + turn)
                    asked = dataclasses.replace(asked, start_x=x, start_y=y, start_yaw=heading)
                    try:
                        found = ways.find(terrain, asked, None, 0).plan.reaches_goal
                    except PlanningError as error:
                        if isinstance(error, NoRoute) and error.reason is NoRouteReason.START_NOT_ON_GRAPH:
                            continue
                        break
                    if found:
                        return f"START {x:.2f},{y:.2f},{math.degrees(heading):.0f} has a way"
                    break
        return "no place near it has a way to the goal, either"

    def _chance(self, told: msg.RouteReport) -> str:
        accepted = self.config.planner.accept_risk
        refused = f" (above planner.accept_risk, {100 * accepted:.0f} %: a goal is refused without --accept)"
        return arrival(told.p_fail, told.worst) + (refused if told.p_fail > accepted else "")

    def image(self, route: Route) -> Image.Image:
        """The answer to the newest question over the risk of the ground: edges of the graph from green to red, the
        path, the worst place. A notebook shows it. Raises ConfigError where there is no ground."""
        if self._terrain is None or self._asked is None:
            raise ConfigError("nothing was searched yet: there is nothing to draw")
        grid = self._terrain.grid
        if grid is None:
            raise ConfigError("there is no ground at the start: nothing to draw")
        r, c = (np.flatnonzero(grid.trusted.any(axis=axis)) for axis in (1, 0))
        seen = slice(r[0], r[-1] + 1), slice(c[0], c[-1] + 1)
        corner = grid.origin[0] + c[0] * grid.resolution, grid.origin[1] + r[0] * grid.resolution
        height = np.where(np.isfinite(grid.height), grid.height, np.nanmin(grid.height))
        view = TopView(height[seen], grid.trusted[seen], corner, grid.resolution)
        graph = self._terrain.graph
        if graph is not None:
            source = np.repeat(np.arange(len(graph.nodes)), np.diff(graph.indptr))
            once = source < graph.indices
            top = max(float(np.quantile(graph.risk[once], 0.98)), 1e-6) if once.any() else 1.0
            for a, b, risk in zip(source[once], graph.indices[once], graph.risk[once], strict=True):
                share = min(float(risk) / top, 1.0)
                colour = tuple(round(g + share * (w - g)) for g, w in zip(BEST, WORST, strict=True))
                view.line([tuple(graph.nodes[a, :2]), tuple(graph.nodes[b, :2])], colour)  # type: ignore[arg-type]
        if route.path:
            view.line([(x, y) for x, y, *_ in route.path], PATH_COLOUR, 4)
            x, y, _, yaw = route.path[0]
            view.arrow(x, y, yaw, 0.4, GREEN)
        if route.worst:
            view.disc(route.worst["x"], route.worst["y"], RED, 6)
            view.label(route.worst["x"], route.worst["y"], "worst")
        view.disc(*self._asked, WHITE, 5)
        return view.image()


def _apart(places: NDArray[np.floating], near: tuple[float, float]) -> list[tuple[float, float]]:
    """Some of places (n, 2), `START_SPACING` apart about, the nearest first; half of them from everywhere else: nearby
    there may be nothing but a wall."""
    order = np.argsort(np.linalg.norm(places - near, axis=1))
    _, first = np.unique(np.floor(places[order] / START_SPACING), axis=0, return_index=True)
    chosen, half = np.sort(first), STARTS_TRIED // 2
    if len(chosen) > STARTS_TRIED:
        chosen = np.r_[chosen[:half], chosen[half:][np.linspace(0, len(chosen) - half - 1, half).astype(int)]]
    return [(float(x), float(y)) for x, y in places[order[chosen]]]


def map_of(ground: str | ElevationGrid, config: StackConfig) -> tuple[ElevationMap, str]:
    """What `MapPlanner` reads, as a map, and what had to be guessed of it. Raises ConfigError, SceneError, MapError."""
    elevation = ElevationMap(config.elevation, config.crossing())
    _, _, taken = _fill(elevation, ground, config, None)
    return elevation, taken


Goals = dict[str, tuple[float, float, float | None]]


def _fill(
    elevation: ElevationMap,
    ground: str | ElevationGrid,
    config: StackConfig,
    start: tuple[float, float] | None,
) -> tuple[tuple[float, float, float], Goals, str]:
    """See `_load`."""
    if isinstance(ground, str):
        return _load(ground, config, elevation, start)
    _take(elevation, np.where(ground.trusted, ground.height, np.nan), ground.resolution, ground.origin)
    return (*(start or ground.origin), 0.0), {}, ""


def _worst(told: msg.RouteReport, body: BodyModel) -> dict[str, Any]:
    """The transition with the largest body risk, and the feature that made it so."""
    if not len(told.transition_body):
        return {}
    k = int(told.transition_body.argmax())
    peak = {name: float(getattr(told, name)[k]) for name in FEATURES}
    name = max(peak, key=lambda n: peak[n] / body.scales[list(FEATURES).index(n)])
    unknown = float(told.transition_unknown[k])
    why = (
        f"{FEATURES[name]} {peak[name]:.2g} {UNITS[name]}"
        if peak[name] > 0
        else "unknown ground"
        if unknown > 0
        else "nothing to speak of"
    )
    return {
        "x": float(told.worst_x[k]),
        "y": float(told.worst_y[k]),
        "yaw": math.degrees(told.worst_yaw[k]),
        "body": float(told.transition_body[k]),
        "unknown": unknown,
        "why": why,
        **peak,
    }


def _load(
    file: str, config: StackConfig, elevation: ElevationMap, start: tuple[float, float] | None
) -> tuple[tuple[float, float, float], Goals, str]:
    """Start and named goals of what is read into `elevation`, and what had to be guessed of it."""
    if Path(file).suffix.lower() == ".npz" and Path(file).is_file():
        try:
            elevation.load_prior(Path(file))
            return (0.0, 0.0, 0.0), {}, ""
        except MapError as wrong:
            raise ConfigError(str(wrong)) from wrong
    try:
        try:
            scene = load_scene(file, **config.scene_options)
        except SceneError:
            if start is None or not Path(file).is_file():
                raise
            scene = load_scene(file, **config.scene_options, start=(*start, 0.0))
    except SceneError as error:
        if not Path(file).suffix and not Path(file).exists():
            raise ConfigError(
                f"{file} is neither a file nor a scene; scenes are {', '.join(scene_names())}"
            ) from error
        raise
    height = scene.survey if scene.survey is not None else scene.height
    _take(elevation, height, scene.resolution, scene.origin)
    return scene.start, dict(scene.goals), scene.taken


def _take(
    elevation: ElevationMap, height: NDArray[np.floating], resolution: float, origin: tuple[float, float]
) -> None:
    """Heights as a prior map."""
    with tempfile.TemporaryDirectory() as folder:
        grid = Path(folder) / "grid.npz"
        np.savez(grid, height=height, resolution=resolution, origin=origin)
        elevation.load_prior(grid)
