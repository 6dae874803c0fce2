"""A site explored by the library alone: a robot that follows the graph exactly and sees what is in sight, without
physics, noise or time.

It compares orders of places on many sites in seconds. What the whole stack makes of them is `driven.py`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.scenes.scene import Scene
from mapping.filling import fill_unknown
from mapping.grid import ElevationGrid
from planning.graph.graph import GraphParams, TraversalGraph
from planning.risk.body import BodyModel
from planning.search.sight import Sight
from planning.search.viewpoints import BARRED_RADIUS, LEAST_GAIN, Survey, viewpoints

SIGHT_RANGE, EYE_HEIGHT = 4.5, 0.5
"""[m] Farthest ground that is seen, and the height of the LiDAR above the ground."""
RAY_COUNT = 1440
ASK_EVERY = 1.0
"""[m] driven between two questions."""
LOOK_EVERY = 0.25
"""[m] driven between two sweeps."""
OTHER_GRAPHS = 4
"""Other graphs that are searched before there is no place left."""
SAME_VIEW = 0.75
"""[m] A place so near to the one that was looked from shows no more."""
SAME_FRONTIER = 0.5
"""[m] A frontier so near to the one driven to is that one."""
LONGEST_WAY = 100.0
"""[m] of way for each metre of the site's side, after which it is given up."""
SEEN_SHARES = (0.5, 0.8, 0.9, 0.95, 0.97)


class Walk:
    """A robot on a site."""

    def __init__(self, scene: Scene, *, plain: bool) -> None:
        """`plain`: the nearest frontier first, kept until it is seen or come to, and no order of places."""
        self.truth = scene
        self.seen: NDArray[np.bool_] = np.zeros(scene.height.shape, np.bool_)
        self.place = scene.start[:2]
        self.way = 0.0
        self._plain = plain
        self._sigma = BodyModel().weight_native
        self._shown: list[tuple[int, int, int, int]] = []
        rows, cols = scene.height.shape
        x, y = np.arange(cols) * scene.resolution, np.arange(rows)[:, None] * scene.resolution
        self.seen[
            np.hypot(x + scene.origin[0] - self.place[0], y + scene.origin[1] - self.place[1]) < 0.8
        ] = True
        self.look()
        self.graph = TraversalGraph.build(self.grid(), self.place, GraphParams())
        self.aim = truth_reachable(scene)

    def grid(self) -> ElevationGrid:
        """What was seen."""
        height = np.where(self.seen, self.truth.height, np.float32(np.nan))
        return ElevationGrid(fill_unknown(height), self.seen.copy(), self.truth.origin, self.truth.resolution)

    def look(self) -> None:
        """One sweep."""
        res = self.truth.resolution
        c, r = ((self.place[k] - self.truth.origin[k]) / res for k in (0, 1))
        n = math.ceil(SIGHT_RANGE / res) + 1
        rows, cols = self.truth.height.shape
        sweep(self.truth.height, self.seen, c, r, res)
        self._shown.append(
            (max(0, int(r) - n), max(0, int(c) - n), min(rows, int(r) + n), min(cols, int(c) + n))
        )

    @property
    def share(self) -> float:
        """Of the ground that the robot could come to, what was seen."""
        return float((self.seen & self.aim).sum() / self.aim.sum())

    def update(self) -> ElevationGrid:
        """The graph follows what was seen."""
        grid = self.grid()
        self.graph.update(grid, self._shown, self.place)
        self._shown = []
        return grid

    def explore(self) -> dict[str, Any]:
        """Until no place is left, then home; metres at each of `SEEN_SHARES` (NaN: never), in all, and the shares at
        the end."""
        barred: list[tuple[float, float]] = []
        target: tuple[float, float] | None = None
        record: dict[str, Any] = {f"at_{share}": math.nan for share in SEEN_SHARES}
        limit = LONGEST_WAY * max(self.truth.height.shape) * self.truth.resolution
        looked: tuple[float, float] | None = None
        anew = 0
        while self.way < limit:
            grid = self.update()
            if self._plain:
                xy = nearest(self.graph, grid, self.place, target, barred, self._sigma)
            else:
                survey = Survey(
                    self.place, None, self.truth.start[:2], target, np.array(barred).reshape(-1, 2)
                )
                xy = viewpoints(self.graph, grid, survey, self._sigma).xy
            if looked is not None and len(xy) and np.hypot(*(xy - looked).T).min() < SAME_VIEW:
                barred.append(looked)
                looked, target = None, None
                continue
            looked = None
            if not len(xy):
                if (anew := anew + 1) > OTHER_GRAPHS:
                    break
                self.graph = TraversalGraph.build(grid, self.place, GraphParams(), anew)
                continue
            anew = 0
            target = (float(xy[0, 0]), float(xy[0, 1]))
            if self._drive(target, ASK_EVERY, record):
                looked, target = target, None
        record |= {"explored": self.way, "share": self.share, "left": len(xy)}
        record["home"] = self._drive(self.truth.start[:2], math.inf, record)
        return record | {"way": self.way}

    def _drive(self, goal: tuple[float, float], most: float, record: dict[str, Any]) -> bool:
        """Along the graph for `most` [m]; whether it arrived."""
        points = path(self.graph, self.place, goal, self._sigma)
        left = most
        for x, y in points:
            while (away := math.dist(self.place, (x, y))) > 1e-9:
                step = min(LOOK_EVERY, away, left)
                if step <= 1e-9:
                    return False
                k = step / away
                self.place = (
                    self.place[0] + k * (x - self.place[0]),
                    self.place[1] + k * (y - self.place[1]),
                )
                self.way += step
                left -= step
                self.look()
                for share in SEEN_SHARES:
                    if math.isnan(record[f"at_{share}"]) and self.share >= share:
                        record[f"at_{share}"] = self.way
        return bool(len(points))


def nearest(
    graph: TraversalGraph,
    grid: ElevationGrid,
    place: tuple[float, float],
    target: tuple[float, float] | None,
    barred: list[tuple[float, float]],
    sigma: float,
) -> NDArray[np.float64]:
    """(1, 2) the frontier [m] that is nearest by its way, or the one that is driven to while it shows anything; (0, 2)
    where none is left."""
    nodes = graph.nodes
    way = graph.ways(graph.costs(sigma), int(np.hypot(*(nodes[:, :2] - place).T).argmin()))
    may = graph.frontier & np.isfinite(way)
    for at in barred:
        may &= np.hypot(*(nodes[:, :2] - at).T) > BARRED_RADIUS
    left = np.flatnonzero(may)
    if len(left):
        shown = Sight.of(graph, grid, None).shown(np.ascontiguousarray(nodes[left]))
        left = left[shown >= LEAST_GAIN]
    if not len(left):
        return np.empty((0, 2))
    if target is not None:
        away = np.hypot(*(nodes[left, :2] - target).T)
        if away.min() <= SAME_FRONTIER:
            return np.asarray(nodes[left[[away.argmin()]], :2])
    return np.asarray(nodes[left[[way[left].argmin()]], :2])


def truth_reachable(scene: Scene) -> NDArray[np.bool_]:
    """(rows, cols) cells around which a robot that knows the whole site could stand."""
    grid = ElevationGrid(scene.height, np.ones(scene.height.shape, np.bool_), scene.origin, scene.resolution)
    graph = TraversalGraph.build(grid, scene.start[:2], GraphParams())
    out = np.zeros(scene.height.shape, np.bool_)
    n = round(0.4 / scene.resolution)
    for x, y, _ in graph.nodes:
        c, r = (round((v - o) / scene.resolution) for v, o in zip((x, y), scene.origin, strict=True))
        out[max(0, r - n) : r + n + 1, max(0, c - n) : c + n + 1] = True
    assert graph.cells is not None
    return out & (graph.cells.flags & 5 == 0)


def path(
    graph: TraversalGraph, start: tuple[float, float], goal: tuple[float, float], sigma: float
) -> list[tuple[float, float]]:
    """Nodes of the cheapest way, and the goal where it is within a step of its node; empty where there is none."""
    nodes = graph.nodes
    edge = np.repeat(np.arange(len(nodes)), np.diff(graph.indptr))
    cost = graph.costs(sigma)
    begin, end = (int(np.hypot(*(nodes[:, :2] - p).T).argmin()) for p in (start, goal))
    way = graph.ways(cost, begin)
    if not np.isfinite(way[end]):
        return []
    back: list[int] = [end]
    by_target = np.argsort(graph.indices, kind="stable")
    starts = np.searchsorted(graph.indices[by_target], np.arange(len(nodes) + 1))
    while back[-1] != begin:
        into = by_target[starts[back[-1]] : starts[back[-1] + 1]]
        back.append(int(edge[into[(way[edge[into]] + cost[into]).argmin()]]))
    return [(float(nodes[k, 0]), float(nodes[k, 1])) for k in back[::-1]]


@njit(cache=True)
def sweep(height, seen, c, r, res):
    """Mark the cells in sight from column `c`, row `r`: along each ray what rises above all before it."""
    rows, cols = height.shape
    eye = height[int(r), int(c)] + EYE_HEIGHT
    for a in range(RAY_COUNT):
        dx, dy = math.cos(2.0 * math.pi * a / RAY_COUNT), math.sin(2.0 * math.pi * a / RAY_COUNT)
        best = -np.inf
        for s in range(1, int(SIGHT_RANGE / res) + 1):
            i, j = int(c + s * dx + 0.5), int(r + s * dy + 0.5)
            if i < 0 or j < 0 or i >= cols or j >= rows:
                break
            slope = (height[j, i] - eye) / (s * res)
            if slope >= best:
                best = slope
                seen[j, i] = True
