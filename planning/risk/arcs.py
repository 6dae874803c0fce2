"""The graph as the search kernels take it: one slot per directed edge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.graph import TraversalGraph


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
    price: NDArray[np.float32]
    """(slots, 2) [m], see `TraversalGraph`."""
    turn_price: NDArray[np.float32]
    """(nodes, 2) [m/rad], see `TraversalGraph`."""


def arcs_of(graph: TraversalGraph, old: Arcs | None = None, was: NDArray[np.int64] | None = None) -> Arcs:
    """The graph's arrays with length, heading and opposite of every directed edge.

    `was` (slots,) tells which slot of `old` is the same edge with both ends at the same place, -1 = none: what is known
    of these is not worked out again.
    """
    x = np.ascontiguousarray(graph.nodes[:, 0], dtype=np.float64)
    y = np.ascontiguousarray(graph.nodes[:, 1], dtype=np.float64)
    indptr = np.ascontiguousarray(graph.indptr, dtype=np.int64)
    target = np.ascontiguousarray(graph.indices, dtype=np.int32)
    source = np.repeat(np.arange(len(x), dtype=np.int32), np.diff(indptr))
    length, heading = np.empty(len(target)), np.empty(len(target))
    reverse = np.full(len(target), -1, np.int64)
    if old is not None and was is not None:
        _take_over(was, old.length, old.heading, old.reverse, length, heading, reverse)
        new = np.flatnonzero(was < 0)
    else:
        new = np.arange(len(target))
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
        np.ascontiguousarray(graph.price, dtype=np.float32),
        np.ascontiguousarray(graph.turn_price, dtype=np.float32),
    )


@njit(cache=True)
def _take_over(
    was: np.ndarray,
    old_length: np.ndarray,
    old_heading: np.ndarray,
    old_reverse: np.ndarray,
    length: np.ndarray,
    heading: np.ndarray,
    reverse: np.ndarray,
) -> None:
    """Copy what is known of edges that are the same; both directions of an edge are."""
    now = np.full(old_length.size, -1, np.int64)
    for slot in range(was.size):
        if was[slot] >= 0:
            now[was[slot]] = slot
    for slot in range(was.size):
        k = was[slot]
        if k >= 0:
            length[slot], heading[slot], reverse[slot] = old_length[k], old_heading[k], now[old_reverse[k]]


@njit(cache=True)
def _find_reverse(
    indptr: np.ndarray, source: np.ndarray, target: np.ndarray, slots: np.ndarray, out: np.ndarray
) -> None:
    """Write the slot of the opposite direction of each of `slots` into `out`; it is left alone where that is
    missing."""
    for s in slots:
        j = target[s]
        for o in range(indptr[j], indptr[j + 1]):
            if target[o] == source[s]:
                out[s] = o
                break
