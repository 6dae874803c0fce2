"""The chance that a route fails, as the prices of the search have it: what its controller was measured to do, at each
face, slope, turn, gap and field of posts on the way.

A price is `fall_cost` metres for each hazard, -ln(1 - p) (`planning.graph.prices`), so what a route costs beyond eq. 5
tells how likely it fails. Ground that nobody saw has no hazard.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.rotation import wrap
from mapping.grid import ElevationGrid
from planning.graph.describe import turn_ground, turn_price
from planning.graph.edge_price import crossed_by, edge_price, is_met, room_for, slopes
from planning.graph.graph import TraversalGraph
from planning.graph.prices import hazards_of, size_at
from planning.risk.turns import turn_cost

Array = NDArray[np.float64]

LEAST_TOLD = 0.001
"""What fails more seldom is no place to tell of."""


@dataclass(frozen=True, slots=True)
class Chance:
    """How likely a route fails."""

    p_fail: float
    each: tuple[float, ...]
    """Of each transition with its turns."""
    worst: str
    """What is most likely to fail, and where; empty where nothing is."""


def chance(
    graph: TraversalGraph,
    grid: ElevationGrid,
    xy: Array,
    back: NDArray[np.bool_],
    start_yaw: float = math.nan,
    goal_yaw: float = math.nan,
) -> Chance | None:
    """How likely a way over the points xy (n, 2) [m], `map`, fails; `back` (n - 1,): what is driven backward; yaws in
    rad, NaN = any. None on a graph that does not know its map, or not what the controller was measured to do."""
    if graph.cells is None or graph.params.controller is None:
        return None
    way = _Way(graph, grid, xy, back)
    moves = np.array([way.move(k) for k in range(len(back))])
    leg = np.diff(xy, axis=0)
    yaw = np.arctan2(leg[:, 1], leg[:, 0]) + np.pi * back
    turned = np.nan_to_num(wrap(np.diff([start_yaw, *yaw, goal_yaw])))
    turns = np.array([way.turn(k, by) for k, by in enumerate(turned.tolist())])
    each = moves + turns[:-1]
    each[-1:] += turns[-1]
    worst = ""
    if len(each) and max(moves.max(), turns.max()) > LEAST_TOLD:
        k, at = int(moves.argmax()), int(turns.argmax())
        worst = way.worst_of_move(k) if moves[k] >= turns[at] else way.worst_of_turn(at, float(turned[at]))
    return Chance(-math.expm1(-each.sum()), tuple((-np.expm1(-each)).tolist()), worst)


class _Way:
    """The hazards of one way over one map."""

    def __init__(
        self, graph: TraversalGraph, grid: ElevationGrid, xy: Array, back: NDArray[np.bool_]
    ) -> None:
        assert graph.cells is not None
        self._table = hazards_of(graph.params)
        self._climbed = graph.params.climbed
        self._xy, self._back = xy, back
        frame = *grid.origin, grid.resolution
        self._ground = grid.height, graph.cells.flags, graph.cells.faces, *frame
        self._turned = grid.height, grid.trusted, graph.cells.faces, *frame

    def move(self, k: int) -> float:
        """Hazard of move k."""
        (xa, ya), (xb, yb), out = self._xy[k].tolist(), self._xy[k + 1].tolist(), np.empty((2, 2), np.float32)
        if (xa, ya) == (xb, yb):
            return 0.0
        edge_price(*self._ground, self._table, xa, ya, xb, yb, out)
        return float(out[0, int(self._back[k])])

    def turn(self, k: int, by: float) -> float:
        """Hazard of a turn at point k by so much [rad]."""
        if by == 0.0:
            return 0.0
        x, y = self._xy[k].tolist()
        bend, spin = turn_price(*self._turned, x, y, self._table, self._climbed)
        return turn_cost(bend, spin, by, 0.0)

    def worst_of_turn(self, k: int, by: float) -> str:
        """What makes a turn dear, and where."""
        x, y = self._xy[k].tolist()
        face, slope = turn_ground(*self._turned, x, y, self._table.axle, self._climbed)
        bend, spin = self._table.turn[:, size_at(face), 0].tolist()
        level = turn_cost(bend, spin, by, 0.0)
        on = (
            f"over a {face:.2f} m face"
            if level > 0.5 * self.turn(k, by)
            else f"on a slope of {_degrees(slope)}"
        )
        return f"a turn of {abs(math.degrees(by)):.0f} deg {on} at x {x:.1f} y {y:.1f}"

    def worst_of_move(self, k: int) -> str:
        """What makes a move dear, and where: of faces, stairs, gaps, posts and slopes, those that add most to it."""
        (xa, ya), (xb, yb), back = self._xy[k].tolist(), self._xy[k + 1].tolist(), int(self._back[k])
        d = math.hypot(xb - xa, yb - ya)
        ux, uy = (xb - xa) / d, (yb - ya) / d
        table = self._table
        found: dict[str, list[tuple[float, str]]] = defaultdict(list)
        """By kind the hazard of each one, and its words."""

        def add(kind: str, hazard: float, told: str, x: float, y: float) -> None:
            found[kind].append((hazard, f"{told} at x {x:.1f} y {y:.1f}"))

        crossed, gaps = np.empty((room_for(d), 4)), np.empty((room_for(d), 2))
        for wheel in range(4):
            xw, yw, faces, holes, share, posts = crossed_by(
                *self._ground, table, wheel, xa, ya, ux, uy, d, crossed, gaps
            )
            for at, size, angle, tread in crossed[:faces].tolist():
                if not is_met(at, d, 0, back * table.radius):
                    continue
                stairs = tread > 0.0 and not back
                told = f"{'up' if size > 0.0 else 'down'} {'stairs of' if stairs else 'a'} {abs(size):.2f} m"
                told += "" if stairs else " face" + " backward" * back
                told += f" at {math.degrees(angle):.0f} deg to its normal" * (angle > math.radians(20.0))
                hazard = table.of_face(size, angle, tread, bool(back))
                add("stairs" if stairs else "face", hazard, told, xw + at * ux, yw + at * uy)
            for at, width in gaps[:holes].tolist():
                hazard = float(table.gap[size_at(width)])
                add("gap", hazard, f"over a {width:.2f} m gap", xw + at * ux, yw + at * uy)
            hazard = 0.25 * float(table.posts[size_at(posts)]) * d * share
            add("posts", hazard, f"among posts of {posts:.2f} m", xa + 0.5 * d * ux, ya + 0.5 * d * uy)
        out = np.zeros((2, 2), np.float32)
        along, steep, direction = slopes(*self._ground, table, xa, ya, ux, uy, d, out)
        way = abs(math.degrees(direction) - 180.0 * back)
        word = "up" if way < 45.0 else "down" if way > 135.0 else "along"
        told = f"{word} a slope of {_degrees(steep)}"
        add("slope", float(out[0, back]), told, xa + along * ux, ya + along * uy)
        return max(max(found.values(), key=lambda parts: sum(hazard for hazard, _ in parts)))[1]


def _degrees(slope: float) -> str:
    return f"{math.degrees(math.atan(slope)):.0f} deg"
