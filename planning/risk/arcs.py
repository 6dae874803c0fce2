"""The graph as the search kernels take it: one slot per directed edge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.graph import TraversalGraph
from planning.risk.turns import forward_only, turn_rates


class Arcs(NamedTuple):
    """The graph's directed edges as the arrays that the search kernels take."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    indptr: NDArray[np.int64]
    source: NDArray[np.int32]
    target: NDArray[np.int32]
    reverse: NDArray[np.int64]
    """Slot of the opposite direction."""
    length: NDArray[np.float64]
    """Planar [m]."""
    heading: NDArray[np.float64]
    """Heading source -> target [rad]."""
    risk: NDArray[np.float32]
    room: NDArray[np.uint64]
    """(nodes,) `TraversalGraph.free_headings`: where the robot may turn in place."""
    turn_rate: NDArray[np.float64]
    """(nodes,) [m/rad] what an edge under the wheels or steep ground adds to a turn in place."""
    forward_only: NDArray[np.bool_]
    """(nodes,) a face under the wheels is too high to be climbed backward."""


def arcs_of(graph: TraversalGraph, old: Arcs | None = None, kept: NDArray[np.int64] | None = None) -> Arcs:
    """The graph's arrays with length, heading and opposite of every directed edge.

    `kept` (slots of `old`,) tells which slots here are the edges of `old`, all of them with both directions and ends at
    the same place: these are not worked out again.
    """
    x = np.ascontiguousarray(graph.nodes[:, 0], dtype=np.float64)
    y = np.ascontiguousarray(graph.nodes[:, 1], dtype=np.float64)
    indptr = np.ascontiguousarray(graph.indptr, dtype=np.int64)
    target = np.ascontiguousarray(graph.indices, dtype=np.int32)
    source = np.repeat(np.arange(len(x), dtype=np.int32), np.diff(indptr))
    length, heading = np.empty(len(target)), np.empty(len(target))
    reverse = np.full(len(target), -1, np.int64)
    if old is None or kept is None:
        new = np.arange(len(target))
    else:
        known = np.zeros(len(target), np.bool_)
        known[kept] = True
        length[kept], heading[kept], reverse[kept] = old.length, old.heading, kept[old.reverse]
        new = np.flatnonzero(~known)
    dx, dy = x[target[new]] - x[source[new]], y[target[new]] - y[source[new]]
    length[new], heading[new] = np.hypot(dx, dy), np.arctan2(dy, dx)
    _find_reverse(indptr, source, target, new, reverse)
    return Arcs(
        x,
        y,
        indptr,
        source,
        target,
        reverse,
        length,
        heading,
        np.ascontiguousarray(graph.risk, dtype=np.float32),
        np.ascontiguousarray(graph.free_headings, dtype=np.uint64),
        turn_rates(graph.turn_edge, graph.params.max_turn_step),
        forward_only(graph.turn_edge, graph.params),
    )


@njit(cache=True)
def _find_reverse(
    indptr: np.ndarray, source: np.ndarray, target: np.ndarray, slots: np.ndarray, out: np.ndarray
) -> None:
    """Write the slot of the opposite direction of each of `slots` into `out`; it is left alone where that is missing."""
    for s in slots:
        j = target[s]
        for o in range(indptr[j], indptr[j + 1]):
            if target[o] == source[s]:
                out[s] = o
                break
