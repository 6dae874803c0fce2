"""A* over nodes for the native cost l (1 + sigma r), which knows no headings."""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.risk.arcs import Arcs
from planning.risk.cost import Weights, transition_cost
from planning.search.heap import ONE, ZERO, grown, most_out, pop, push


@njit(cache=True)
def search_nodes(
    w: Weights, arcs: Arcs, start: int, is_end: np.ndarray, exit_cost: np.ndarray, gx: float, gy: float
) -> tuple[float, np.ndarray, int]:
    """Route to the end node with the least cost plus `exit_cost` (nodes,).

    No exit costs less than the way to (gx, gy) is long. Returns what `search_pairs` does.
    """
    x, y, indptr, source, target, _, length, _, risk, _, price, _ = arcs
    count = x.size
    g = np.full(count, np.inf)
    parent = np.full(count, -1, np.int64)
    closed = np.zeros(count, np.bool_)
    f, s, e = np.empty(64), np.empty(64, np.int64), np.empty(64, np.int64)
    goal = -1
    g[start] = 0.0
    n = push(f, s, e, ZERO, 0.0, np.int64(start), ZERO)
    expanded, most = 0, most_out(indptr) + 1
    while n > 0 and goal < 0:
        if n + most > f.size:
            f, s, e = grown(f), grown(s), grown(e)
        while 0 < n <= f.size - most:
            i = s[0]
            leave = e[0] == 1
            n = pop(f, s, e, n)
            if leave:
                goal = i
                break
            if closed[i]:
                continue
            closed[i] = True
            expanded += 1
            if is_end[i]:
                n = push(f, s, e, n, g[i] + exit_cost[i], i, ONE)
            for out in range(indptr[i], indptr[i + 1]):
                k = target[out]
                cost = g[i] + transition_cost(w, length[out], risk[out], 0.0, 0.0) + price[out, 0]
                if not closed[k] and cost < g[k]:
                    g[k] = cost
                    parent[k] = out
                    n = push(f, s, e, n, cost + np.hypot(gx - x[k], gy - y[k]), np.int64(k), ZERO)
    if goal < 0:
        return np.inf, np.empty(0, np.int64), expanded
    steps = 0
    i = goal
    while i != start:
        steps += 1
        i = source[parent[i]]
    route = np.empty(steps, np.int64)
    i = goal
    for k in range(steps - 1, -1, -1):
        route[k] = parent[i]
        i = source[parent[i]]
    return g[goal], route, expanded
