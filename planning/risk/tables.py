"""Body and unknown term of every edge and turn, evaluated where they are asked for (paper eq. 3-4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.risk.arcs import Arcs
from planning.risk.cost import Weights
from planning.risk.footprint import scratch
from planning.risk.pose_sets import evaluate_poses
from planning.risk.terrain import Sampler


class Tables(NamedTuple):
    """Evaluated pose sets: body term B and unknown term U; NaN = not yet."""

    edge: NDArray[np.float64]
    """(slots, 2)"""
    turn_at: NDArray[np.int32]
    """(slots,) first row in `turns` of the turns out of each slot: two per edge that leaves its target, with the same
    end of the body ahead after it and with the other; -1 = none."""
    turns: NDArray[np.float64]
    """(rows, 2); B = inf where there is no room to turn."""
    used: NDArray[np.int64]
    """(1,) rows of `turns` in use."""


def no_tables(slots: int) -> Tables:
    """Nothing is evaluated yet."""
    return Tables(
        np.full((slots, 2), np.nan),
        np.full(slots, -1, np.int32),
        np.full((256, 2), np.nan),
        np.zeros(1, np.int64),
    )


@njit(cache=True)
def evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, slot) -> None:
    """Put B and U of a directed edge into the table; the opposite direction covers the same ground.

    Takes the arrays one by one: handing the whole tuples down costs as much as a third of the evaluation.
    """
    back = reverse[slot]
    one = min(slot, back)
    i, j = source[one], target[one]
    dx, dy = x[j] - x[i], y[j] - y[i]
    b, u = evaluate_poses(sampler, work, w, x[i], y[i], np.arctan2(dy, dx), dx, dy, 0.0, work.moments)
    for at in (slot, back):
        edge[at, 0], edge[at, 1] = b, u


@njit(cache=True)
def evaluate_edges(sampler: Sampler, w: Weights, arcs: Arcs, tables: Tables) -> None:
    """Evaluate every edge that is not yet."""
    work = scratch(sampler)
    x, y, _, source, target, reverse, _, _, _, _, _, _ = arcs
    edge = tables.edge
    for slot in range(target.size):
        if np.isnan(edge[slot, 0]):
            evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, slot)


@njit(cache=True)
def carry_turns(now: np.ndarray, old_arcs: Arcs, old: Tables, arcs: Arcs, tables: Tables) -> np.ndarray:
    """The rows of `old` for `tables`, which has none yet: those of turns between edges that there still are. `now` (old
    slots,) tells where, -1 = nowhere, also of an edge at whose end the ground has changed. Returns `Tables.turns`."""
    indptr, target, old_indptr, old_target = arcs.indptr, arcs.target, old_arcs.indptr, old_arcs.target
    turn_at, before, old_turns = tables.turn_at, old.turn_at, old.turns
    rows = 0
    for k in range(now.size):
        if before[k] >= 0 and now[k] >= 0:
            at = target[now[k]]
            rows += 2 * (indptr[at + 1] - indptr[at])
    turns = np.full((max(rows, 256), 2), np.nan)
    used = 0
    for k in range(now.size):
        if before[k] < 0 or now[k] < 0:
            continue
        there, at = old_target[k], target[now[k]]
        begin, end = old_indptr[there], old_indptr[there + 1]
        for out in range(begin, end):
            if now[out] >= 0:
                row, was = used + 2 * (now[out] - indptr[at]), before[k] + 2 * (out - begin)
                for i in range(2):
                    turns[row + i, 0], turns[row + i, 1] = old_turns[was + i, 0], old_turns[was + i, 1]
        turn_at[now[k]] = used
        used += 2 * (indptr[at + 1] - indptr[at])
    tables.used[0] = used
    return turns
