"""Mazes and a robot that explores them with a simulated range sensor, on the grid alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mapping.grid import ElevationGrid
from planning.errors import NoRoute
from planning.graph.graph import TraversalGraph
from planning.path import make_path, still_safe
from planning.risk.body import BodyModel
from planning.search.frontier import Tried
from planning.search.plan import PlanRequest, plan

WALL = 0.12
"""Thickness of a maze's walls [m]."""


@dataclass
class World:
    """The truth the sensor looks at."""

    height: np.ndarray
    res: float
    start: tuple[float, float]
    goal: tuple[float, float]
    wall: np.ndarray
    """(rows, cols) bool, what stops a ray."""


def maze(
    seed: int, rooms: int, pitch: float, loops: float = 0.1, res: float = 0.05, closed: bool = False
) -> World:
    """`rooms` x `rooms` rooms joined by a random tree, of whose walls a share `loops` is opened again.

    The goal is the room with the longest way to it; `closed` walls it in.
    """
    rng = np.random.default_rng(seed)
    doors: set[tuple[int, int]] = set()

    def beside(a: int) -> list[int]:
        i, j = divmod(a, rooms)
        return [
            b * rooms + c
            for b, c in ((i + 1, j), (i, j + 1), (i - 1, j), (i, j - 1))
            if 0 <= b < rooms and 0 <= c < rooms
        ]

    visited, stack = {0}, [0]
    while stack:
        fresh = [b for b in beside(stack[-1]) if b not in visited]
        if not fresh:
            stack.pop()
            continue
        b = fresh[int(rng.integers(len(fresh)))]
        doors.add((min(stack[-1], b), max(stack[-1], b)))
        visited.add(b)
        stack.append(b)
    pairs = [(a, b) for a in range(rooms**2) for b in beside(a) if a < b]
    doors |= {p for p in pairs if rng.random() < loops}
    steps = {0: 0}
    queue = [0]
    for a in queue:
        for b in beside(a):
            if b not in steps and (min(a, b), max(a, b)) in doors:
                steps[b] = steps[a] + 1
                queue.append(b)
    end = max(steps, key=lambda a: (steps[a], a))
    if closed:
        doors -= {p for p in doors if end in p}
    n = round((rooms * pitch + WALL) / res)
    y, x = np.mgrid[0:n, 0:n] * res
    wall = np.zeros((n, n), bool)
    side = rooms * pitch
    for lines in (x, y):
        wall |= (lines < WALL) | (lines > side)
    for a, b in pairs:
        if (a, b) in doors:
            continue
        (i, j), (k, m) = divmod(a, rooms), divmod(b, rooms)
        if i != k:  # i counts along x
            wall |= (
                (np.abs(x - k * pitch - 0.5 * WALL) <= 0.5 * WALL)
                & (y >= j * pitch)
                & (y <= (j + 1) * pitch + WALL)
            )
        else:
            wall |= (
                (np.abs(y - m * pitch - 0.5 * WALL) <= 0.5 * WALL)
                & (x >= i * pitch)
                & (x <= (i + 1) * pitch + WALL)
            )
    height = (0.01 * rng.standard_normal((n, n)) + wall).astype(np.float32)

    def centre(a: int) -> tuple[float, float]:
        i, j = divmod(a, rooms)
        return (i + 0.5) * pitch + 0.5 * WALL, (j + 0.5) * pitch + 0.5 * WALL

    return World(height, res, centre(0), centre(end), wall)


def look(world: World, xy: tuple[float, float], blind: float = 0.0) -> np.ndarray:
    """(rows, cols) bool: cells a range sensor at x, y sees up to 6 m, walls included.

    A LiDAR whose lowest ray meets the ground `blind` [m] away sees no ground before a wall nearer than that; what lies
    between the robot and its lowest ring on open ground the map bridges.
    """
    rays = np.linspace(0.0, 2.0 * np.pi, 900, endpoint=False)
    r = np.arange(0.0, 6.0, 0.5 * world.res)
    col = np.floor((xy[0] + np.cos(rays)[:, None] * r) / world.res + 0.5).astype(int)
    row = np.floor((xy[1] + np.sin(rays)[:, None] * r) / world.res + 0.5).astype(int)
    n, m = world.wall.shape
    inside = (row >= 0) & (col >= 0) & (row < n) & (col < m)
    row, col = np.clip(row, 0, n - 1), np.clip(col, 0, m - 1)
    hit = world.wall[row, col]
    # a ray sees a little of the wall that stops it, and nothing behind
    depth = np.cumsum(hit, axis=1)
    seen = inside & (depth <= 2) & ~(~hit & (depth > 0))
    stopped = np.where(hit.any(axis=1), r[np.argmax(hit, axis=1)], np.inf)
    seen &= hit | (stopped >= blind)[:, None]
    y, x = np.mgrid[0:n, 0:m] * world.res
    out = (np.hypot(x - xy[0], y - xy[1]) < 0.4) & ~world.wall  # what the robot stands on it knows
    out[row[seen], col[seen]] = True
    return out


@dataclass
class Run:
    """How an exploration went."""

    end: str = "gave up"
    """`reached`, the reason of the refusal, or `gave up`."""
    driven: float = 0.0
    """[m]"""
    track: list[tuple[float, float]] = field(default_factory=list)
    """Places it looked from."""
    frontiers: list[tuple[float, float]] = field(default_factory=list)
    """The frontier of each plan that ended at one."""
    seen: np.ndarray | None = None
    """(rows, cols) bool, what it knew at the end."""


def around(cells: np.ndarray) -> list[tuple[int, int, int, int]]:
    """The window around marked cells (rows, cols) as `TraversalGraph.update` takes it; none where none is marked."""
    rows, cols = np.nonzero(cells)
    return [(int(rows.min()), int(cols.min()), int(rows.max()) + 1, int(cols.max()) + 1)] if len(rows) else []


def explore(world: World, blind: float = 0.0, every: float = 1.2, limit: float = 150.0) -> Run:
    """Drive to the goal as the stack does: look every 0.3 m, plan anew every `every` metres and at each path's end."""
    body = BodyModel()
    seen = look(world, world.start, blind)
    run = Run(track=[world.start], seen=seen)

    def grid() -> ElevationGrid:
        height = np.where(seen, world.height, np.nan).astype(np.float32)
        return ElevationGrid(height, seen, (0.0, 0.0), world.res)

    xy, yaw = world.start, None
    graph = TraversalGraph.build(grid(), xy)
    tried = Tried()
    while run.driven < limit:
        tried.at(xy, grid())
        ask = PlanRequest(
            xy,
            world.goal,
            yaw,
            allow_frontier=True,
            previous_frontier=tried.chosen,
            tried=tuple(tried.places),
        )
        try:
            found = plan(graph, grid(), ask, body)
        except NoRoute as none:
            run.end = none.reason.value
            break
        tried.found(found.frontier, found.length, 0.0, grid())
        if found.frontier is not None:
            run.frontiers.append(found.frontier)
        path = make_path(found, grid(), body)
        stop = path.length if found.reaches_goal else min(path.length, every)
        at = 0.0
        while at < stop - 1e-6:
            at = min(at + 0.3, stop)
            k = min(int(np.searchsorted(path.s, at - 1e-9)), len(path.s) - 1)
            xy, yaw = (float(path.points[k, 0]), float(path.points[k, 1])), float(path.yaw[k])
            run.track.append(xy)
            fresh = look(world, xy, blind) & ~seen
            seen |= fresh
            graph.update(grid(), around(fresh), xy)
            if not still_safe(path, graph, grid(), body)[0]:
                break
        run.driven += max(at, 0.01)
        if found.reaches_goal and math.dist(xy, world.goal) < 0.3:
            run.end = "reached"
            break
    return run


def shortest(world: World) -> float:
    """Length [m] of the route planned on the full map."""
    grid = ElevationGrid(world.height, np.ones(world.wall.shape, bool), (0.0, 0.0), world.res)
    graph = TraversalGraph.build(grid, world.start)
    body = BodyModel()
    return make_path(plan(graph, grid, PlanRequest(world.start, world.goal), body), grid, body).length


def rooms_of(world: World) -> np.ndarray:
    """(rows, cols) bool: free cells connected to the start's."""
    out = np.zeros(world.wall.shape, bool)
    stack = [(round(world.start[1] / world.res), round(world.start[0] / world.res))]
    while stack:
        r, c = stack.pop()
        if not world.wall[r, c] and not out[r, c]:
            out[r, c] = True
            stack += [(r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)]
    return out
