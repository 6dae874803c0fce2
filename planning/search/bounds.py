"""Lower bounds that guide the search over pairs: what it costs to come to a node, and from a state to the goal.

Nearly all time of a query goes into evaluating pose sets, those of turns above all, and each state a search expands has about
twenty turns. So two searches that evaluate no turn come first. Both are exact in what they count; their results are
never above the true cost, and consistent.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.graph.describe import turn_is_free
from planning.risk.arcs import Arcs
from planning.risk.cost import Weights, transition_cost
from planning.risk.footprint import scratch
from planning.risk.pose_sets import turn_angle, turn_risk
from planning.risk.tables import Tables, evaluate_edge
from planning.risk.terrain import Sampler
from planning.risk.turns import back_factor, may_turn_to, turn_cost
from planning.search.heap import grown, pop, push


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
    total = np.inf
    while n > 0:
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
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
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
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
            n = push(f, s, e, n, cost + np.hypot(gx - x[k], gy - y[k]), k, -1 if known else out)
    for i in range(count):
        if not closed[i]:
            g[i] = max(0.0, total - np.hypot(gx - x[i], gy - y[i]))
    return total, g


@njit(cache=True)
def cost_to_go(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    tables: Tables,
    start: int,
    is_end: np.ndarray,
    exit_cost: np.ndarray,
    come: np.ndarray,
    start_yaw: float,
    goal_yaw: float,
    sweeps: bool,
    ways: int,
    once: bool,
    backward: float,
    turning: float,
) -> tuple[float, np.ndarray]:
    """A cost that the best route does not exceed, and (states,) from where each state ends over an end, exact but for the risk of turns: A* backwards.

    A state is twice the slot of an edge, plus one if it is driven backward; `come` is that of `cost_to_come`, the rest as in
    `planning.search.pairs.search_pairs`. The route that is found so, with the risk of its turns, is an upper bound. A state that
    cannot be on a route as cheap as that gets inf, and so do all where there is no route: the bound is inf then.
    """
    work = scratch(sampler)
    x, y, indptr, source, target, reverse, length, heading, risk, room, turn_rate, forward_only = arcs
    edge = tables.edge
    h = np.full(2 * target.size, np.inf)
    after = np.full(h.size, -1, np.int32)
    closed = np.zeros(h.size, np.bool_)
    f, s, e = np.empty(256), np.empty(256, np.int64), np.empty(256, np.int64)
    n = 0
    for i in range(x.size):
        if not is_end[i]:
            continue
        for out in range(indptr[i], indptr[i + 1]):
            into = reverse[out]
            for way in range(ways):
                h[2 * into + way] = exit_cost[i]
                if n == f.size:
                    f, s, e = grown(f), grown(s), grown(e)
                bound = (
                    exit_cost[i]
                    + come[source[into]]
                    + _drive(w, length, risk, source, target, forward_only, edge, into, way, backward)
                )
                n = push(f, s, e, n, bound, 2 * into + way, 0)
    least, first = np.inf, -1
    limit = np.inf
    while n > 0 and f[0] <= limit:
        bound, state = f[0], s[0]
        n = pop(f, s, e, n)
        if state < 0:
            if limit == np.inf:
                most = route_cost(
                    sampler,
                    work,
                    w,
                    arcs,
                    edge,
                    after,
                    first,
                    start_yaw,
                    goal_yaw,
                    is_end,
                    exit_cost,
                    sweeps,
                    backward,
                    turning,
                )
                limit = most + 1e-9 * max(1.0, most)  # sums in another order
            continue
        if closed[state]:
            continue
        out, way = state // 2, state % 2
        at, k = source[out], target[out]
        if np.isnan(edge[out, 0]):
            evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, out)
            dearer = (
                h[state]
                + come[at]
                + _drive(w, length, risk, source, target, forward_only, edge, out, way, backward)
            )
            if dearer > bound:
                n = push(f, s, e, n, dearer, state, 0)
                continue
        closed[state] = True
        cost = h[state] + _drive(w, length, risk, source, target, forward_only, edge, out, way, backward)
        yaw = heading[out] + (np.pi if way else 0.0)
        if sweeps and is_end[k]:
            cost += last_turn(room[k], turn_rate[k], yaw, goal_yaw, turning)
        if at == start:
            whole = cost
            if sweeps:
                whole += first_turn(room[at], turn_rate[at], start_yaw, yaw, turning)
            if whole < least:
                least, first = whole, state
                if n == f.size:
                    f, s, e = grown(f), grown(s), grown(e)
                n = push(f, s, e, n, whole, -1, 0)
            if once:
                continue
        for back in range(indptr[at], indptr[at + 1]):
            into = reverse[back]
            for before in range(ways):
                to = 2 * into + before
                if closed[to] or cost >= h[to]:
                    continue
                new = cost
                if sweeps:
                    new += turn_between(room[at], turn_rate[at], heading, into, out, way != before, turning)
                if new >= h[to]:
                    continue
                h[to], after[to] = new, state
                if n == f.size:
                    f, s, e = grown(f), grown(s), grown(e)
                bound = (
                    new
                    + come[source[into]]
                    + _drive(w, length, risk, source, target, forward_only, edge, into, before, backward)
                )
                n = push(f, s, e, n, bound, to, 0)
    for state in range(h.size):
        if not closed[state]:
            h[state] = np.inf
    return limit, h


@njit(cache=True)
def route_cost(
    sampler,
    work,
    w,
    arcs,
    edge,
    after,
    first,
    start_yaw,
    goal_yaw,
    is_end,
    exit_cost,
    sweeps,
    backward,
    turning,
) -> float:
    """Cost [m] of the route that begins with state `first`, goes on with the state `after` each, the risk of turns included."""
    x, y, _, source, target, _, length, heading, risk, room, turn_rate, forward_only = arcs
    g = 0.0
    came, state = -1, first
    while state >= 0:
        out, way = state // 2, state % 2
        at, k = source[out], target[out]
        b, u = edge[out, 0], edge[out, 1]
        turned = 0.0
        yaw = heading[out] + (np.pi if way else 0.0)
        if sweeps and came >= 0:
            change = way != came % 2
            turned = turn_between(room[at], turn_rate[at], heading, came // 2, out, change, turning)
            d = turn_angle(heading[came // 2], heading[out] + (np.pi if change else 0.0))
            b2, u2 = turn_risk(sampler, work, w, x[at], y[at], heading[came // 2], d)
            b, u = max(b, b2), max(u, u2)
        elif sweeps and not np.isnan(start_yaw):
            turned = first_turn(room[at], turn_rate[at], start_yaw, yaw, turning)
            b2, u2 = turn_risk(sampler, work, w, x[at], y[at], start_yaw, turn_angle(start_yaw, yaw))
            b, u = max(b, b2), max(u, u2)
        if sweeps and is_end[k] and not np.isnan(goal_yaw):
            turned += last_turn(room[k], turn_rate[k], yaw, goal_yaw, turning)
            b2, u2 = turn_risk(sampler, work, w, x[k], y[k], yaw, turn_angle(yaw, goal_yaw))
            b, u = max(b, b2), max(u, u2)
        factor = back_factor(backward, forward_only[at], forward_only[k]) if way else 1.0
        g += factor * transition_cost(w, length[out], risk[out], b, u) + turned
        came, state = state, after[state]
    return g + exit_cost[target[came // 2]]


@njit(cache=True)
def _drive(w, length, risk, source, target, forward_only, edge, out, way, backward) -> float:
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
