"""Lower bounds that guide the search over pairs: what it costs to come to a node, and from a state to the goal.

Nearly all time of a query goes into evaluating pose sets, those of turns above all, and each state a search expands has about
twenty turns. So two searches that evaluate no turn come first. Both are exact in what they count; their results are
never above the true cost, and consistent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.graph.describe import turn_is_free
from planning.risk.arcs import Arcs
from planning.risk.cost import Weights, transition_cost
from planning.risk.footprint import scratch
from planning.risk.pose_sets import turn_angle
from planning.risk.tables import Tables, evaluate_edge
from planning.risk.terrain import Sampler
from planning.risk.turns import back_factor, may_turn_to, turn_cost
from planning.search.heap import grown, most_out, pop, push


@njit(cache=True)
def cost_to_come(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    tables: Tables,
    start: int,
    is_end: np.ndarray,
    exit_cost: np.ndarray,
    gx: float,
    gy: float,
) -> tuple[float, np.ndarray]:
    """Least cost from `start` over an end, without turns, and (nodes,) from `start` to each node: lazy A*.

    No `exit_cost` (nodes,) is less than the way to (gx, gy) is long. The search stops at the best end. What was not settled by
    then costs, together with the straight line to (gx, gy), at least as much; that is its bound. inf: no end can be reached.
    """
    work = scratch(sampler)
    x, y, indptr, source, target, reverse, length, _, risk, _, _, _ = arcs
    edge = tables.edge
    count = x.size
    g = np.full(count, np.inf)
    closed = np.zeros(count, np.bool_)
    f, s, e = np.empty(256), np.empty(256, np.int64), np.empty(256, np.int64)
    g[start] = 0.0
    n = push(f, s, e, 0, np.hypot(gx - x[start], gy - y[start]), start, -1)
    total, most = np.inf, most_out(indptr) + 1
    while n > 0 and np.isinf(total):
        if n + most > f.size:
            f, s, e = grown(f), grown(s), grown(e)
        while 0 < n <= f.size - most:
            bound, i, via = f[0], s[0], e[0]
            n = pop(f, s, e, n)
            if i < 0:
                total = bound
                break
            if closed[i]:
                continue
            if via >= 0:  # an edge not evaluated when it was pushed
                if np.isnan(edge[via, 0]):
                    evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, via)
                cost = g[source[via]] + transition_cost(w, length[via], risk[via], edge[via, 0], edge[via, 1])
                if cost < g[i]:
                    g[i] = cost
                    n = push(f, s, e, n, cost + np.hypot(gx - x[i], gy - y[i]), i, -1)
                continue
            closed[i] = True
            if is_end[i]:
                n = push(f, s, e, n, g[i] + exit_cost[i], -1, -1)
            for out in range(indptr[i], indptr[i + 1]):
                k = target[out]
                if closed[k]:
                    continue
                known = not np.isnan(edge[out, 0])
                b, u = (edge[out, 0], edge[out, 1]) if known else (0.0, 0.0)
                cost = g[i] + transition_cost(w, length[out], risk[out], b, u)
                if cost >= g[k]:
                    continue
                if known:
                    g[k] = cost
                n = push(f, s, e, n, cost + np.hypot(gx - x[k], gy - y[k]), k, -1 if known else out)
    for i in range(count):
        if not closed[i]:
            g[i] = max(0.0, total - np.hypot(gx - x[i], gy - y[i]))
    return total, g


@njit(cache=True)
def come_nearer(
    w: Weights,
    arcs: Arcs,
    edge: np.ndarray,
    start: int,
    old: np.ndarray,
    nodes: np.ndarray,
    was: np.ndarray,
    now: np.ndarray,
) -> np.ndarray:
    """(nodes,) bounds of what it costs to come to each node from `start`, from those of an earlier start on an earlier graph, `old`; empty where no node of then lies beside the start.

    Costs of nodes that differ by no more than the edge between them costs, and are 0 at the start, are never above the true ones. So all become lower by what the start has come nearer, and
    where an edge is new or costs less than it did, costs beyond it that are too high for it become lower as well. What has become dearer stays.
    `nodes` and `was`: see `planning.risk.table.Before`; `now` (old slots,): the slot that costs what it did, -1 = none.
    """
    indptr, source, target, length, risk = arcs.indptr, arcs.source, arcs.target, arcs.length, arcs.risk
    come = np.full(nodes.size, np.inf)
    for i in range(nodes.size):
        if nodes[i] >= 0:
            come[i] = old[nodes[i]]
    nearer = -np.inf
    for out in range(indptr[start], indptr[start + 1]):
        if come[target[out]] < np.inf:
            nearer = max(nearer, come[target[out]] - _least_cost(w, length, risk, edge, out))
    if nearer == -np.inf:
        return np.empty(0)
    for i in range(nodes.size):
        come[i] = max(come[i] - nearer, 0.0)
    come[start] = 0.0
    f, s, e = np.empty(256), np.empty(256, np.int64), np.empty(256, np.int64)
    n, slot, most = 0, 0, most_out(indptr) + 1
    while slot < target.size or n > 0:
        if n + most > f.size:
            f, s, e = grown(f), grown(s), grown(e)
        while slot < target.size and n + most <= f.size:
            if was[slot] < 0 or now[was[slot]] != slot:
                cost = come[source[slot]] + _least_cost(w, length, risk, edge, slot)
                if cost < come[target[slot]]:
                    come[target[slot]] = cost
                    n = push(f, s, e, n, cost, target[slot], -1)
            slot += 1
        while slot == target.size and 0 < n <= f.size - most:
            cost, i = f[0], s[0]
            n = pop(f, s, e, n)
            if cost > come[i]:
                continue
            for out in range(indptr[i], indptr[i + 1]):
                beyond = cost + _least_cost(w, length, risk, edge, out)
                if beyond < come[target[out]]:
                    come[target[out]] = beyond
                    n = push(f, s, e, n, beyond, target[out], -1)
    return come


@njit(cache=True)
def _least_cost(w, length, risk, edge, out) -> float:
    """What driving an edge forward costs, at least where it is not evaluated yet [m]."""
    known = not np.isnan(edge[out, 0])
    b, u = (edge[out, 0], edge[out, 1]) if known else (0.0, 0.0)
    return transition_cost(w, length[out], risk[out], b, u)


class Asked(NamedTuple):
    """What a search over pairs is asked for, as its kernels take it."""

    start: int
    is_end: NDArray[np.bool_]
    """(nodes,)"""
    exit_cost: NDArray[np.float64]
    """(nodes,) [m] that a route pays at its end: 0 at a goal; for frontiers the optimistic cost still to go."""
    start_yaw: float
    goal_yaw: float
    """Of the body [rad], NaN = any."""
    sweeps: bool
    """Turns count: the risk of their poses, `turning` [m/rad] and more over edges, and there must be room for them."""
    once: bool
    """No route comes back to the start: it is a pose, no node."""
    backward: float
    """An edge driven backward costs so many times as much, more over faces that are climbed forward only; inf: none is."""
    turning: float
    start_back: float
    """[m] more for a route that begins backward."""


class ToGo(NamedTuple):
    """A search backward from the ends: what it knows of each state, which it can go on with."""

    h: NDArray[np.float64]
    """(states,) cost from where each state ends over an end [m], inf: not reached. Exact but for the risk of turns where it is settled."""
    settled: NDArray[np.bool_]
    after: NDArray[np.int32]
    """(states,) the state that follows on that way, -1 = none: it ends there."""


class Heap(NamedTuple):
    """States by what a route over them costs at least [m]: the arrays of `planning.search.heap`."""

    f: NDArray[np.float64]
    s: NDArray[np.int64]
    e: NDArray[np.int64]
    n: int


@njit(cache=True)
def begin_to_go(arcs: Arcs, is_end: np.ndarray, exit_cost: np.ndarray) -> ToGo:
    """The states that end at an end, none settled yet. Arguments as in `cost_to_go`."""
    target = arcs.target
    states = 2 * target.size
    h = np.full(states, np.inf)
    for slot in range(target.size):
        k = target[slot]
        if is_end[k]:
            h[2 * slot] = h[2 * slot + 1] = exit_cost[k]
    return ToGo(h, np.zeros(states, np.bool_), np.full(states, -1, np.int32))


@njit(cache=True)
def reached(
    w: Weights, arcs: Arcs, tables: Tables, start: int, come: np.ndarray, backward: float, go: ToGo
) -> Heap:
    """All states that are reached and not settled. Arguments as in `cost_to_go`.

    Those out of the start become unsettled: when they are settled they tell what a route costs.
    """
    _, _, _, source, target, _, length, _, risk, _, _, forward_only = arcs
    edge = tables.edge
    h, settled = go.h, go.settled  # an access to a tuple in a loop counts references
    for out in range(arcs.indptr[start], arcs.indptr[start + 1]):
        settled[2 * out] = settled[2 * out + 1] = False
    count = 0
    for state in range(h.size):
        count += h[state] < np.inf and not settled[state]
    f, s, e = np.empty(count), np.empty(count, np.int64), np.empty(count, np.int64)
    n = 0
    for state in range(h.size):
        if settled[state] or h[state] == np.inf:
            continue
        out, way = state // 2, state % 2
        drive = drive_cost(w, length, risk, source, target, forward_only, edge, out, way, backward)
        n = push(f, s, e, n, h[state] + come[source[out]] + drive, state, 0)
    return Heap(f, s, e, n)


@njit(cache=True)
def cost_to_go(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    tables: Tables,
    asked: Asked,
    come: np.ndarray,
    go: ToGo,
    heap: Heap,
    limit: float,
) -> tuple[float, Heap]:
    """Go on settling states until each that may be on a route as cheap as `limit` [m] is settled: A* backward, without the risk of turns.

    With `limit` inf it stops at the cheapest route. Returns what that costs as far as it was seen (inf: none was), and what is left to settle.
    A state is twice the slot of an edge, plus one if it is driven backward; `come` is that of `cost_to_come`.
    A settled state to which a cheaper way comes up, on a graph that has changed, is settled anew.
    """
    work = scratch(sampler)
    x, y, indptr, source, target, reverse, length, heading, risk, room, turn_rate, forward_only = arcs
    edge = tables.edge
    start, is_end, _, start_yaw, goal_yaw, sweeps, once, backward, turning, start_back = asked
    ways = 1 if np.isinf(backward) else 2
    h, settled, after = go
    f, s, e, n = heap
    least, most = np.inf, ways * most_out(indptr) + 1
    while n > 0 and _due(f[0], limit, least):
        if n + most > f.size:
            f, s, e = grown(f), grown(s), grown(e)
        while 0 < n <= f.size - most and _due(f[0], limit, least):
            bound, state = f[0], s[0]
            n = pop(f, s, e, n)
            if settled[state]:
                continue
            out, way = state // 2, state % 2
            at, k = source[out], target[out]
            if np.isnan(edge[out, 0]):
                evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, out)
                dearer = (
                    h[state]
                    + come[at]
                    + drive_cost(w, length, risk, source, target, forward_only, edge, out, way, backward)
                )
                if dearer > bound:
                    n = push(f, s, e, n, dearer, state, 0)
                    continue
            settled[state] = True
            cost = h[state] + drive_cost(
                w, length, risk, source, target, forward_only, edge, out, way, backward
            )
            yaw = heading[out] + (np.pi if way else 0.0)
            if sweeps and is_end[k]:
                cost += last_turn(room[k], turn_rate[k], yaw, goal_yaw, turning)
            if at == start:
                whole = cost
                if sweeps:
                    whole += first_turn(room[at], turn_rate[at], start_yaw, yaw, turning) + way * start_back
                least = min(least, whole)
                if once:
                    continue
            for back in range(indptr[at], indptr[at + 1]):
                into = reverse[back]
                for before in range(ways):
                    to = 2 * into + before
                    if cost >= h[to]:
                        continue
                    new = cost
                    if sweeps:
                        new += turn_between(
                            room[at], turn_rate[at], heading, into, out, way != before, turning
                        )
                    if new >= h[to]:
                        continue
                    h[to], after[to], settled[to] = new, state, False
                    bound = (
                        new
                        + come[source[into]]
                        + drive_cost(
                            w, length, risk, source, target, forward_only, edge, into, before, backward
                        )
                    )
                    n = push(f, s, e, n, bound, to, 0)
    return least, Heap(f, s, e, n)


@njit(cache=True)
def _due(bound: float, limit: float, least: float) -> bool:
    return bound <= limit if limit < np.inf else bound < least


@njit(cache=True)
def drive_cost(w, length, risk, source, target, forward_only, edge, out, way, backward) -> float:
    """Cost of slot `out` without turns [m], in the best case where it is not evaluated yet."""
    known = not np.isnan(edge[out, 0])
    b, u = (edge[out, 0], edge[out, 1]) if known else (0.0, 0.0)
    step = transition_cost(w, length[out], risk[out], b, u)
    if way:
        return back_factor(backward, forward_only[source[out]], forward_only[target[out]]) * step
    return step


@njit(cache=True)
def turn_between(room, rate, heading, before, out, change, turning) -> float:
    """What the turn from slot `before` to slot `out` costs beyond its risk [m]; inf: no room. `change`: with the other end ahead after it."""
    d = turn_angle(heading[before], heading[out] + (np.pi if change else 0.0))
    return turn_cost(rate, d, turning) if turn_is_free(room, heading[before], d) else np.inf


@njit(cache=True)
def first_turn(room, rate, start_yaw, yaw, turning) -> float:
    """The same for the turn at the start, 0 where any heading (NaN) will do."""
    if np.isnan(start_yaw):
        return 0.0
    d = turn_angle(start_yaw, yaw)
    return turn_cost(rate, d, turning) if turn_is_free(room, start_yaw, d) else np.inf


@njit(cache=True)
def last_turn(room, rate, yaw, goal_yaw, turning) -> float:
    """The same for the turn at the goal."""
    if np.isnan(goal_yaw):
        return 0.0
    d = turn_angle(yaw, goal_yaw)
    return turn_cost(rate, d, turning) if may_turn_to(room, yaw, d) else np.inf
