"""Start and goal as nodes: real poses, joined to the graph by the test that its own edges passed.

A plan then begins where the robot stands and ends where it was sent, and its first leg, first turn, last leg and last
turn are checked and priced like all others. Only a graph that was built on its map (`TraversalGraph.cells`) can do
that.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.cells import Cells
from planning.graph.describe import free_headings, in_sight, turn_price
from planning.graph.edge_risk import F32, height_near
from planning.graph.edges import CORRIDOR_MARGIN, SECTION_LENGTH, SUM_COLUMNS, move
from planning.graph.flags import FACE, FIELD, HOLE, POSTS, TIP, UNSEEN, VIRTUAL
from planning.graph.graph import TraversalGraph
from planning.graph.lattice import EDGE_REACH
from planning.graph.prices import prices_of
from planning.risk.turns import BEND_ANGLE
from planning.search.guarded import guarded_turn, without

XY = tuple[float, float]
STAND_MARGIN = 0.05
"""Beside the robot's own footprint [m] that counts as free: it stands there, whatever the noise of the map says."""
SAME_PLACE = 0.05
"""A node this near to a place [m] is that place: a move this short has no direction worth turning to."""
ALONG_ANGLE = math.radians(20.0)
"""The robot stands along a move that leads so little aside [rad]."""
DEAR_BEND = 5.0
"""[m/rad] A robot that can bend its way at this price only drives straight on, if there is a way."""
PLACES_AHEAD = (0.5, 1.0, -0.5, -1.0)
"""[body lengths] Places ahead and behind of a start that can hardly turn; they become nodes as well."""
PLACES_ASIDE = (-12.0, -6.0, 0.0, 6.0, 12.0)
"""[deg] from its heading."""
NEAREST_NODES = 8
"""Nodes around a goal that cannot be reached from which the way nearest to it is looked for."""


@dataclass(slots=True)
class Spot:
    """A pose that becomes a node of one query."""

    xy: XY
    nodes: NDArray[np.int64]
    """(k,) the graph's nodes a straight move leads to."""
    moves: NDArray[np.float32]
    """(k, 5) native risk and prices of these moves, see `Ground.moves`."""
    turn_price: NDArray[np.float32]
    """(2,) as of a node."""
    headings: np.uint64
    """`TraversalGraph.free_headings` at the place."""
    from_start: NDArray[np.float32] | None = None
    """(5,) the same of the move from the start of the query; None where none leads here."""


def dear_to_turn(graph: TraversalGraph, grid: ElevationGrid, stand: tuple[float, float, float]) -> bool:
    """Whether a robot at x, y [m], yaw [rad] stands astride something that makes bends dear. Not among the posts of a
    stepfield, where it is always astride one, and at no heading (NaN)."""
    c, p, (x, y, yaw) = graph.cells, graph.params, stand
    if c is None or math.isnan(yaw):
        return False
    col, row = (math.floor((v - o) / c.res + 0.5) for v, o in ((x, c.origin[0]), (y, c.origin[1])))
    if c.flags[row, col] & FIELD:
        return False
    prices = prices_of(p)
    bend, _ = turn_price(grid.height, grid.trusted, c.faces, *c.origin, c.res, x, y, prices, p.climbed)
    return float(bend) >= DEAR_BEND


def there(moves: NDArray[np.float32], back: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n,) prices [m] of `moves` (n, 5) as they are driven, forward or `back` (n,)."""
    return moves[np.arange(len(moves)), 1 + back.astype(np.int64)].astype(np.float64)


def _around(
    cells: Cells, x: float, y: float, reach: float
) -> tuple[slice, slice, NDArray[np.float64], NDArray[np.float64]]:
    """The cells within `reach` [m] of x, y: their rows and columns, and how far off each of them lies along x and y
    [m]."""
    (x0, y0), (rows, cols), res = cells.origin, cells.shape, cells.res
    r0, r1 = max(0, math.floor((y - reach - y0) / res)), min(rows, math.ceil((y + reach - y0) / res) + 1)
    c0, c1 = max(0, math.floor((x - reach - x0) / res)), min(cols, math.ceil((x + reach - x0) / res) + 1)
    dy, dx = np.mgrid[r0:r1, c0:c1] * res
    return slice(r0, r1), slice(c0, c1), dx + x0 - x, dy + y0 - y


class Ground:
    """The graph's flags around one pose, with the ground that the robot stands on counted as free."""

    def __init__(
        self,
        graph: TraversalGraph,
        grid: ElevationGrid,
        stand: tuple[float, float, float] | None = None,
        held: tuple[bool, bool] = (False, False),
    ) -> None:
        """`stand`: x, y [m], yaw [rad] of the robot, NaN where that may be any. `held`: see `PlanRequest`."""
        assert graph.cells is not None
        self._held = held
        self.graph, self._grid = graph, grid
        self._cells: Cells = graph.cells
        self._flags = self._cells.flags
        self.reach = EDGE_REACH * self._cells.side + SAME_PLACE
        rows, cols = grid.shape
        self._xs = (grid.origin[0] + np.arange(cols) * grid.resolution).astype(np.float32)
        self._ys = (grid.origin[1] + np.arange(rows) * grid.resolution).astype(np.float32)
        rank = math.ceil((self.reach + graph.params.length + 2.0 * CORRIDOR_MARGIN) / SECTION_LENGTH) + 2
        self._sums = np.empty((rank, SUM_COLUMNS))
        self._stand = stand
        self._prices = prices_of(graph.params)
        if stand is not None:
            self._flags = self._flags.copy()
            self._free(*stand)

    def _free(self, x: float, y: float, yaw: float) -> None:
        """Clear what lies under the robot at this pose; at any heading (NaN) under its inner circle."""
        p = self.graph.params
        length, width = (p.width, p.width) if math.isnan(yaw) else (p.length, p.width)
        rows, cols, dx, dy = _around(self._cells, x, y, 0.5 * math.hypot(length, width) + 2.0 * STAND_MARGIN)
        c, s = (math.cos(yaw), math.sin(yaw)) if not math.isnan(yaw) else (1.0, 0.0)
        under = (np.abs(dx * c + dy * s) <= 0.5 * length + STAND_MARGIN) & (
            np.abs(dy * c - dx * s) <= 0.5 * width + STAND_MARGIN
        )
        self._flags[rows, cols][under] &= ~np.uint16(FACE | UNSEEN | HOLE | TIP | POSTS | VIRTUAL)

    def _stood(self, a: XY, b: XY) -> bool:
        """Whether the robot stands at a along the move to b, or the other way round."""
        if self._stand is None or a != self._stand[:2]:
            return False
        return abs(math.sin(math.atan2(b[1] - a[1], b[0] - a[0]) - self._stand[2])) < math.sin(ALONG_ANGLE)

    def moves(self, places: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n - 1, 5) of the straight moves between places (n, 2), each at most `reach` from the next: native risk, then
        the prices [m] there driven forward and backward, and back driven forward and backward. Risk is negative where a
        move cannot be driven, and after the first such one."""
        p, c = self.graph.params, self._cells
        ground = (self._grid.height, self._xs, self._ys, self._flags, self._cells.faces, *c.origin, c.res)
        limits = (p.length, p.width, math.tan(p.max_slope), p.max_gap, p.min_coverage, F32(p.robot_size))
        a, b = (tuple(place) for place in places[:2].tolist())
        out: NDArray[np.float32] = _moves(
            *ground, places, *limits, self._prices, self._sums, self._stood(a, b)
        )
        return out

    def headings(self, xy: NDArray[np.float64]) -> NDArray[np.uint64]:
        """(n,) `TraversalGraph.free_headings` at places (n, 2), less those that a turn of the robot from where it
        stands would come to and the guard holds."""
        p, c = self.graph.params, self._cells
        out: NDArray[np.uint64] = _headings(self._flags, *c.origin, c.res, xy, p.length, p.width)
        if any(self._held) and self._stand is not None and not math.isnan(self._stand[2]):
            for k in np.flatnonzero((xy == self._stand[:2]).all(axis=1)):
                for held, turn in zip(self._held, (math.pi / 2.0, -math.pi / 2.0), strict=True):
                    out[k] = without(out[k], self._stand[2], turn, BEND_ANGLE) if held else out[k]
        return out

    def guarded_turn(self, xy: XY, yaw: float, turn: float, spare: float) -> float:
        """How far [rad] the guard lets the body turn there, see `planning.search.guarded`: it counts what lies beside
        the robot."""
        return guarded_turn(self._grid, self.graph.params, xy, yaw, turn, spare)

    def near(self, xy: XY, reach: float) -> NDArray[np.int64]:
        """Nodes within `reach` [m] of x, y that are not at the same place, nearest first."""
        nodes = self.graph.nodes
        some = np.flatnonzero(np.abs(nodes[:, 0] - xy[0]) <= reach)  # of a large map nearly none
        d = np.hypot(nodes[some, 0] - xy[0], nodes[some, 1] - xy[1])
        found = np.flatnonzero((d <= reach) & (d > SAME_PLACE))
        return some[found[np.argsort(d[found], kind="stable")]]

    def spot(self, xy: XY) -> Spot:
        """x, y [m] with all moves to nodes around it; none where there is no way."""
        moves = [(k, self.move(xy, self._at(k))) for k in self.near(xy, self.reach).tolist()]
        known = [(k, m) for k, m in moves if m is not None]
        here = np.array([xy])
        return Spot(
            xy,
            np.array([k for k, _ in known], np.int64),
            np.array([m for _, m in known], np.float32).reshape(-1, 5),
            self.turn_prices(here)[0],
            self.headings(here)[0],
        )

    def ahead(self, xy: XY, yaw: float) -> list[Spot]:
        """Places along the heading of a robot that stands astride a face, or from which no move leads to a node, as
        nodes: with its side at a wall all moves but those along its heading sweep the wall. None at any heading."""
        out: list[Spot] = []
        if math.isnan(yaw):
            return out
        for way in PLACES_AHEAD:
            for aside in PLACES_ASIDE:
                at = yaw + math.radians(aside)
                far = way * self.graph.params.length
                place = (xy[0] + far * math.cos(at), xy[1] + far * math.sin(at))
                move = self.move(xy, place)
                if move is not None:
                    spot = self.spot(place)
                    spot.from_start = move
                    out.append(spot)
        return out

    def turn_prices(self, xy: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n, 2) `TraversalGraph.turn_price` at places (n, 2) [m]."""
        c, grid = self._cells, self._grid
        ground = grid.height, grid.trusted, c.faces, *c.origin, c.res
        out: NDArray[np.float32] = _turn_prices(*ground, xy, self._prices, self.graph.params.climbed)
        return out

    def may_join(self, places: NDArray[np.float64]) -> bool:
        """Whether straight moves between places (n, 2) are neither too short nor too long, and touch nothing that is to
        be avoided."""
        length = np.hypot(*np.diff(places, axis=0).T)
        return bool(((length > SAME_PLACE) & (length <= self.reach)).all()) and self.graph.allows(places)

    def move(self, a: XY, b: XY) -> NDArray[np.float32] | None:
        """(5,) `moves` of the straight move from a to b; None where none may lead there."""
        places = np.array([a, b])
        if not self.may_join(places):
            return None
        move = self.moves(places)[0]
        return None if move[0] < 0.0 else move

    def end_near(self, xy: XY, reach: float) -> XY | None:
        """Where a route to x, y can end: there, or as near as a straight move from a node within `reach` [m] comes.

        None where no node is that near, or something stands between it and x, y.
        """
        if any(self.move(xy, self._at(k)) is not None for k in self.near(xy, self.reach).tolist()):
            return xy
        best: XY | None = None
        nodes = self.near(xy, reach)[:NEAREST_NODES]
        c = self._cells
        seen = in_sight(self._flags, *c.origin, c.res, *xy, self.graph.nodes[nodes, :2], reach)
        for k in nodes[seen].tolist():
            a = self._at(k)
            low, high = 0.0, 1.0
            for _ in range(5):
                t = 0.5 * (low + high)
                low, high = (
                    (t, high) if self.moves(np.array([a, _along(a, xy, t)]))[0, 0] >= 0.0 else (low, t)
                )
            here = _along(a, xy, low)
            if best is None or math.dist(here, xy) < math.dist(best, xy):
                best = here
        return best

    def _at(self, node: int) -> XY:
        x, y = self.graph.nodes[node, :2].tolist()
        return x, y


@njit(cache=True)
def _moves(
    height, xs, ys, flags, faces, x0, y0, res, places, length, width, max_tan, max_gap, min_coverage, radius,
    prices, sums, stood,
):  # fmt: skip
    out = np.full((len(places) - 1, 5), np.float32(-1.0))
    price = np.empty((2, 2), np.float32)
    for k in range(len(out)):
        xa, ya, xb, yb = places[k, 0], places[k, 1], places[k + 1, 0], places[k + 1, 1]
        out[k, 0] = move(
            height, flags, faces, xs, ys, x0, y0, res, xa, ya, xb, yb, length, width, max_tan, max_gap, min_coverage,
            radius, prices, sums, stood and k == 0, price,
        )  # fmt: skip
        if out[k, 0] < 0.0:
            break
        for way in range(2):
            out[k, 1 + 2 * way], out[k, 2 + 2 * way] = price[way, 0], price[way, 1]
    return out


@njit(cache=True)
def _headings(flags, x0, y0, res, places, length, width):
    out = np.empty(len(places), np.uint64)
    for k in range(len(places)):
        out[k] = free_headings(flags, x0, y0, res, places[k, 0], places[k, 1], length, width)
    return out


@njit(cache=True)
def _turn_prices(height, trusted, faces, x0, y0, res, places, prices, climbed):
    out = np.empty((len(places), 2), np.float32)
    for k in range(len(places)):
        x, y = places[k, 0], places[k, 1]
        out[k, 0], out[k, 1] = turn_price(height, trusted, faces, x0, y0, res, x, y, prices, climbed)
    return out


def _along(a: XY, b: XY, t: float) -> XY:
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])


def with_places(graph: TraversalGraph, grid: ElevationGrid, places: list[XY]) -> NDArray[np.float64]:
    """(n + k, 3) x, y, z [m] of the graph's nodes and of k places after them."""
    c = graph.cells
    assert c is not None
    rows = [(*xy, float(height_near(grid.height, *c.origin, c.res, *xy))) for xy in places]
    return np.concatenate([graph.nodes, np.array(rows, np.float64).reshape(-1, 3)])


def attached(
    graph: TraversalGraph, grid: ElevationGrid, places: list[Spot], start: int
) -> tuple[TraversalGraph, NDArray[np.int64]]:
    """The graph of one query: `places` follow the graph's nodes, `start` is the node that `Spot.from_start` tells of.

    -> the graph and (nnz,) where each slot of `graph` went.
    """
    n = len(graph.nodes)
    pairs = [(n + i, int(k), *m) for i, p in enumerate(places) for k, m in zip(p.nodes, p.moves, strict=True)]
    pairs += [(start, n + i, *p.from_start) for i, p in enumerate(places) if p.from_start is not None]
    one = np.array(pairs, np.float64).reshape(-1, 7)
    both = np.concatenate([one[:, :5], one[:, [1, 0, 2, 5, 6]]])
    source, target = both[:, 0].astype(np.int64), both[:, 1].astype(np.int64)
    order = np.lexsort((target, source))
    source, target, cost = source[order], target[order], both[order, 2:].astype(np.float32)
    indptr = np.concatenate([graph.indptr, np.full(len(places), graph.indptr[-1])])
    # New targets are larger than all old ones, so they stand at the end of each row.
    where = indptr[source + 1]
    out = copy.copy(graph)
    out.indices = np.insert(graph.indices, where, target.astype(np.int32))
    out.risk = np.insert(graph.risk, where, cost[:, 0])
    out.price = np.insert(graph.price, where, cost[:, 1:], axis=0)
    added = np.bincount(source, minlength=n + len(places))
    out.indptr = indptr + np.concatenate([[0], np.cumsum(added)])
    kept = np.repeat(np.concatenate([[0], np.cumsum(added)])[:n], np.diff(graph.indptr)) + np.arange(
        len(graph.indices)
    )
    out.nodes = with_places(graph, grid, [p.xy for p in places])
    out.frontier = np.append(graph.frontier, np.zeros(len(places), np.bool_))
    turns = np.array([p.turn_price for p in places], np.float32).reshape(-1, 2)
    out.turn_price = np.concatenate([graph.turn_price, turns])
    out.free_headings = np.append(graph.free_headings, np.array([p.headings for p in places], np.uint64))
    out.node_ids = np.append(graph.node_ids, np.arange(-len(places), 0))
    return out, kept
