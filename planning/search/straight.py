"""A searched route made straight where that costs no more: the graph's nodes are samples, and on open ground edges
zigzag between them.

Points of a stretch are moved onto its chord, evenly spaced, so that each piece is tested and priced like an edge of the
graph. A chord is taken where every piece can be driven, the turns at its ends have room, the accumulated transition
cost is not higher, and no feature of the body is worse than the route has it anywhere, but for the noise of one cell.
"""

from __future__ import annotations

import math

import numpy as np

from planning.graph.describe import turn_is_free
from planning.risk.body import weights_of
from planning.risk.pose_sets import turn_angle
from planning.risk.table import RiskTable
from planning.risk.turns import BEND_ANGLE
from planning.search.attach import Ground, there
from planning.search.explain import Route
from planning.search.guarded import TURN_SPARE

LONGEST_CHORD = 16
"""Edges of a route that one chord may replace: about 7 m."""
CHORD_SLACK = 0.02
"""Share of a feature's scale by which a chord, or a rounded corner, may exceed the route: the height noise of one
cell."""
MOST_PASSES = 2


def straighten(ground: Ground, table: RiskTable, route: Route) -> None:
    """Move inner points of `route` onto chords, longest first, until nothing changes (at most `MOST_PASSES` times)."""
    w, n = weights_of(table.body), len(route.xy)
    if n < 3:
        return
    most = _peaks(route.moments) + CHORD_SLACK * np.array(table.body.scales[:3])
    cost = route.cost(w)
    for _ in range(MOST_PASSES):
        changed, i = False, 0
        while i < n - 2:
            span = _longest(ground, table, route, i, cost, most)
            changed |= span >= 2
            i += max(span, 1)
        if not changed:
            return


def _longest(
    ground: Ground, table: RiskTable, route: Route, i: int, cost: np.ndarray, most: np.ndarray
) -> int:
    """Take the longest chord from point i, and bring `cost` up to date: how many edges it replaces, less than two:
    there is none."""
    same = np.flatnonzero(route.back[i:] != route.back[i])
    span = min(int(same[0]) if len(same) else len(route.risk) - i, LONGEST_CHORD)
    while span >= 2 and not _chord(ground, table, route, i, i + span, cost, most):
        span = span * 2 // 3
    return span


def _chord(
    ground: Ground,
    table: RiskTable,
    route: Route,
    i: int,
    j: int,
    cost: np.ndarray,
    most: np.ndarray,
) -> bool:
    """Move points i + 1..j - 1 onto the straight line from i to j and bring `cost` (n - 1,) up to date; False and as
    before where that is no gain."""
    w, last = weights_of(table.body), min(j + 1, len(route.xy) - 1)
    points = np.linspace(route.xy[i], route.xy[j], j - i + 1)
    if np.abs(points - route.xy[i : j + 1]).max() < 1e-6:
        return False
    if not ground.may_join(points):
        return False
    moves = ground.moves(points)
    if moves[-1, 0] < 0.0:
        return False
    inner = slice(i + 1, j)
    before = (
        route.xy[i : j + 1].copy(),
        route.risk[i:j].copy(),
        route.price[i:j].copy(),
        route.moments[i:last].copy(),
    )
    route.xy[i : j + 1] = points
    route.risk[i:j], route.price[i:j] = moves[:, 0], there(moves, route.back[i:j])
    if has_room(ground, route, i) and has_room(ground, route, j):
        route.evaluate(table.sampler, w, i, last)
        new = route.cost(w, i, last)
        if new.sum() < cost[i:last].sum() and (_peaks(route.moments[i:last]) <= most).all():
            cost[i:last] = new
            # nothing turns there now, but a later chord may
            route.turn_price[inner] = ground.turn_prices(points[1:-1])
            return True
    route.xy[i : j + 1], route.risk[i:j], route.price[i:j], route.moments[i:last] = before
    return False


def has_room(ground: Ground, route: Route, k: int) -> bool:
    """Whether there is room for the turn at point k of the route."""
    yaw, turn = turn_at(route, k)
    if turn == 0.0:
        return True
    (room,) = ground.headings(route.xy[k : k + 1])
    if not turn_is_free(room, yaw, turn):
        return False
    return not route.rules.guarded or free_at(ground, route, k) >= abs(turn)


def free_at(ground: Ground, route: Route, k: int) -> float:
    """How far [rad] the guard lets the body turn at point k of the route. Where the robot stands already it needs
    nothing to spare: else it turned back in the middle of a turn. What is driven as a bend is no turn on the spot.
    """
    yaw, turn = turn_at(route, k)
    if abs(turn) <= BEND_ANGLE:
        return abs(turn)
    x, y = route.xy[k].tolist()
    return ground.guarded_turn((x, y), yaw, turn, TURN_SPARE if k else 0.0)


def turn_at(route: Route, k: int) -> tuple[float, float]:
    """Heading [rad] at which the body comes to point k of the route, and how far [rad] it turns there; 0 where any
    heading will do."""
    before, after = route.yaws(k, k).tolist()
    return before, 0.0 if math.isnan(before + after) else float(turn_angle(before, after))


def _peaks(moments: np.ndarray) -> np.ndarray:
    """(3,) largest core features of pose sets."""
    return np.nanmax(moments[:, :, 2, :3], axis=(0, 1))
