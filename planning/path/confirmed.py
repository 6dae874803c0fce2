"""How far a path may be driven by now: forward as long as the wheels roll on ground that was seen, backward as long as the guard lets it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.go2w import BODY_LENGTH, BODY_WIDTH
from hal.safety.planned import known_behind
from mapping.grid import ElevationGrid
from planning.graph.flags import ASSUMED, PLANTS, VIRTUAL
from planning.graph.graph import TraversalGraph
from planning.path.types import Path
from planning.search.guarded import known_around

LEAD = (0.15, 0.30)
"""Between these distances ahead of base_link [m] the wheels that lead touch the ground: their axles lie 0.21 m off it."""
SPACING = 0.04
LEAST, TURN = 0.06, 1.0
"""A part of a path that is shorter [m] leads nowhere, unless the robot turns that much [rad] first: its head sees to both sides."""
AHEAD, ROUND = 0.45, 0.25
"""[m] from the robot to what it cannot see, and around that."""
BACK, BACK_SPACING = 0.12, 0.04
"""[m] A path backward ends where less than the first is left to what nobody saw: the guard creeps before it and holds. Asked so often."""
UNSEEN = 0.2
"""[m/s] where a part of the ground under the leading wheels was not seen."""
LEAVES = 0.2
"""[m/s] with a part of the body over grass: a post in it is felt by the body first."""
STAND = (0.25, 0.05)
"""[m] ahead of base_link and beside the body that count as seen at the start: its wheels stand there. What lies under its nose does
not."""


def confirmed(path: Path, graph: TraversalGraph, grid: ElevationGrid, width: float) -> Path:
    """The part of `path` that ends before less than `GraphParams.min_coverage` of the ground under the leading wheels of a body
    `width` [m] wide was seen; all of it where it may be driven. Virtual ground is planned over, not driven on, and the part that is left of it under
    the wheels is driven slowly.
    Backward it ends before ground that the map does not know: no LiDAR looks there, and the guard holds the robot (`hal.safety.planned`).
    """
    cells = graph.cells
    if cells is None or len(path.points) < 2:
        return path
    path = _slow_in_leaves(path, graph)
    virtual = (cells.flags & (VIRTUAL | ASSUMED)) == VIRTUAL
    if grid.trusted.all():
        return path
    chord = np.diff(path.points[:, :2], axis=0)
    chord = np.vstack([chord, chord[-1:]])
    sign = np.where(np.cos(path.yaw - np.arctan2(chord[:, 1], chord[:, 0])) < 0.0, -1.0, 1.0)
    along = np.arange(LEAD[0], LEAD[1] + 1e-9, SPACING)
    across = np.linspace(-width / 2, width / 2, round(width / SPACING) + 1)
    u, v = (a.ravel() for a in np.meshgrid(along, across))
    c, s = np.cos(path.yaw)[:, None], np.sin(path.yaw)[:, None]
    x = path.points[:, :1] + sign[:, None] * u * c - v * s
    y = path.points[:, 1:2] + sign[:, None] * u * s + v * c
    hidden = at_places(virtual, x, y, cells.origin, cells.res)
    c0, s0 = c[0, 0], s[0, 0]
    dx, dy = x - path.points[0, 0], y - path.points[0, 1]
    under = (np.abs(c0 * dx + s0 * dy) <= STAND[0]) & (np.abs(c0 * dy - s0 * dx) <= width / 2 + STAND[1])
    share = (hidden & ~under).mean(axis=1)
    blocked = share > 1.0 - graph.params.min_coverage
    first = int(np.argmax(blocked)) if blocked.any() else len(blocked)
    every = max(1, round(BACK_SPACING / path.limits.spacing))
    for k in np.flatnonzero(sign[:first] < 0.0)[::every]:
        if _behind(grid, path, int(k), graph.params.max_gap) < BACK:
            blocked[k] = True
            break
    path = path.slowed(share > 0.0, UNSEEN)
    return path.until(int(np.argmax(blocked)) - 1) if blocked.any() else path


def _slow_in_leaves(path: Path, graph: TraversalGraph) -> Path:
    """The path, driven at `LEAVES` where a part of the body is over grass, or half a body before it."""
    cells = graph.cells
    assert cells is not None
    leaves = cells.flags & PLANTS > 0
    if not leaves.any():
        return path
    reach = 0.5 * BODY_LENGTH + SPACING
    along = np.linspace(-reach, reach, round(2.0 * reach / SPACING) + 1)
    across = np.linspace(-BODY_WIDTH / 2, BODY_WIDTH / 2, round(BODY_WIDTH / SPACING) + 1)
    u, v = (a.ravel() for a in np.meshgrid(along, across))
    c, s = np.cos(path.yaw)[:, None], np.sin(path.yaw)[:, None]
    x, y = path.points[:, :1] + u * c - v * s, path.points[:, 1:2] + u * s + v * c
    share = at_places(leaves, x, y, cells.origin, cells.res).mean(axis=1)
    return path.slowed(share > 0.0, LEAVES)


def _behind(grid: ElevationGrid, path: Path, k: int, max_gap: float) -> float:
    """[m] behind the body at point `k` of the path up to ground that the map does not know, as far as `BACK`."""
    x, y, _ = path.points[k].tolist()
    around = known_around(grid, (x, y), BODY_LENGTH + max_gap)
    return known_behind(around, (x, y, float(path.yaw[k])), max_gap, BACK)


def backs_up(path: Path) -> bool:
    """Whether a path begins backward."""
    return len(path.back) > 0 and bool(path.back[0])


def drivable(path: Path, graph: TraversalGraph, grid: ElevationGrid, width: float) -> Path | None:
    """As `confirmed`; None where hardly anything is left. A robot that turns first looks there, and may begin."""
    part = confirmed(path, graph, grid, width)
    if part.length >= min(LEAST, path.length):
        return part
    return None if abs(path.initial_turn or 0.0) < TURN else path.until(1)


def ahead_of(path: Path) -> tuple[float, float, float]:
    """x, y, radius [m] of a disc on the way ahead of a robot at its begin, for others to keep off."""
    k = min(int(np.searchsorted(path.s, AHEAD)), len(path.points) - 1)
    return float(path.points[k, 0]), float(path.points[k, 1]), ROUND


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
