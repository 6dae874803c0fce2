"""A* over ordered pairs of nodes for the body-aware cost.

A state is a directed edge (i, j), driven forward or backward: twice its CSR slot, plus one if backward. Nearly all time
goes into evaluating pose sets, so the search is lazy: what enters the queue has a lower bound of its cost, its pose
sets are evaluated when it comes up, and it goes back if that made it dearer. Two searches without the pose sets of
turns come first (`planning.search.bounds`): what is left of their bound is only the risk of turns, so few turns are
evaluated. The optimum is the one of Dijkstra over pairs; the bounds are never above the true cost. Evaluations are kept
in tables, NaN = not yet. Paper: eq. 3-5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.risk.arcs import Arcs
from planning.risk.cost import Weights, transition_cost
from planning.risk.footprint import scratch
from planning.risk.pose_sets import evaluate_poses, turn_angle
from planning.risk.tables import Tables, evaluate_edge
from planning.risk.terrain import Sampler
from planning.search.bounds import (
    Asked,
    Heap,
    ToGo,
    begin_to_go,
    cost_to_come,
    cost_to_go,
    drive_cost,
    first_turn,
    last_turn,
    turn_between,
)
from planning.search.heap import NONE, ZERO, grown, most_out, pop, push

REACHED, CLOSED = 1, 2
"""What a search has done with a state: found a way to it, and gone on from it."""


class Guide(NamedTuple):
    """The bounds of one query. A search without some of the turns may be led by those of the search with them: they are
    never above its costs."""

    arcs: Arcs
    come: NDArray[np.float64]
    """See `cost_to_come`."""
    go: ToGo
    heap: Heap
    least: float
    """[m] A route costs at least so much, and each state that may be on one that costs no more is settled; inf: there
    is none."""


def guide_to(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    tables: Tables,
    asked: Asked,
    gx: float,
    gy: float,
) -> Guide:
    """The bounds for `asked`, no `Asked.exit_cost` of which is less than the way to (gx, gy) is long."""
    is_end, exit_cost = asked.is_end, asked.exit_cost
    total, come = cost_to_come(sampler, w, arcs, tables, asked.start, is_end, exit_cost, gx, gy)
    go, heap = begin_to_go(w, arcs, tables, is_end, exit_cost, come, asked.backward)
    if np.isinf(total):
        return Guide(arcs, come, go, heap, np.inf)
    least, heap = cost_to_go(sampler, w, arcs, tables, asked, come, go, heap, np.inf)
    if least < np.inf:  # sums in another order: states on the cheapest route may seem dearer than it
        _, heap = cost_to_go(sampler, w, arcs, tables, asked, come, go, heap, _nearly(least))
    return Guide(arcs, come, go, heap, least)


def _nearly(cost: float) -> float:
    return cost + 1e-9 * max(1.0, cost)


def search_pairs(
    sampler: Sampler, w: Weights, arcs: Arcs, tables: Tables, asked: Asked, guide: Guide
) -> tuple[float, np.ndarray, int, np.ndarray, Guide]:
    """Route over ordered pairs to the end node with the least cost plus `Asked.exit_cost`. `guide` may be of arcs with
    more room to turn.

    The footprint is the same turned by half a turn, so an edge has one evaluation and a turn two: with the same end of
    the body ahead after it, or with the other. Returns the cost of the route (inf: none over the states that `guide`
    settled), its states, the number of expanded states, `tables.turns`, which may have
    grown, and the guide, which knows more.
    """
    # The best route over what the search for any route settles is one of all routes: no state matters that cannot be on
    # a cheaper one.
    before, come, go, heap, least = guide
    limit, cost, route, expanded, turns = np.inf, np.inf, np.empty(0, np.int64), 0, tables.turns
    for _ in range(2):
        if np.isinf(least):
            break
        cost, route, expanded, turns = _forward(sampler, w, arcs, tables, turns, asked, go, limit)
        limit = _nearly(cost)
        if np.isinf(cost) or heap.n == 0 or heap.f[0] > limit:
            break
        _, heap = cost_to_go(sampler, w, before, tables, asked, come, go, heap, limit)
    return cost, route, expanded, turns, Guide(before, come, go, heap, least)


@njit(cache=True)
def _forward(
    sampler: Sampler,
    w: Weights,
    arcs: Arcs,
    tables: Tables,
    turns: np.ndarray,
    asked: Asked,
    go: ToGo,
    limit: float,
) -> tuple[float, np.ndarray, int, np.ndarray]:
    """The best route over settled states, none of which is looked at where it makes a route dearer than `limit`. Result
    as of `search_pairs`."""
    start, is_end, exit_cost, start_yaw, goal_yaw, sweeps, once, backward, turning = asked
    ways = 1 if np.isinf(backward) else 2
    none = np.empty(0, np.int64)
    h, settled = go.h, go.settled
    work = scratch(sampler)
    x, y, indptr, source, target, reverse, length, heading, risk, room, price, turn_price = arcs
    edge, turn_at, _, _ = tables
    used = tables.used[0]
    states = 2 * target.size
    been = np.zeros(states, np.int8)
    # Least evaluated cost of each state and the one before it; not filled, as a search comes to one state of a hundred
    # on a large map.
    best, parent = np.empty(states), np.empty(states, np.int64)
    size = 256
    f, s, e = np.empty(size), np.empty(size, np.int64), np.empty(size, np.int64)
    # Queue entries: where the state was reached from, at what cost, and how far it is evaluated: not at all (0),
    # its edge (1), its edge and its turns (2).
    came, base, stage = np.empty(size, np.int64), np.empty(size), np.empty(size, np.int8)
    extra = np.empty(size)  # what the turns of the entry cost beyond the risk of their pose sets
    n, entries, state = ZERO, ZERO, NONE
    expanded = 0
    at = start
    if once:
        for out in range(indptr[start], indptr[start + 1]):
            been[2 * reverse[out]] = been[2 * reverse[out] + 1] = CLOSED
    most = 2 * most_out(indptr) + 1
    picking = False
    while True:
        if entries + most > came.size:
            came, base, stage, extra = grown(came), grown(base), grown(stage), grown(extra)
        if n + most > f.size:
            f, s, e = grown(f), grown(s), grown(e)
        if used + most > len(turns):
            turns = _more(turns)
        while entries + most <= came.size and n + most <= f.size and used + most <= len(turns):
            if not picking:
                g = 0.0 if state < 0 else best[state]
                expanded += 1
                for out in range(indptr[at], indptr[at + 1]):
                    k = target[out]
                    known = not np.isnan(edge[out, 0])
                    for way in range(ways):
                        to = 2 * out + way
                        if been[to] == CLOSED or not settled[to]:
                            continue
                        least = best[to] if been[to] == REACHED else np.inf
                        cost = g + drive_cost(w, length, risk, price, edge, out, way, backward)
                        if cost >= least:
                            continue
                        turned = 0.0
                        if sweeps:
                            # What turning costs is known without a look at the ground: it is part of the bound from the
                            # beginning.
                            yaw = heading[out] + (np.pi if way else 0.0)
                            if state >= 0:
                                change = way != state % 2
                                turned = turn_between(
                                    room[at], turn_price[at], heading, state // 2, out, change, turning
                                )
                            else:
                                turned = first_turn(room[at], turn_price[at], start_yaw, yaw, turning)
                            if is_end[k]:
                                turned += last_turn(room[k], turn_price[k], yaw, goal_yaw, turning)
                            cost += turned
                        if cost >= least or cost + h[to] > limit:
                            continue
                        came[entries], base[entries], stage[entries], extra[entries] = state, g, known, turned
                        n = push(f, s, e, n, cost + h[to], to, entries)
                        entries += 1
                picking, state = True, -1
            # Take the most promising state and evaluate what its cost still lacks, until one is certain.
            while n > 0 and used + most <= len(turns):
                bound, to, entry = f[0], s[0], e[0]
                n = pop(f, s, e, n)
                if to < 0:  # the way on from an end: nothing in the queue can be cheaper
                    return best[entry], walk_back(parent, entry), expanded, turns
                if been[to] == CLOSED:
                    continue
                origin = came[entry]
                if stage[entry] == 2:
                    if parent[to] != origin:
                        continue  # reached more cheaply in the meantime
                    state = to
                    break
                out, way = to // 2, to % 2
                at, k = source[out], target[out]
                factor = backward if way else 1.0
                if np.isnan(edge[out, 0]):
                    evaluate_edge(sampler, work, w, x, y, source, target, reverse, edge, out)
                b, u, fixed = edge[out, 0], edge[out, 1], base[entry] + price[out, way] + extra[entry]
                cost = fixed + factor * transition_cost(w, length[out], risk[out], b, u)
                stage[entry] += 1
                if sweeps and (stage[entry] == 2 or cost + h[to] <= bound):
                    stage[entry] = 2
                    yaw = heading[out] + (np.pi if way else 0.0)
                    if origin >= 0:
                        came_by = origin // 2
                        if turn_at[came_by] < 0:
                            rows = 2 * (indptr[at + 1] - indptr[at])
                            turn_at[came_by] = used
                            used += rows
                            tables.used[0] = used
                        change = way != origin % 2
                        row = turn_at[came_by] + 2 * (out - indptr[at]) + change
                        if np.isnan(turns[row, 0]):
                            d = turn_angle(heading[came_by], heading[out] + (np.pi if change else 0.0))
                            b2, u2 = evaluate_poses(
                                sampler, work, w, x[at], y[at], heading[came_by], 0.0, 0.0, d, work.moments
                            )
                            turns[row, 0], turns[row, 1] = b2, u2
                        b, u = max(b, turns[row, 0]), max(u, turns[row, 1])
                    elif not np.isnan(start_yaw):
                        d = turn_angle(start_yaw, yaw)
                        b2, u2 = evaluate_poses(
                            sampler, work, w, x[at], y[at], start_yaw, 0.0, 0.0, d, work.moments
                        )
                        b, u = max(b, b2), max(u, u2)
                    if is_end[k] and not np.isnan(goal_yaw):
                        d = turn_angle(yaw, goal_yaw)
                        b2, u2 = evaluate_poses(sampler, work, w, x[k], y[k], yaw, 0.0, 0.0, d, work.moments)
                        b, u = max(b, b2), max(u, u2)
                    cost = fixed + factor * transition_cost(w, length[out], risk[out], b, u)
                elif not sweeps:
                    stage[entry] = 2
                if not cost < (best[to] if been[to] == REACHED else np.inf):
                    continue
                if stage[entry] == 2:
                    best[to], parent[to], been[to] = cost, origin, REACHED
                n = push(f, s, e, n, cost + h[to], to, entry)
            if state < 0 and n > 0:
                break  # it goes on with picking
            if state < 0:
                return np.inf, none, expanded, turns
            been[state] = CLOSED
            at, picking = target[state // 2], False
            if is_end[at]:
                n = push(f, s, e, n, best[state] + exit_cost[at], NONE, state)


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
