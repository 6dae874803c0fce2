"""How far a path may be driven by now: forward as long as the wheels roll on ground that was seen, or where they feel
edges, backward as long as the guard lets it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hal.safety.planned import known_behind
from hal.safety.swept import Body
from mapping.grid import ElevationGrid
from planning.graph.edges import SECTION_LENGTH
from planning.graph.flags import ASSUMED, PLANTS, VIRTUAL
from planning.graph.graph import TraversalGraph
from planning.graph.params import GraphParams
from planning.path.types import Path
from planning.search.attach import STAND_MARGIN
from planning.search.guarded import drives_over, known_around

WHEEL_LEAD = -0.06
"""From this beyond their axle [m] to their radius beyond it the wheels that lead touch the ground."""
LEAST_LENGTH, LOOKING_TURN = 0.06, 1.0
"""A part of a path that is shorter [m] leads nowhere, unless the robot turns that much [rad] first: its head sees to
both sides."""
HIDDEN_AHEAD, HIDDEN_RADIUS = 0.10, 0.25
"""[m] from the front of the body to what it cannot see, and around that."""
BACK_SPARE = 0.12
"""[m] A path backward ends where less is left to what nobody saw: the guard creeps before it and holds."""
UNSEEN_SPEED = 0.2
"""[m/s] where a part of the ground under the leading wheels was not seen, or of that under the body is under leaves: a
post in grass is felt by the body first."""
TURN_SPACING = 0.05
"""[rad] between places that are looked at."""
TURN_DRIFT = 0.07
"""[m] ahead and aside by which a wheel may come farther out while the robot turns on the spot: it drifted by 0.08 m
beside a pit that nobody saw, and fell."""
BEND_BEGINS = 0.3
"""[rad] A robot whose heading is off by less begins with a bend: the tracker turns from 0.35 on."""


def confirmed(
    path: Path, graph: TraversalGraph, grid: ElevationGrid, width: float, coverage: float | None = None
) -> Path:
    """The part of `path` that ends before less than `coverage`, by default `GraphParams.min_coverage`, of the ground
    under the leading wheels of a body `width` [m] wide was seen; all of it where it may be driven. Virtual ground is
    planned over, not driven on, and the part that is left of it under the wheels is driven slowly. Backward it ends
    before ground that the map does not know: no LiDAR looks there, and the guard holds the robot
    (`hal.safety.planned`).
    """
    if graph.cells is None or len(path.points) < 2:
        return path
    path = _slow_in_leaves(path, graph)
    if grid.trusted.all():
        return path
    sign = _sign(path)
    share = _hidden_share(path, sign, graph, width)
    blocked = share > 1.0 - (graph.params.min_coverage if coverage is None else coverage)
    first = int(np.argmax(blocked)) if blocked.any() else len(blocked)
    every = max(1, round(SECTION_LENGTH / path.limits.spacing))
    for k in np.flatnonzero(sign[:first] < 0.0)[::every]:
        if _behind(grid, path, int(k), graph.params) < BACK_SPARE:
            blocked[k] = True
            break
    path = path.slowed(share > 0.0, UNSEEN_SPEED)
    return path.until(int(np.argmax(blocked)) - 1) if blocked.any() else path


def _slow_in_leaves(path: Path, graph: TraversalGraph) -> Path:
    """The path, driven at `UNSEEN_SPEED` where a part of the body is over grass, or half a body before it."""
    cells = graph.cells
    assert cells is not None
    leaves = cells.flags & PLANTS > 0
    if not leaves.any():
        return path
    length, width = graph.params.length, graph.params.width
    reach = 0.5 * length + SECTION_LENGTH
    along = np.linspace(-reach, reach, round(2.0 * reach / SECTION_LENGTH) + 1)
    across = np.linspace(-width / 2, width / 2, round(width / SECTION_LENGTH) + 1)
    u, v = (a.ravel() for a in np.meshgrid(along, across))
    c, s = np.cos(path.yaw)[:, None], np.sin(path.yaw)[:, None]
    x, y = path.points[:, :1] + u * c - v * s, path.points[:, 1:2] + u * s + v * c
    share = at_places(leaves, x, y, cells.origin, cells.res).mean(axis=1)
    return path.slowed(share > 0.0, UNSEEN_SPEED)


def _sign(path: Path) -> NDArray[np.float64]:
    """(n,) 1.0 where the path is driven forward, -1.0 backward."""
    chord = np.diff(path.points[:, :2], axis=0)
    chord = np.vstack([chord, chord[-1:]])
    return np.where(np.cos(path.yaw - np.arctan2(chord[:, 1], chord[:, 0])) < 0.0, -1.0, 1.0)


def _hidden_share(
    path: Path, sign: NDArray[np.float64], graph: TraversalGraph, width: float
) -> NDArray[np.float64]:
    """(n,) how much of the ground under the leading wheels is virtual; what the robot stands on at the begin is not."""
    p = graph.params
    along = np.arange(p.axle + WHEEL_LEAD, p.axle + p.radius + 1e-9, SECTION_LENGTH)
    across = np.linspace(-width / 2, width / 2, round(width / SECTION_LENGTH) + 1)
    u, v = (a.ravel() for a in np.meshgrid(along, across))
    c, s = np.cos(path.yaw)[:, None], np.sin(path.yaw)[:, None]
    x = path.points[:, :1] + sign[:, None] * u * c - v * s
    y = path.points[:, 1:2] + sign[:, None] * u * s + v * c
    return _hidden(path, float(path.yaw[0]), x, y, graph, width).mean(axis=1)


def _hidden(
    path: Path,
    yaw: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    graph: TraversalGraph,
    width: float,
) -> NDArray[np.bool_]:
    """Whether the ground at places [m] is virtual and not under the wheels of a robot that looks at `yaw` [rad] at the
    begin of the path. What lies under its nose counts."""
    cells = graph.cells
    assert cells is not None
    virtual = (cells.flags & (VIRTUAL | ASSUMED)) == VIRTUAL
    c, s = math.cos(yaw), math.sin(yaw)
    dx, dy = x - path.points[0, 0], y - path.points[0, 1]
    under = (np.abs(c * dx + s * dy) <= graph.params.axle + STAND_MARGIN) & (
        np.abs(c * dy - s * dx) <= width / 2 + STAND_MARGIN
    )
    return at_places(virtual, x, y, cells.origin, cells.res) & ~under


def _behind(grid: ElevationGrid, path: Path, k: int, params: GraphParams) -> float:
    """[m] behind the body at point `k` of the path up to ground that the map does not know, as far as `BACK_SPARE`."""
    x, y, _ = path.points[k].tolist()
    around = known_around(grid, (x, y), params.length + params.max_gap)
    body = Body.of(drives_over(params))
    return known_behind(around, (x, y, float(path.yaw[k])), body, params.max_gap, BACK_SPARE)


def backs_up(path: Path) -> bool:
    """Whether a path begins backward."""
    return len(path.back) > 0 and bool(path.back[0])


def drivable(
    path: Path, graph: TraversalGraph, grid: ElevationGrid, width: float, *, crept: bool = False
) -> Path | None:
    """As `confirmed`; None where hardly anything is left. A robot that turns first looks there, and may begin. One that
    `crept` may stand at an edge that nobody saw: no part of the ground under its wheels may be unseen, nor where it
    turns them to."""
    if crept and _turns_onto_hidden(path, graph, width):
        return None
    part = confirmed(path, graph, grid, width, 1.0 if crept else None)
    if part.length >= min(LEAST_LENGTH, path.length):
        return part
    return None if abs(path.initial_turn or 0.0) < LOOKING_TURN else path.until(1)


def creeping(path: Path, graph: TraversalGraph, width: float, creep: float) -> Path | None:
    """The first half of a body length of a path that is driven forward at `creep` [m/s], whether its ground was seen or
    not; None where hardly any is left of what so slow a robot passes, and where it would turn its wheels onto ground
    that nobody saw: only wheels that roll feel edges."""
    if graph.cells is None or len(path.points) < 2:
        return None
    end = (_sign(path) < 0.0) | (path.least > creep) | (path.s > 0.5 * graph.params.length)
    if _turns_onto_hidden(path, graph, width):
        return None
    last = int(np.argmax(end)) - 1 if end.any() else len(end) - 1
    if path.s[max(last, 0)] < min(LEAST_LENGTH, path.length):
        return None
    return path.until(last).slowed(np.ones(last + 1, np.bool_), creep)


def _turns_onto_hidden(path: Path, graph: TraversalGraph, width: float) -> bool:
    """Whether the turn on the spot before a path may lead a wheel onto virtual ground."""
    turn = path.initial_turn or 0.0
    if graph.cells is None or abs(turn) < BEND_BEGINS:
        return False
    angles = path.yaw[0] - np.linspace(turn, 0.0, math.ceil(abs(turn) / TURN_SPACING) + 1)[:, None]
    p = graph.params
    axle, tread, wheel = (
        p.axle + TURN_DRIFT,
        p.tread + TURN_DRIFT,
        (-p.tread_width / 2, 0.0, p.tread_width / 2),
    )
    u, v = (a.ravel() for a in np.meshgrid((-axle, axle), np.add.outer((-tread, tread), wheel).ravel()))
    x = path.points[0, 0] + u * np.cos(angles) - v * np.sin(angles)
    y = path.points[0, 1] + u * np.sin(angles) + v * np.cos(angles)
    return bool(_hidden(path, float(path.yaw[0]) - turn, x, y, graph, width).any())


def ahead_of(path: Path, length: float) -> tuple[float, float, float]:
    """x, y, radius [m] of a disc on the way ahead of a robot so long [m] at its begin, for others to keep off."""
    k = min(int(np.searchsorted(path.s, 0.5 * length + HIDDEN_AHEAD)), len(path.points) - 1)
    return float(path.points[k, 0]), float(path.points[k, 1]), HIDDEN_RADIUS


def is_hidden(graph: TraversalGraph, x: float, y: float) -> bool:
    """Whether the ground at x, y [m] is virtual."""
    c = graph.cells
    place = np.array([x]), np.array([y])
    return c is not None and bool(
        at_places((c.flags & (VIRTUAL | ASSUMED)) == VIRTUAL, *place, c.origin, c.res)[0]
    )


def at_places(
    mask: NDArray[np.bool_],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    origin: tuple[float, float],
    resolution: float,
) -> NDArray[np.bool_]:
    """`mask` (rows, cols) at places; False beyond it."""
    col = np.floor((x - origin[0]) / resolution + 0.5).astype(np.int64)
    row = np.floor((y - origin[1]) / resolution + 0.5).astype(np.int64)
    rows, cols = mask.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    return inside & mask[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)]
