"""The part of the lattice that the robot can reach: what the graph publishes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mapping.grid import ElevationGrid
from planning.graph.cells import NEIGHBOUR_OFFSETS, Cells
from planning.graph.describe import in_sight
from planning.graph.edge_risk import nearest_height


class Built(NamedTuple):
    """Arrays of `TraversalGraph`, edges as an undirected list (m, 2), their price (m, 2, 2) there and back."""

    nodes: NDArray[np.float64]
    edges: NDArray[np.int64]
    risk: NDArray[np.float32]
    price: NDArray[np.float32]
    frontier: NDArray[np.bool_]
    turn_price: NDArray[np.float32]
    free_headings: NDArray[np.uint64]
    ids: NDArray[np.int64]


def reachable(
    cells: Cells, grid: ElevationGrid, start: tuple[float, float], reach: float, before: NDArray[np.int64]
) -> Built:
    """The connected components with a node in sight within `reach` [m] of `start` x, y; where there is none, the one
    with most ids of `before`."""
    j, i = np.nonzero(cells.chosen >= 0)
    index = np.full(cells.chosen.shape, -1, dtype=np.int64)
    index[j, i] = np.arange(len(j))
    ej, ei, eo = np.nonzero(cells.risk >= 0.0)
    edges = np.stack(
        [index[ej, ei], index[ej + NEIGHBOUR_OFFSETS[eo, 0], ei + NEIGHBOUR_OFFSETS[eo, 1]]], axis=1
    )
    xy, ids = cells.where[j, i], cells.ids(j, i)
    joined = coo_array((np.ones(len(edges), np.bool_), edges.T), shape=(len(j), len(j)))
    label = connected_components(joined, directed=False)[1]
    near = np.flatnonzero(in_sight(cells.flags, *cells.origin, cells.res, *start, xy, reach))
    if len(near):
        keep = np.isin(label, label[near])
    else:
        roots = label[np.isin(ids, before)]
        keep = label == (np.bincount(roots).argmax() if len(roots) else -1)
    new = np.cumsum(keep) - 1
    kept = keep[edges[:, 0]]
    nodes = np.empty((int(keep.sum()), 3))
    nodes[:, :2] = xy[keep]
    nearest_height(grid.height, *cells.origin, cells.res, nodes)
    return Built(
        nodes,
        new[edges[kept]],
        cells.risk[ej, ei, eo][kept],
        cells.price[ej, ei, eo][kept],
        cells.frontier[j, i][keep],
        cells.turn_price[j, i][keep],
        cells.headings[j, i][keep],
        ids[keep],
    )
