"""Lower bounds that guide the search over pairs: what it costs to come to a node, and from a state to the goal.

Nearly all time of a query goes into evaluating pose sets, those of turns above all, and each state a search expands has
about twenty turns. So two searches that evaluate no turn come first. Both are exact in what they count; their results
are never above the true cost, and consistent.
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
from planning.risk.turns import may_turn_to, turn_cost
from planning.search.heap import NONE, ZERO, grown, most_out, pop, push


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

    No `exit_cost` (nodes,) is less than the way to (gx, gy) is long. The search stops at the best end. What was not
    settled by then costs, together with the straight line to (gx, gy), at least as much; that is its bound. inf: no end
    can be reached.
    """
    work = scratch(sampler)
    x, y, indptr, source, target, reverse, length, _, risk, _, price, _ = arcs
    edge = tables.edge
    count = x.size
    g = np.full(count, np.inf)
    closed = np.zeros(count, np.bool_)
    f, s, e = np.empty(256), np.empty(256, np.int64), np.empty(256, np.int64)
    g[start] = 0.0
    n = push(f, s, e, ZERO, np.hypot(gx - x[start], gy - y[start]), np.int64(start), NONE)
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
                cost = g[source[via]] + least_cost(w, length, risk, price, edge, via)
                if cost < g[i]:
                    g[i] = cost
                    n = push(f, s, e, n, cost + np.hypot(gx - x[i], gy - y[i]), i, NONE)
                continue
            closed[i] = True
            if is_end[i]:
                n = push(f, s, e, n, g[i] + exit_cost[i], NONE, NONE)
            for out in range(indptr[i], indptr[i + 1]):
                k = target[out]
                if closed[k]:
                    continue
                known = not np.isnan(edge[out, 0])
                cost = g[i] + least_cost(w, length, risk, price, edge, out)
                if cost >= g[k]:
                    continue
                if known:
                    g[k] = cost
                n = push(
                    f, s, e, n, cost + np.hypot(gx - x[k], gy - y[k]), np.int64(k), NONE if known else out
                )
    for i in range(count):
        if not closed[i]:
            g[i] = max(0.0, total - np.hypot(gx - x[i], gy - y[i]))
    return total, g


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
    """Turns count: the risk of their poses, `turning` [m/rad] and their price, and there must be room for them."""
    once: bool
    """No route comes back to the start: it is a pose, no node."""
    backward: float
    """An edge driven backward costs so many times as much, and its own price; inf: none is."""
    turning: float


class ToGo(NamedTuple):
    """A search backward from the ends: what it knows of each state."""

    h: NDArray[np.float64]
    """(states,) cost from where each state ends over an end [m], inf: not reached. Exact but for the risk of turns
    where it is settled."""
    settled: NDArray[np.bool_]
    """(states,)"""


class Heap(NamedTuple):
    """States by what a route over them costs at least [m]: the arrays of `planning.search.heap`."""

    f: NDArray[np.float64]
    s: NDArray[np.int64]
    e: NDArray[np.int64]
    n: int


@njit(cache=True)
def begin_to_go(
    w: Weights,
    arcs: Arcs,
    tables: Tables,
    is_end: np.ndarray,
    exit_cost: np.ndarray,
    come: np.ndarray,
    backward: float,
) -> tuple[ToGo, Heap]:
    """The states that end at an end, none settled yet, and the heap of them. Arguments as in `cost_to_go`."""
    _, _, indptr, source, target, reverse, length, _, risk, _, price, _ = arcs
    edge = tables.edge
    h = np.full(2 * target.size, np.inf)
    count = 0
    for k in range(is_end.size):
        if is_end[k]:
            count += 2 * (indptr[k + 1] - indptr[k])
    f, s, e = np.empty(count), np.empty(count, np.int64), np.empty(count, np.int64)
    n = ZERO
    for k in range(is_end.size):
        if not is_end[k]:
            continue
        for back in range(indptr[k], indptr[k + 1]):
            out = reverse[back]
            for way in range(2):
                h[2 * out + way] = exit_cost[k]
                drive = drive_cost(w, length, risk, price, edge, out, way, backward)
                n = push(f, s, e, n, exit_cost[k] + come[source[out]] + drive, 2 * out + way, ZERO)
    return ToGo(h, np.zeros(h.size, np.bool_)), Heap(f, s, e, n)


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
    """Go on settling states until each that may be on a route as cheap as `limit` [m] is settled: A* backward, without
    the risk of turns.

    With `limit` inf it stops at the cheapest route. Returns what that costs as far as it was seen (inf: none was), and
    what is left to settle. A state is twice the slot of an edge, plus one if it is driven backward; `come` is that of
    `cost_to_come`.
    """
    work = scratch(sampler)
    x, y, indptr, source, target, reverse, length, heading, risk, room, price, turn_price = arcs
    edge = tables.edge
    start, is_end, _, start_yaw, goal_yaw, sweeps, once, backward, turning = asked
    ways = 1 if np.isinf(backward) else 2
    h, settled = go
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
                dearer = h[state] + come[at] + drive_cost(w, length, risk, price, edge, out, way, backward)
                if dearer > bound:
                    n = push(f, s, e, n, dearer, state, ZERO)
                    continue
            settled[state] = True
            cost = h[state] + drive_cost(w, length, risk, price, edge, out, way, backward)
            yaw = heading[out] + (np.pi if way else 0.0)
            if sweeps and is_end[k]:
                cost += last_turn(room[k], turn_price[k], yaw, goal_yaw, turning)
            if at == start:
                whole = cost
                if sweeps:
                    whole += first_turn(room[at], turn_price[at], start_yaw, yaw, turning)
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
                            room[at], turn_price[at], heading, into, out, way != before, turning
                        )
                    if new >= h[to]:
                        continue
                    h[to], settled[to] = new, False
                    drive = drive_cost(w, length, risk, price, edge, into, before, backward)
                    bound = new + come[source[into]] + drive
                    n = push(f, s, e, n, bound, to, ZERO)
    return least, Heap(f, s, e, n)


@njit(cache=True)
def _due(bound: float, limit: float, least: float) -> bool:
    return bound <= limit if limit < np.inf else bound < least


@njit(cache=True)
def drive_cost(w, length, risk, price, edge, out, way, backward) -> float:
    """Cost of slot `out` without turns [m], in the best case where it is not evaluated yet."""
    known = not np.isnan(edge[out, 0])
    b, u = (edge[out, 0], edge[out, 1]) if known else (0.0, 0.0)
    step = transition_cost(w, length[out], risk[out], b, u)
    return (backward * step if way else step) + price[out, way]


@njit(cache=True)
def least_cost(w, length, risk, price, edge, out) -> float:
    """The same, driven the way that costs less."""
    known = not np.isnan(edge[out, 0])
    b, u = (edge[out, 0], edge[out, 1]) if known else (0.0, 0.0)
    return transition_cost(w, length[out], risk[out], b, u) + min(price[out, 0], price[out, 1])


@njit(cache=True)
def turn_between(room, price, heading, before, out, change, turning) -> float:
    """What the turn from slot `before` to slot `out` costs beyond its risk [m]; inf: no room. `change`: with the other
    end ahead after it."""
    d = turn_angle(heading[before], heading[out] + (np.pi if change else 0.0))
    return turn_cost(price[0], price[1], d, turning) if turn_is_free(room, heading[before], d) else np.inf


@njit(cache=True)
def first_turn(room, price, start_yaw, yaw, turning) -> float:
    """The same for the turn at the start, 0 where any heading (NaN) will do."""
    if np.isnan(start_yaw):
        return 0.0
    d = turn_angle(start_yaw, yaw)
    return turn_cost(price[0], price[1], d, turning) if turn_is_free(room, start_yaw, d) else np.inf


@njit(cache=True)
def last_turn(room, price, yaw, goal_yaw, turning) -> float:
    """The same for the turn at the goal."""
    if np.isnan(goal_yaw):
        return 0.0
    d = turn_angle(yaw, goal_yaw)
    return turn_cost(price[0], price[1], d, turning) if may_turn_to(room, yaw, d) else np.inf
