"""A* over ordered pairs of nodes for the body-aware cost.

A state is a directed edge (i, j), driven forward or backward: twice its CSR slot, plus one if backward. Nearly all time goes into evaluating pose sets, so both
searches are lazy: what enters a queue has a lower bound of its cost, its pose sets are evaluated when it comes up, and
it goes back if that made it dearer. First a search over nodes, backwards from the goal, finds the cost to go without
turns; that bound lacks so little that the search over pairs then evaluates few turns. The optimum is the one of
Dijkstra over pairs; the bounds are never above the true cost. Evaluations are kept in tables, NaN = not yet. Paper:
eq. 3-5.
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
def cost_to_go(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    tables: Tables,
    start: int,
    is_end: np.ndarray,
    exit_cost: np.ndarray,
) -> np.ndarray:
    """(nodes,) lower bound of the cost from each node over an end to the goal, exact but for the turns: lazy A* backwards.

    It stops at the start. What was not settled by then costs, together with the straight line from the start, at
    least what the start costs; that is its bound, and the whole is still consistent. inf: no end can be reached.
    """
    work = scratch(sampler)
    x, y, indptr, source, target, reverse, length, _, risk, _, _, _ = arcs
    edge = tables.edge
    count = x.size
    h = np.full(count, np.inf)
    closed = np.zeros(count, np.bool_)
    f, s, e = np.empty(256), np.empty(256, np.int64), np.empty(256, np.int64)
    n = 0
    for i in range(count):
        if is_end[i]:
            h[i] = exit_cost[i]
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
            n = push(f, s, e, n, h[i] + np.hypot(x[i] - x[start], y[i] - y[start]), i, -1)
    while n > 0:
        i, via = s[0], e[0]
        n = pop(f, s, e, n)
        if closed[i]:
            continue
        if via >= 0:  # an edge not evaluated when it was pushed
            if np.isnan(edge[via, 0]):
                evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, via)
            cost = h[source[via]] + transition_cost(w, length[via], risk[via], edge[via, 0], edge[via, 1])
            if cost < h[i]:
                h[i] = cost
                n = push(f, s, e, n, cost + np.hypot(x[i] - x[start], y[i] - y[start]), i, -1)
            continue
        closed[i] = True
        if i == start:
            break
        for out in range(indptr[i], indptr[i + 1]):
            k = target[out]
            if closed[k]:
                continue
            known = not np.isnan(edge[out, 0])
            b, u = (edge[out, 0], edge[out, 1]) if known else (0.0, 0.0)
            cost = h[i] + transition_cost(w, length[out], risk[out], b, u)
            if cost >= h[k]:
                continue
            if known:
                h[k] = cost
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
            n = push(f, s, e, n, cost + np.hypot(x[k] - x[start], y[k] - y[start]), k, -1 if known else out)
    for i in range(count):
        if not closed[i]:
            h[i] = max(0.0, h[start] - np.hypot(x[i] - x[start], y[i] - y[start]))
    return h


@njit(cache=True)
def search_pairs(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    tables: Tables,
    start: int,
    is_end: np.ndarray,
    exit_cost: np.ndarray,
    start_yaw: float,
    goal_yaw: float,
    sweeps: bool,
    once: bool,
    backward: float,
    turning: float,
) -> tuple[float, np.ndarray, int, np.ndarray]:
    """Route over ordered pairs to the end node with the least cost plus `exit_cost` (nodes,).

    That is zero for a goal node; for frontiers it is the optimistic cost still to go. A yaw of NaN was not
    requested. With `once`, no route comes back to the start: it is a pose, no node. With `sweeps`, turns count, cost `turning` [m/rad] and more over edges, and are only made where there is room. An edge driven
    backward costs `backward` times as much (inf: none is), more over faces that are climbed forward only; yaws are the body's. The footprint is the same turned by half a turn,
    so an edge has one evaluation and a turn two: with the same end of the body ahead after it, or with the other.
    Returns the cost of the route (inf: none), its states, the number of expanded states, and `tables.turns`, which may have grown.
    """
    none = np.empty(0, np.int64)
    turns = tables.turns
    h = cost_to_go(sampler, w, arcs, tables, start, is_end, exit_cost)
    if np.isinf(h[start]):
        return np.inf, none, 0, turns
    work = scratch(sampler)
    x, y, indptr, source, target, reverse, length, heading, risk, room, turn_rate, forward_only = arcs
    edge, turn_at, _, _ = tables
    used = tables.used[0]
    states = 2 * target.size
    ways = 1 if np.isinf(backward) else 2
    best = np.full(states, np.inf)  # least evaluated cost of each state
    parent = np.full(states, -1, np.int64)
    closed = np.zeros(states, np.bool_)
    size = 256
    f, s, e = np.empty(size), np.empty(size, np.int64), np.empty(size, np.int64)
    # Queue entries: where the state was reached from, at what cost, and how far it is evaluated: not at all (0),
    # its edge (1), its edge and its turns (2).
    came, base, stage = np.empty(size, np.int64), np.empty(size), np.empty(size, np.int8)
    n = 0
    entries = 0
    expanded = 0
    state = -1
    at = start
    if once:
        for out in range(indptr[start], indptr[start + 1]):
            closed[2 * reverse[out]] = closed[2 * reverse[out] + 1] = True
    while True:
        g = 0.0 if state < 0 else best[state]
        expanded += 1
        for out in range(indptr[at], indptr[at + 1]):
            known = not np.isnan(edge[out, 0])
            b, u = (edge[out, 0], edge[out, 1]) if known else (0.0, 0.0)
            step = transition_cost(w, length[out], risk[out], b, u)
            for way in range(ways):
                to = 2 * out + way
                cost = g + step
                if way:
                    cost = g + back_factor(backward, forward_only[at], forward_only[target[out]]) * step
                if closed[to] or cost >= best[to]:
                    continue
                if entries == came.size:
                    came, base, stage = grown(came), grown(base), grown(stage)
                if n == f.size:
                    f, s, e = grown(f), grown(s), grown(e)
                came[entries], base[entries], stage[entries] = state, g, known
                n = push(f, s, e, n, cost + h[target[out]], to, entries)
                entries += 1
        # Take the most promising state and evaluate what its cost still lacks, until one is certain.
        state = -1
        while n > 0:
            bound, to, entry = f[0], s[0], e[0]
            n = pop(f, s, e, n)
            if to < 0:  # the way on from an end: nothing in the queue can be cheaper
                return best[entry], walk_back(parent, entry), expanded, turns
            if closed[to]:
                continue
            origin = came[entry]
            if stage[entry] == 2:
                if parent[to] != origin:
                    continue  # reached more cheaply in the meantime
                state = to
                break
            out, way = to // 2, to % 2
            at, k = source[out], target[out]
            factor = back_factor(backward, forward_only[at], forward_only[k]) if way else 1.0
            if np.isnan(edge[out, 0]):
                evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, out)
            b, u = edge[out, 0], edge[out, 1]
            cost = base[entry] + factor * transition_cost(w, length[out], risk[out], b, u)
            stage[entry] += 1
            if sweeps and (stage[entry] == 2 or cost + h[k] <= bound):
                stage[entry] = 2
                b2, u2 = 0.0, 0.0
                edges = 0.0
                yaw = heading[out] + (np.pi if way else 0.0)
                if origin >= 0:
                    came_by = origin // 2
                    if turn_at[came_by] < 0:
                        rows = 2 * (indptr[at + 1] - indptr[at])
                        while used + rows > len(turns):
                            turns = _more(turns)
                        turn_at[came_by] = used
                        used += rows
                        tables.used[0] = used
                    change = way != origin % 2
                    row = turn_at[came_by] + 2 * (out - indptr[at]) + change
                    d = turn_angle(heading[came_by], heading[out] + (np.pi if change else 0.0))
                    if np.isnan(turns[row, 0]):
                        if turn_is_free(room[at], heading[came_by], d):
                            turns[row] = turn_risk(sampler, work, w, x[at], y[at], heading[came_by], d)
                        else:
                            turns[row] = np.inf
                    b2, u2 = turns[row]
                    edges = turn_cost(turn_rate[at], d, turning)
                elif not np.isnan(start_yaw):
                    d = turn_angle(start_yaw, yaw)
                    b2, u2 = np.inf, 0.0
                    if turn_is_free(room[at], start_yaw, d):
                        b2, u2 = turn_risk(sampler, work, w, x[at], y[at], start_yaw, d)
                    edges = turn_cost(turn_rate[at], d, turning)
                b, u = max(b, b2), max(u, u2)
                if is_end[k] and not np.isnan(goal_yaw):
                    d = turn_angle(yaw, goal_yaw)
                    b2, u2 = np.inf, 0.0
                    if may_turn_to(room[k], yaw, d):
                        b2, u2 = turn_risk(sampler, work, w, x[k], y[k], yaw, d)
                    b, u = max(b, b2), max(u, u2)
                    edges += turn_cost(turn_rate[k], d, turning)
                cost = base[entry] + factor * transition_cost(w, length[out], risk[out], b, u) + edges
            elif not sweeps:
                stage[entry] = 2
            if not cost < best[to]:
                continue
            if stage[entry] == 2:
                best[to] = cost
                parent[to] = origin
            n = push(f, s, e, n, cost + h[k], to, entry)
        if state < 0:
            return np.inf, none, expanded, turns
        closed[state] = True
        at = target[state // 2]
        if is_end[at]:
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
            n = push(f, s, e, n, best[state] + exit_cost[at], -1, state)


@njit(cache=True)
def _more(turns: np.ndarray) -> np.ndarray:
    """`turns` with room for twice as many."""
    out = np.full((2 * len(turns), 2), np.nan)
    for row in range(len(turns)):
        out[row, 0], out[row, 1] = turns[row, 0], turns[row, 1]
    return out


@njit(cache=True)
def walk_back(parent: np.ndarray, last: int) -> np.ndarray:
    """States from the start to `last`."""
    count = 0
    k = last
    while k >= 0:
        count += 1
        k = parent[k]
    route = np.empty(count, np.int64)
    k = last
    for i in range(count - 1, -1, -1):
        route[i] = k
        k = parent[k]
    return route
