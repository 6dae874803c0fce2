"""What a rule of the planner is for: worlds are walked as the planner sees them on the way, with and without it.

    python -m tools.bench rules --without NAME [--only BEGINNING] [--steps 40] [--json]

Nothing is driven: the robot stands at once where its path comes to within a metre. Only ground in sight within
`SIGHT_RANGE` is seen, behind crests it is virtual. Rows tell the largest chance to fail of a plan on the way, what was
driven and turned, and whether the goal was refused; their baseline has all rules. Rules in compiled kernels are told
by comparing two commits.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.scenes import load_scene
from hal.scenes.scene import Scene
from mapping.elevation.virtual import virtual_ground
from mapping.filling import fill_unknown
from mapping.grid import ElevationGrid
from planning.errors import PlanningError
from rbtrg_robot import msg
from rbtrg_robot.config import load
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.stages.planner import limits_of
from rbtrg_robot.stages.way import WaySearch
from tools.bench.report import Report

CELL = 0.04
"""[m] of the map."""
NOISE, NOISE_GROWTH = 0.003, 0.004
"""[m], [m/m] sigma of its heights where the robot stands, and what it grows by with the distance of the nearest
look."""
SIGHT_RANGE, HEAD_HEIGHT = 3.0, 0.45
"""[m] how far and from how high the robot sees."""
UNDER_BODY = 0.6
"""[m] around the robot all ground is known."""
RAYS = 720
"""Directions of sight."""
STRIDE = 1.0
"""[m] between two plans."""
ARRIVED = 0.15
"""[m] from the goal."""

_LANES = [f"lanes:{seed},level=4,controller=hybrid" for seed in range(10)]
_KERBS = [f"lanes:{seed},level=4,controller=hybrid,map=kerbs" for seed in range(10)]
WORLDS = (
    {f"lane_{k}": (name, "end") for k, name in enumerate(_LANES)}
    | {f"kerbs_{k}": (name, "end") for k, name in enumerate(_KERBS)}
    | {f"{kind}_{k}": (f"places:{kind},{k}", "end") for kind in ("house", "moat", "pit") for k in (0, 1)}
    | {"stepfield": ("rescue_steps", "far"), "slopes": ("rescue_slopes", "crossing_end")}
)
"""Scene and goal; lanes of the rescue league, houses with doors, goals that nothing leads to, posts, crossing ramps."""

WAY, PLAN, FRONTIER = "rbtrg_robot.stages.way", "planning.search.plan", "planning.search.frontier"
Patch = tuple[str, str, Any]
RULES: dict[str, tuple[Patch, ...]] = {
    "other_graphs": ((WAY, "MOST_REDRAWS", 0), (WAY, "AT_LEAST", 0)),
    "graphs_for_dear_legs": ((WAY, "_dear", lambda _plan: False),),
    "places_ahead": (("planning.search.endpoints", "dear_to_turn", lambda *_: False),),
    "give_up": ((FRONTIER, "GIVE_UP_AFTER", math.inf),),
    "showed_nothing": ((FRONTIER, "SHOWN_SHARE", -math.inf),),
    "frontier_hysteresis": ((PLAN, "with_hysteresis", lambda _nodes, way, _goal, _previous: way),),
    "keep_driven": ((PLAN, "kept", lambda _ends, _request, found, _start, _goal: found),),
    "nearest": ((PLAN, "_to_nearest", lambda *_: None),),
    "straighten": ((PLAN, "straighten", lambda *_: None),),
    "held_turns": ((PLAN, "_take_out_held", lambda *_: False),),
}
"""What stands in place of each while it is out: module, name, substitute."""


@dataclass(slots=True)
class Walk:
    """How a robot came through a world."""

    end: str = "no end"
    """`there`, or why the goal was refused."""
    p_fail: float = 0.0
    driven: float = 0.0
    turned: float = 0.0
    paths: str = ""
    """Digest of all paths: equal where the rule changed nothing."""


class _Graph(MapGraph):
    """On a grid that is handed over, without a mirror of the map."""

    def sync(self, start: tuple[float, float]) -> bool:
        assert self.grid is not None
        self.refresh(start, self.grid, [])
        return True


class _World:
    """Ground, and what of it was seen."""

    def __init__(self, scene: Scene) -> None:
        n = max(1, round(CELL / scene.resolution))
        rows, cols = (v // n for v in scene.height.shape)
        high = scene.height[: rows * n, : cols * n].reshape(rows, n, cols, n).max(axis=(1, 3))
        self.cell = scene.resolution * n
        self.height = high.astype(np.float32)
        self.error = np.random.default_rng(0).normal(size=high.shape)
        self.nearest = np.full(high.shape, SIGHT_RANGE)
        half = 0.5 * (n - 1) * scene.resolution
        self.origin = scene.origin[0] + half, scene.origin[1] + half
        self.seen = np.zeros(high.shape, np.bool_)
        self.upper = np.full(high.shape, np.nan, np.float32)

    def look(self, x: float, y: float) -> NDArray[np.bool_]:
        """See from x, y [m]. -> (rows, cols) what of it is new, or told better than before."""
        col, row = (round((v - o) / self.cell) for v, o in zip((x, y), self.origin, strict=True))
        eye = float(self.height[row, col]) + HEAD_HEIGHT
        yy, xx = np.indices(self.height.shape)
        away = self.cell * np.hypot(xx - col, yy - row)
        near = np.flatnonzero((away < SIGHT_RANGE) & (away > 0.0))
        ray = np.floor(
            RAYS * (np.arctan2((yy - row).flat[near], (xx - col).flat[near]) / math.tau + 0.5)
        ).astype(int)
        order = np.lexsort((away.flat[near], ray))
        near, ray = near[order], ray[order]
        rise = (self.height.flat[near].astype(float) - eye) / away.flat[near]
        # A running maximum along each ray: rays are moved so far apart that none reaches into the next.
        before = np.maximum.accumulate(np.concatenate([[-1e9], rise + 1e3 * ray])) - 1e3 * np.append(ray, 0)
        hides = np.where(np.diff(ray, prepend=-1) != 0, -1e9, before[:-1])
        new = np.zeros_like(self.seen)
        new.flat[near] = rise >= hides - 1e-6
        new |= away < UNDER_BODY
        low = eye + hides * away.flat[near]
        bound = self.upper.flat[near]
        self.upper.flat[near] = np.where(hides > -1e8, np.fmin(bound, low), bound)
        new &= ~self.seen | (away < self.nearest - self.cell)
        self.seen |= new
        self.nearest[new] = away[new]
        return new

    def grid(self) -> ElevationGrid:
        """The map of now."""
        upper = np.where(self.seen, np.nan, self.upper).astype(np.float32)
        told = self.height + self.error * (NOISE + NOISE_GROWTH * self.nearest)
        height = fill_unknown(np.where(self.seen, told, np.nan).astype(np.float32), upper)
        virtual = virtual_ground(height, self.seen, upper, self.cell)
        return ElevationGrid(height, self.seen.copy(), self.origin, self.cell, virtual)


def walk(name: str, goal: str, steps: int) -> Walk:
    """Plan, stand `STRIDE` farther, look, and plan again, until the robot is there or the goal is refused."""
    scene = load_scene(name)
    config = load(None, [], scene=name, controller="hybrid")
    terrain = _Graph(config.graph_params(), config.body, config.seed)
    ways = WaySearch(config.planner, config.body, limits_of(config), config.capabilities().creep)
    world, out, digest, driven = _World(scene), Walk(), hashlib.sha256(), None
    (x, y, yaw), (gx, gy) = (float(v) for v in scene.start), (float(v) for v in scene.goals[goal][:2])
    for step in range(steps):
        r, c = np.nonzero(world.look(x, y))
        window = [(int(r.min()), int(c.min()), int(r.max()) + 1, int(c.max()) + 1)] if len(r) else []
        terrain.refresh((x, y), world.grid(), window)
        ask = msg.PlanRequest(goal_id=name, start_x=x, start_y=y, start_yaw=yaw, goal_x=gx, goal_y=gy)
        try:
            way = ways.find(terrain, ask, driven, step * 2_000_000_000)
        except PlanningError as error:
            out.end = str(error)
            digest.update(out.end.encode())
            break
        path, driven = way.path, way.whole
        for array in (path.points, path.yaw, path.speed):
            digest.update(array.tobytes())
        k = min(int(np.searchsorted(path.s, STRIDE)), len(path.points) - 1)
        out.p_fail = max(out.p_fail, way.plan.p_fail)
        out.driven += float(path.s[k])
        turns = (np.diff(path.yaw[: k + 1]) + math.pi) % math.tau - math.pi
        out.turned += abs(path.initial_turn or 0.0) + float(np.abs(turns).sum())
        x, y, yaw = float(path.points[k, 0]), float(path.points[k, 1]), float(path.yaw[k])
        if math.dist((x, y), (gx, gy)) < ARRIVED:
            out.end = "there"
            break
    out.paths = digest.hexdigest()
    return out


@contextmanager
def without(rule: str) -> Iterator[None]:
    """A rule of `RULES` is out."""
    past = [(importlib.import_module(module), name, new) for module, name, new in RULES[rule]]
    kept = [getattr(module, name) for module, name, _ in past]
    for module, name, new in past:
        setattr(module, name, new)
    try:
        yield
    finally:
        for (module, name, _), old in zip(past, kept, strict=True):
            setattr(module, name, old)


def run(args: list[str]) -> Report:
    """Run this bench; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench rules", description=__doc__)
    parser.add_argument("--without", choices=sorted(RULES), action="append", default=[])
    parser.add_argument("--only", default="", help="beginning of the names of worlds")
    parser.add_argument("--steps", type=int, default=40, help="most plans in a world")
    options = parser.parse_args(args)
    report = Report("rules")
    worlds = {name: place for name, place in WORLDS.items() if name.startswith(options.only)}
    if not worlds:
        parser.error(f"no world begins with {options.only!r}: there are {', '.join(WORLDS)}")
    base = {name: walk(*place, options.steps) for name, place in worlds.items()}
    for rule in options.without or [""]:
        changed = 0
        for name, place in worlds.items():
            first = now = base[name]
            if rule:
                with without(rule):
                    now = walk(*place, options.steps)
            changed += now.paths != first.paths
            key = f"rules.{rule or 'all'}.{name}"
            print(
                f"{key}: {now.end}" + ("" if now.paths == first.paths else ", other paths"), file=sys.stderr
            )
            for what, unit in (("p_fail", "chance"), ("driven", "m"), ("turned", "rad")):
                report.add(f"{key}.{what}", getattr(now, what), unit, baseline=getattr(first, what))
            report.add(f"{key}.arrived", now.end == "there", "of 1", baseline=first.end == "there")
        report.add(f"rules.{rule or 'all'}.changed", changed, f"of {len(worlds)} worlds")
    return report
