"""Body risk of a graph's edges and turns on one map, evaluated once and shared between queries."""

from __future__ import annotations

import copy

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from planning.risk.arcs import Arcs, arcs_of
from planning.risk.body import BodyModel, terrain_of, weights_of
from planning.risk.tables import Tables, carry_turns, evaluate_edges, no_tables
from planning.risk.terrain import NO_CHANGE, Changed, Sampler, Terrain, changed_cells

MOST_TURNS = 1_000_000
"""Rows of turns that are kept for the next query: 16 MB."""


class RiskTable:
    """What queries on one graph, map and body share. Pass it to `plan`; it fills itself and never changes a result.

    When graph or map change, make a new one with the old as `previous`: edges and turns under which no cell changed
    keep their evaluations. It takes the terrain of the old one, which makes itself another where it is asked for it
    again.
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
        self._ids = graph.node_ids
        self._arcs: Arcs | None = None
        self._tables: Tables | None = None
        self._terrain, changed = self._follow(previous)
        self._known: RiskTable | None = previous
        """The newest table with arcs, while this one has none: what that evaluated is asked for there."""
        self._changed: Changed | None = changed
        """Where the terrain is not what it was for that table; None: that is to be found out."""
        if previous is not None and previous._arcs is None:  # nobody asked it for an edge
            self._known = previous._known
            self._changed = changed if previous._changed is NO_CHANGE else None

    def _follow(self, previous: RiskTable | None) -> tuple[Terrain, Changed | None]:
        """The terrain of the grid, and where that of `previous` was another."""
        if previous is not None and previous.body == self.body:
            terrain = previous.terrain
            if (changed := terrain.follow(self.grid)) is not None:
                return terrain, changed
        return terrain_of(self.grid, self.body), None

    @property
    def terrain(self) -> Terrain:
        """That of the grid."""
        if self._terrain.grid is not self.grid:  # it went to the table after this one
            self._terrain = terrain_of(self.grid, self.body)
        return self._terrain

    @property
    def sampler(self) -> Sampler:
        """What the kernels take of it."""
        return self.terrain.sampler(self.body.length, self.body.width)

    @property
    def arcs(self) -> Arcs:
        """The graph's edges; made when they are first asked for."""
        if self._arcs is None:
            self._ask(self._known)
        assert self._arcs is not None
        return self._arcs

    @arcs.setter
    def arcs(self, arcs: Arcs) -> None:
        self._arcs = arcs

    def _ask(self, old: RiskTable | None) -> None:
        """Make the arcs, with what `old` knows of them that is still true."""
        self._known = None
        if old is None:
            self._arcs = arcs_of(self.graph)
            return
        was = slots_before(self.graph, old._ids, old.arcs)
        self._arcs = arcs_of(self.graph, old.arcs, was)
        if old.body == self.body and old.grid.resolution == self.grid.resolution:
            self._carry(old, was)

    def for_query(self, graph: TraversalGraph, kept: NDArray[np.int64]) -> RiskTable:
        """The table of one query on `graph`, which is this one's with more nodes; `kept` tells where each slot went.

        What it comes to know is for the next query as well, once `take_back` has it.
        """
        out = copy.copy(self)
        out.graph, out._ids, out._arcs, out._tables = graph, graph.node_ids, None, None
        if self._arcs is None:
            out._ask(self._known)
            return out
        was = np.full(len(graph.indices), -1, np.int64)
        was[kept] = np.arange(len(kept))
        out._known, out._arcs = None, arcs_of(graph, self._arcs, was)
        out._take_all(self, kept)
        return out

    def take_back(self, query: RiskTable) -> None:
        """A table that `for_query` made, with what it evaluated."""
        self._arcs, self._tables, self._known, self._changed = None, None, query, NO_CHANGE

    def fits(self, graph: TraversalGraph, grid: ElevationGrid, body: BodyModel) -> bool:
        """True while the table belongs to these inputs."""
        return (
            graph is self.graph and graph.version == self.version and grid is self.grid and body == self.body
        )

    @property
    def tables(self) -> Tables:
        """Evaluations under the weights of the body. A search may make them larger, and puts them back."""
        slots = self.arcs.target.size  # takes over what was known before
        if self._tables is None:
            self._tables = no_tables(slots)
        return self._tables

    @tables.setter
    def tables(self, tables: Tables) -> None:
        self._tables = tables

    def evaluate_edges(self) -> None:
        """Evaluate all edges now, so that no query has to: on a large graph, most of a query's time."""
        evaluate_edges(self.sampler, weights_of(self.body), self.arcs, self.tables)

    def evaluated(self) -> tuple[int, int]:
        """Directed edges and turns evaluated so far."""
        tables = self.tables
        return int((~np.isnan(tables.edge[:, 0])).sum()), int((~np.isnan(tables.turns[:, 0])).sum())

    def _carry(self, old: RiskTable, was: NDArray[np.int64]) -> None:
        """Take over what `old` knows of edges that are the same here, in its slots `was`, and have the same ground
        under them."""
        s, changed = self.sampler, self._changed
        if changed is None:
            terrain = old.terrain
            offset = (np.array([s.ox, s.oy]) - terrain.origin) * s.inv
            dc, dr = (int(v) for v in np.round(offset))
            if np.abs(offset - (dc, dr)).max() > 1e-6:  # other cells
                return
            there = terrain.height.reshape(-1), terrain.trusted.reshape(-1), terrain.height.shape[1]
            (row, col, *_), cells = changed_cells(s.height, s.trusted, s.stride, *there, dr, dc)
            changed = Changed(row, col, cells)
        count = np.zeros(np.add(changed.cells.shape, 1), np.int32)
        count[1:, 1:] = changed.cells.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
        self._take_all(
            old, _unchanged(was, len(old.arcs.target), self.arcs, s, changed.row, changed.col, count)
        )

    def _take_all(self, old: RiskTable, now: NDArray[np.int64]) -> None:
        """Take over what `old` knows of its slots that are here as `now` tells, -1 = nowhere."""
        known = old._tables
        if known is None:
            return
        _copy_edges(now, known.edge, self.tables.edge)
        if known.used[0] <= MOST_TURNS:  # more are evaluated anew
            turns = carry_turns(now, old.arcs, known, self.arcs, self.tables)
            self.tables = self.tables._replace(turns=turns)


def slots_before(graph: TraversalGraph, ids: NDArray[np.int64], old: Arcs) -> NDArray[np.int64]:
    """(slots,) slot in `old` of the edge between the same two nodes at the same places, -1 = none; `ids` are the old
    nodes'."""
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
            j, alike = node[target[slot]], old_indptr[i] + slot - indptr[at]
            if j < 0:
                continue
            if alike < old_indptr[i + 1] and old_target[alike] == j:  # most rows are as they were
                out[slot] = alike
                continue
            for k in range(old_indptr[i], old_indptr[i + 1]):
                if old_target[k] == j:
                    out[slot] = k
                    break
    return out


@njit(cache=True)
def _unchanged(
    was: np.ndarray,
    old_slots: int,
    arcs: Arcs,
    sampler: Sampler,
    row: int,
    col: int,
    changed: np.ndarray,
) -> np.ndarray:
    """(old slots,) the slot of now of each edge that is the same, with no changed cell in the box that the footprint
    does not leave on its way; else -1. `changed`: summed-area table of the cells from `row` and `col` on."""
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
        r0, c0 = max(r0 - row, 0), max(c0 - col, 0)
        r1, c1 = min(r1 - row, changed.shape[0] - 1), min(c1 - col, changed.shape[1] - 1)
        if r0 >= r1 or c0 >= c1 or changed[r1, c1] - changed[r0, c1] - changed[r1, c0] + changed[r0, c0] == 0:
            out[was[slot]] = slot
    return out


@njit(cache=True)
def _copy_edges(now: np.ndarray, old: np.ndarray, edge: np.ndarray) -> None:
    for k in range(now.size):
        if now[k] >= 0:
            edge[now[k], 0], edge[now[k], 1] = old[k, 0], old[k, 1]
