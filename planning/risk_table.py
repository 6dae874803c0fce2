"""Body risk of a graph's edges and turns on one map, evaluated once and shared between queries."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mapping.grid import ElevationGrid
from planning.body_risk import BodyModel, terrain_of
from planning.graph import TraversalGraph
from planning.search_kernels import Roads, Tables, Weights, reverse_slots


def weights_of(body: BodyModel) -> Weights:
    """`body` as plain numbers for the kernels."""
    return Weights(
        body.scales,
        body.clip,
        body.weight_mean,
        body.weight_tail,
        body.weight_native,
        body.weight_body,
        body.weight_unknown,
        body.edge_step,
        float(np.radians(body.sweep_step)),
    )


def roads_of(graph: TraversalGraph) -> Roads:
    """The graph's arrays with length, heading and opposite of every directed edge."""
    x = np.ascontiguousarray(graph.nodes[:, 0], dtype=np.float64)
    y = np.ascontiguousarray(graph.nodes[:, 1], dtype=np.float64)
    indptr = np.ascontiguousarray(graph.indptr, dtype=np.int64)
    target = np.ascontiguousarray(graph.indices, dtype=np.int32)
    degree = np.diff(indptr)
    source = np.repeat(np.arange(len(x), dtype=np.int32), degree)
    dx, dy = x[target] - x[source], y[target] - y[source]
    sweep_ptr = np.concatenate([[0], np.cumsum(degree[target])]).astype(np.int64)
    risk = np.ascontiguousarray(graph.risk, dtype=np.float32)
    return Roads(
        x,
        y,
        indptr,
        source,
        target,
        reverse_slots(indptr, source, target),
        np.hypot(dx, dy),
        np.arctan2(dy, dx),
        risk,
        sweep_ptr,
    )


class RiskTable:
    """What queries on one graph, map and body share. Pass it to `plan`; make a new one when graph or map change.

    It fills itself while queries run and never changes a result.
    """

    def __init__(self, graph: TraversalGraph, grid: ElevationGrid, body: BodyModel) -> None:
        self.graph = graph
        self.version = graph.version
        self.grid = grid
        self.body = body
        self._tables: dict[tuple[float, float], Tables] = {}

    @cached_property
    def laid(self):
        """Terrain and footprint samples."""
        return terrain_of(self.grid, self.body).laid(self.body.length, self.body.width)

    @cached_property
    def roads(self) -> Roads:
        """The graph for the kernels."""
        return roads_of(self.graph)

    def fits(self, graph: TraversalGraph, grid: ElevationGrid, body: BodyModel) -> bool:
        """True while the table belongs to these inputs."""
        return (
            graph is self.graph and graph.version == self.version and grid is self.grid and body == self.body
        )

    def tables(self, body: BodyModel) -> Tables:
        """Evaluations under the weights of `body`, which differs from the table's own only in them."""
        key = (body.weight_mean, body.weight_tail)
        if key not in self._tables:
            slots, sweeps = self.roads.target.size, int(self.roads.sweep_ptr[-1])
            self._tables[key] = Tables(*(np.full((n, 2), np.nan) for n in (slots, sweeps, slots)))
        return self._tables[key]

    def evaluated(self) -> tuple[int, int]:
        """Directed edges and turns evaluated so far, over all weights."""
        edges = sum(int(np.isfinite(t.edge[:, 0]).sum()) for t in self._tables.values())
        return edges, sum(int(np.isfinite(t.sweep[:, 0]).sum()) for t in self._tables.values())
