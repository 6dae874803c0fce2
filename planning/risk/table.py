"""Body risk of a graph's edges and turns on one map, evaluated once and shared between queries."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from planning.risk.arcs import Arcs, arcs_of
from planning.risk.body import BodyModel, terrain_of, weights_of
from planning.risk.tables import Tables, carry_turns, evaluate_edges
from planning.risk.terrain import Sampler

MOST_TURNS = 1_000_000
"""Rows of turns that are kept for the next query: 16 MB."""


class RiskTable:
    """What queries on one graph, map and body share. Pass it to `plan`; it fills itself and never changes a result.

    When graph or map change, make a new one with the old as `previous`: edges and turns under which no cell changed keep
    their evaluations.
    """

    def __init__(
        self,
        graph: TraversalGraph,
        grid: ElevationGrid,
        body: BodyModel,
        previous: RiskTable | None = None,
    ) -> None:
        self.graph = graph
        self.version = graph.version
        self.grid = grid
        self.body = body
        self.terrain = terrain_of(grid, body)
        self.sampler: Sampler = self.terrain.sampler(body.length, body.width)
        self._ids = graph.node_ids
        self._arcs: Arcs | None = None
        self._tables: dict[tuple[float, float], Tables] = {}
        self.searched: object = None
        """What `planning.search.again` keeps of the last search, for the next one."""
        self.chords: object = None
        """What `planning.search.chords` keeps of the last routes."""
        if previous is not None and previous._arcs is None:  # nobody asked it for an edge
            previous = previous._previous
        self._previous: RiskTable | None = previous
        if previous is not None and previous.body == body and previous.grid.resolution == grid.resolution:
            self.searched, self.chords = previous.searched, previous.chords

    @property
    def arcs(self) -> Arcs:
        """The graph's edges; made when they are first asked for."""
        if self._arcs is None:
            old, self._previous = self._previous, None
            if old is None:
                self._arcs = arcs_of(self.graph)
            else:
                was = slots_before(self.graph, old._ids, old.arcs)
                self._arcs = arcs_of(self.graph, old.arcs, was)
                if old.body == self.body and old.grid.resolution == self.grid.resolution:
                    self._carry(old, was)
        return self._arcs

    @arcs.setter
    def arcs(self, arcs: Arcs) -> None:
        self._arcs = arcs

    def for_query(self, graph: TraversalGraph, kept: NDArray[np.int64]) -> RiskTable:
        """The table of one query on `graph`, which is this one's with more nodes; `kept` tells where each slot went.

        Evaluations go both ways: `take_back` brings home what the query added.
        """
        arcs, was = self.arcs, np.full(len(graph.indices), -1, np.int64)
        was[kept] = np.arange(len(kept))
        out = copy.copy(self)
        out.graph, out.arcs, out._tables, out._ids = (
            graph,
            arcs_of(graph, arcs, was),
            {},
            graph.node_ids,
        )
        for body, tables in self._each():
            _copy_edges(kept, tables.edge, out.tables(body).edge)
            out._take_turns(body, arcs, tables, kept)
        return out

    def take_back(self, query: RiskTable, kept: NDArray[np.int64]) -> None:
        """What a table that `for_query` made evaluated, and what its search and its routes keep."""
        self.searched, self.chords = query.searched, query.chords
        now = np.full(len(query.arcs.target), -1, np.int64)
        now[kept] = np.arange(len(kept))
        self._tables = {}
        for body, tables in query._each():
            _copy_edges(now, tables.edge, self.tables(body).edge)
            self._take_turns(body, query.arcs, tables, now)

    def fits(self, graph: TraversalGraph, grid: ElevationGrid, body: BodyModel) -> bool:
        """True while the table belongs to these inputs."""
        return (
            graph is self.graph and graph.version == self.version and grid is self.grid and body == self.body
        )

    def tables(self, body: BodyModel) -> Tables:
        """Evaluations under the weights of `body`, which differs from the table's own only in them."""
        slots, key = self.arcs.target.size, (body.weight_mean, body.weight_tail)
        if key not in self._tables:
            self._tables[key] = Tables(
                np.full((slots, 2), np.nan),
                np.full(slots, -1, np.int32),
                np.full((256, 2), np.nan),
                np.zeros(1, np.int64),
            )
        return self._tables[key]

    def keep(self, body: BodyModel, tables: Tables) -> None:
        """Take back the tables of `body` after a search, which may have made them larger."""
        self._tables[(body.weight_mean, body.weight_tail)] = tables

    def evaluate_edges(self) -> None:
        """Evaluate all edges now, so that no query has to: on a large graph, most of a query's time."""
        evaluate_edges(self.sampler, weights_of(self.body), self.arcs, self.tables(self.body))

    def evaluated(self) -> tuple[int, int]:
        """Directed edges and turns evaluated so far, over all weights."""
        self.tables(self.body)  # what was known before is carried over
        edges = sum(int((~np.isnan(t.edge[:, 0])).sum()) for t in self._tables.values())
        return edges, sum(int((~np.isnan(t.turns[:, 0])).sum()) for t in self._tables.values())

    def _carry(self, old: RiskTable, was: NDArray[np.int64]) -> None:
        """Take over what `old` knows of edges that are the same here, in its slots `was`, and have the same ground under them."""
        offset = (
            np.array([self.sampler.ox, self.sampler.oy]) - (old.sampler.ox, old.sampler.oy)
        ) * self.sampler.inv
        dc, dr = (int(v) for v in np.round(offset))
        if np.abs(offset - (dc, dr)).max() > 1e-6:  # other cells
            return
        s, o = self.sampler, old.sampler
        box, changed = _changed(s.height, s.trusted, s.stride, o.height, o.trusted, o.stride, dr, dc)
        now = _unchanged(was, len(old.arcs.target), self.arcs, s, box, changed)
        for body, tables in old._each():
            _copy_edges(now, tables.edge, self.tables(body).edge)
            self._take_turns(body, old.arcs, tables, now)

    def _take_turns(self, body: BodyModel, arcs: Arcs, old: Tables, now: NDArray[np.int64]) -> None:
        """As `carry_turns`, unless there are so many that they are to be evaluated anew."""
        if old.used[0] <= MOST_TURNS:
            tables = self.tables(body)
            self.keep(body, tables._replace(turns=carry_turns(now, arcs, old, self.arcs, tables)))

    def _each(self) -> Iterator[tuple[BodyModel, Tables]]:
        """The body with each of the weights that were asked for, and the evaluations under them."""
        for (mean, tail), tables in self._tables.items():
            yield self.body.model_copy(update={"weight_mean": mean, "weight_tail": tail}), tables


def slots_before(graph: TraversalGraph, ids: NDArray[np.int64], old: Arcs) -> NDArray[np.int64]:
    """(slots,) slot in `old` of the edge between the same two nodes at the same places, -1 = none; `ids` are the old nodes'."""
    if not len(ids):
        return np.full(len(graph.indices), -1, np.int64)
    known = np.argsort(ids, kind="stable")
    at = known[np.searchsorted(ids, graph.node_ids, sorter=known).clip(max=len(known) - 1)]
    x, y = graph.nodes[:, 0], graph.nodes[:, 1]
    here = (ids[at] == graph.node_ids) & (old.x[at] == x) & (old.y[at] == y)
    return _same_slots(graph.indptr, graph.indices, old, np.where(here, at, -1))


@njit(cache=True)
def _same_slots(indptr: np.ndarray, target: np.ndarray, old: Arcs, node: np.ndarray) -> np.ndarray:
    """(slots,) slot of the same edge in `old`, -1 = none; `node` is each node's index there."""
    out = np.full(target.size, -1, np.int64)
    old_indptr, old_target = old.indptr, old.target
    for at in range(indptr.size - 1):
        i = node[at]
        if i < 0:
            continue
        for slot in range(indptr[at], indptr[at + 1]):
            j = node[target[slot]]
            if j < 0:
                continue
            for k in range(old_indptr[i], old_indptr[i + 1]):
                if old_target[k] == j:
                    out[slot] = k
                    break
    return out


@njit(cache=True)
def _changed(
    height: np.ndarray,
    trusted: np.ndarray,
    stride: int,
    old_height: np.ndarray,
    old_trusted: np.ndarray,
    old_stride: int,
    dr: int,
    dc: int,
) -> tuple[tuple[int, int, int, int], np.ndarray]:
    """Where cells are not what they were: the box around them, first row, first column, row and column after the last, and the summed-area table of
    them in it; dr, dc: cell [0, 0] in the old."""
    rows, old_rows = height.size // stride, old_height.size // old_stride
    r0, c0, r1, c1 = rows, stride, 0, 0
    for r in range(rows):
        first, last, a = stride, -1, r + dr
        # The columns that both have, without a branch.
        begin, end = max(0, -dc), min(stride, old_stride - dc)
        if not 0 <= a < old_rows or end <= begin:
            first, last = 0, stride - 1
        else:
            i, j = r * stride, a * old_stride + dc
            here, there = height[i + begin : i + end], old_height[j + begin : j + end]
            known, knew = trusted[i + begin : i + end], old_trusted[j + begin : j + end]
            differ = 0
            for c in range(here.size):
                differ += (here[c] != there[c]) | (known[c] != knew[c])
            if differ > 0:
                for c in range(here.size):
                    if here[c] != there[c] or known[c] != knew[c]:
                        first, last = min(first, c + begin), c + begin
            if begin > 0:
                first, last = 0, max(last, begin - 1)
            if end < stride:
                first, last = min(first, end), stride - 1
        if last >= 0:
            r0, r1, c0, c1 = min(r0, r), r + 1, min(c0, first), max(c1, last + 1)
    table = np.zeros((max(r1 - r0, 0) + 1, max(c1 - c0, 0) + 1), np.int32)
    for r in range(r0, r1):
        total = 0
        for c in range(c0, c1):
            a, b = r + dr, c + dc
            same = False
            if 0 <= a < old_rows and 0 <= b < old_stride:
                i, j = r * stride + c, a * old_stride + b
                same = height[i] == old_height[j] and trusted[i] == old_trusted[j]
            total += not same
            table[r - r0 + 1, c - c0 + 1] = table[r - r0, c - c0 + 1] + total
    return (r0, c0, r1, c1), table


@njit(cache=True)
def _unchanged(
    was: np.ndarray,
    old_slots: int,
    arcs: Arcs,
    sampler: Sampler,
    box: tuple[int, int, int, int],
    changed: np.ndarray,
) -> np.ndarray:
    """(old slots,) the slot of now of each edge that is the same, with no changed cell in the box that the footprint does not leave on its way; else -1."""
    rows, cols = sampler.seen.shape[0] - 1, sampler.stride
    x, y, source, target = arcs.x, arcs.y, arcs.source, arcs.target
    ox, oy, inv, reach = sampler.ox, sampler.oy, sampler.inv, sampler.reach
    out = np.full(old_slots, -1, np.int64)
    for slot in range(target.size):
        if was[slot] < 0:
            continue
        i, j = source[slot], target[slot]
        x0, x1 = min(x[i], x[j]), max(x[i], x[j])
        y0, y1 = min(y[i], y[j]), max(y[i], y[j])
        c0, c1 = int(np.floor((x0 - ox) * inv)), int(np.ceil((x1 - ox) * inv))
        r0, r1 = int(np.floor((y0 - oy) * inv)), int(np.ceil((y1 - oy) * inv))
        c0, c1 = c0 - reach - 1, c1 + reach + 2
        r0, r1 = r0 - reach - 1, r1 + reach + 2
        if c0 < 0 or r0 < 0 or c1 > cols or r1 > rows:
            continue
        r0, c0 = max(r0, box[0]) - box[0], max(c0, box[1]) - box[1]
        r1, c1 = min(r1, box[2]) - box[0], min(c1, box[3]) - box[1]
        if r0 >= r1 or c0 >= c1 or changed[r1, c1] - changed[r0, c1] - changed[r1, c0] + changed[r0, c0] == 0:
            out[was[slot]] = slot
    return out


@njit(cache=True)
def _copy_edges(now: np.ndarray, old: np.ndarray, edge: np.ndarray) -> None:
    for k in range(now.size):
        if now[k] >= 0:
            edge[now[k], 0], edge[now[k], 1] = old[k, 0], old[k, 1]
