"""Body and unknown term of every edge and turn, evaluated where they are asked for (paper eq. 3-4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.risk.arcs import Arcs
from planning.risk.cost import Weights
from planning.risk.footprint import scratch
from planning.risk.pose_sets import edge_risk
from planning.risk.terrain import Sampler


class Tables(NamedTuple):
    """Evaluated pose sets: body term B and unknown term U; NaN = not yet."""

    edge: NDArray[np.float64]
    """(slots, 2)"""
    turn_at: NDArray[np.int64]
    """(slots,) first row in `turns` of the turns out of each slot: two per edge that leaves its target, with the same end of
    the body ahead after it and with the other; -1 = none."""
    turns: NDArray[np.float64]
    """(rows, 2); B = inf where there is no room to turn."""
    used: NDArray[np.int64]
    """(1,) rows of `turns` in use."""


@njit(cache=True)
def evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, slot) -> None:
    """Put B and U of a directed edge into the table; the opposite direction covers the same ground.

    Takes the arrays one by one: handing the whole tuples down costs as much as a third of the evaluation.
    """
    back = reverse[slot]
    one = min(slot, back)
    i, j = source[one], target[one]
    edge[slot] = edge_risk(sampler, work, w, x[i], y[i], x[j] - x[i], y[j] - y[i])
    edge[back] = edge[slot]


@njit(cache=True)
def evaluate_edges(sampler: Sampler, w: Weights, arcs: Arcs, tables: Tables) -> None:
    """Evaluate every edge that is not yet."""
    work = scratch(sampler)
    x, y, _, source, target, reverse, _, _, _, _, _, _ = arcs
    edge = tables.edge
    for slot in range(target.size):
        if np.isnan(edge[slot, 0]):
            evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, slot)
