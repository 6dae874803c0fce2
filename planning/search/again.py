"""The search backward from a goal, kept for the next query to it: until then the map has changed a little and the robot has moved on.

What it costs from a state to the goal does not depend on where the robot is. A state keeps its cost where nothing has changed on its way; the
others are found again by going on with the search, from the states around them. Costs and routes are the same as those of a new search.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.graph import TraversalGraph
from planning.risk.arcs import Arcs
from planning.risk.body import BodyModel, weights_of
from planning.risk.cost import Weights
from planning.risk.footprint import scratch
from planning.risk.table import RiskTable
from planning.risk.tables import Tables, evaluate_edge
from planning.risk.terrain import Sampler
from planning.search.bounds import Asked, ToGo, begin_to_go, come_nearer

AFRESH = 5.0
"""[m] from where it was worked out the cost to come is worked out anew: beside the way of the robot it falls below what is true by up to twice as much."""


@dataclass(frozen=True, slots=True)
class Found:
    """What a search knows beside the costs to the goal, for `planning.search.unbeaten`."""

    graph: TraversalGraph
    """Without the nodes of the query."""
    version: int
    """Of that graph then."""
    come: NDArray[np.float64]
    """(nodes,) see `cost_to_come`."""
    begun: tuple[float, float]
    """x, y [m] of the start from which that was worked out anew, see `come_nearer`."""
    beyond: float
    """[m] A route over a state that is not settled costs at least so much."""
    straight: float
    """What the route that was found cost after it was made straight, as a share of what it cost before."""


class Known(NamedTuple):
    """What it costs at least to come to each node."""

    come: NDArray[np.float64]
    """`Found.come` from the start of now; empty: it is to be worked out."""
    begun: tuple[float, float]
    """`Found.begun`"""


@dataclass(frozen=True, slots=True)
class Search:
    """One search backward, with the graph it was made on."""

    key: bytes
    """What its costs depend on besides the graph: the weights, the goal and how it is driven to."""
    ids: NDArray[np.int64]
    """(nodes,) `TraversalGraph.node_ids`."""
    arcs: Arcs
    edge: NDArray[np.float64]
    """`Tables.edge`"""
    go: ToGo
    found: Found | None = None
    """None where nothing was found, or not by this search alone."""


def key_of(
    body: BodyModel,
    x: float,
    y: float,
    exit_cost: float,
    goal_yaw: float,
    sweeps: bool,
    once: bool,
    backward: float,
    turning: float,
) -> bytes:
    """`Search.key` of a search to one end at x, y [m]; the rest as in `Asked`."""
    weights = body.weight_mean, body.weight_tail
    return np.array([*weights, goal_yaw, sweeps, once, backward, turning, x, y, exit_cost]).tobytes()


def go_on(
    table: RiskTable, tables: Tables, body: BodyModel, asked: Asked, keep: bool = True
) -> tuple[ToGo, Known]:
    """What is known of the way to the ends of `asked`, and to come to each node, if `table` has kept a search to them with the weights of `body`.

    keep: for the next query. For more than one end (frontiers, which change with each map) nothing is kept.
    """
    arcs, w = table.arcs, weights_of(body)
    is_end, exit_cost = asked.is_end, asked.exit_cost
    ends = np.flatnonzero(is_end)
    come = Known(np.empty(0), start_of(arcs, asked))
    if len(ends) != 1:
        return begin_to_go(arcs, is_end, exit_cost), come
    end = int(ends[0])
    how = asked.goal_yaw, asked.sweeps, asked.once, asked.backward, asked.turning
    key = key_of(body, float(arcs.x[end]), float(arcs.y[end]), float(exit_cost[end]), *how)
    if isinstance(old := table.searched, Search) and old.key == key:
        was = table.before(old.ids, old.arcs)
        go, now = carried(
            table.sampler, w, arcs, tables.edge, is_end, exit_cost, old.arcs, old.edge, was.slots, old.go
        )
        if old.found is not None and math.dist(old.found.begun, come.begun) <= AFRESH:
            come = Known(
                come_nearer(w, arcs, tables.edge, asked.start, old.found.come, was.nodes, was.slots, now),
                old.found.begun,
            )
    else:
        go = begin_to_go(arcs, is_end, exit_cost)
    if keep:
        table.searched = Search(key, table.graph.node_ids, arcs, tables.edge, go)
    return go, come


def start_of(arcs: Arcs, asked: Asked) -> tuple[float, float]:
    """x, y [m] of the start."""
    return float(arcs.x[asked.start]), float(arcs.y[asked.start])


@njit(cache=True)
def carried(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    edge: np.ndarray,
    is_end: np.ndarray,
    exit_cost: np.ndarray,
    old_arcs: Arcs,
    old_edge: np.ndarray,
    was: np.ndarray,
    old: ToGo,
) -> tuple[ToGo, np.ndarray]:
    """The states of `old` whose whole way to an end is as it was; `was` (slots,) tells which slot of then is the same edge, -1 = none. And `_unchanged`.

    States from which a way may lead to one that was lost, or is new, are reached but not settled: the search finds it from them.
    """
    now = _unchanged(sampler, w, arcs, edge, old_arcs, old_edge, was)
    source, target = arcs.source, arcs.target
    lost = _lost(now, is_end, target, old_arcs, old)
    old_h, old_settled, old_after = old
    h, settled, after = begin_to_go(arcs, is_end, exit_cost)
    again = np.zeros(arcs.x.size, np.bool_)
    for slot in range(was.size):
        k = was[slot]
        if k < 0 or now[k] != slot:
            again[target[slot]] = True
            continue
        for way in range(2):
            to, state = 2 * slot + way, 2 * k + way
            if old_h[state] == np.inf:
                continue
            if lost[state]:
                again[target[slot]] = True
                continue
            h[to], settled[to] = old_h[state], old_settled[state]
            follows = old_after[state]
            if follows >= 0:
                after[to] = 2 * now[follows >> 1] + (follows & 1)
    for slot in range(was.size):
        if again[source[slot]]:
            settled[2 * slot] = settled[2 * slot + 1] = False
    return ToGo(h, settled, after), now


@njit(cache=True)
def _unchanged(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    edge: np.ndarray,
    old_arcs: Arcs,
    old_edge: np.ndarray,
    was: np.ndarray,
) -> np.ndarray:
    """(old slots,) the slot of now where driving it and turning at its ends costs what it did, else -1.

    An edge that was not evaluated then was in no cost.
    """
    work = scratch(sampler)
    x, y, _, source, target, reverse, _, _, risk, room, turn_rate, forward_only = arcs
    old_source, old_risk, old_room = old_arcs.source, old_arcs.risk, old_arcs.room
    old_rate, old_only = old_arcs.turn_rate, old_arcs.forward_only
    out = np.full(old_source.size, -1, np.int32)
    alike = np.zeros(x.size, np.bool_)
    for slot in range(was.size):
        if was[slot] >= 0:
            i, j = source[slot], old_source[was[slot]]
            alike[i] = (
                room[i] == old_room[j] and turn_rate[i] == old_rate[j] and forward_only[i] == old_only[j]
            )
    for slot in range(was.size):
        k = was[slot]
        if k < 0 or risk[slot] != old_risk[k] or not (alike[source[slot]] and alike[target[slot]]):
            continue
        if not np.isnan(old_edge[k, 0]):
            if np.isnan(edge[slot, 0]):
                evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, slot)
            if edge[slot, 0] != old_edge[k, 0] or edge[slot, 1] != old_edge[k, 1]:
                continue
        out[k] = slot
    return out


@njit(cache=True)
def _lost(now: np.ndarray, is_end: np.ndarray, target: np.ndarray, old_arcs: Arcs, old: ToGo) -> np.ndarray:
    """(old states,) whether something on the way from a state that was reached is not as it was: those where it changed, and on from them those that came over one that is lost."""
    indptr, source, reverse = old_arcs.indptr, old_arcs.source, old_arcs.reverse
    h, after = old.h, old.after
    out, found = np.zeros(h.size, np.bool_), np.empty(h.size, np.int64)
    n = 0
    for slot in range(now.size):
        gone = now[slot] < 0
        for state in range(2 * slot, 2 * slot + 2):
            if h[state] < np.inf and (gone or (after[state] < 0 and not is_end[target[now[slot]]])):
                out[state], found[n] = True, state
                n += 1
    while n > 0:
        n -= 1
        state = found[n]
        at = source[state >> 1]
        for back in range(indptr[at], indptr[at + 1]):
            into = reverse[back]
            for before in range(2 * into, 2 * into + 2):
                if h[before] < np.inf and after[before] == state and not out[before]:
                    out[before], found[n] = True, before
                    n += 1
    return out
