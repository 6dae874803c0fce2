"""A* over nodes for the native cost l (1 + sigma r), which knows no headings."""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.risk.arcs import Arcs
from planning.risk.cost import Weights, transition_cost
from planning.search.heap import grown, pop, push


@njit(cache=True)
def search_nodes(
    w: Weights, arcs: Arcs, start: int, is_end: np.ndarray, exit_cost: np.ndarray, gx: float, gy: float
) -> tuple[float, np.ndarray, int]:
    """Route to the end node with the least cost plus `exit_cost` (nodes,).

    No exit costs less than the way to (gx, gy) is long. Returns what `search_pairs` does.
    """
    count = arcs.x.size
    g = np.full(count, np.inf)
    parent = np.full(count, -1, np.int64)
    closed = np.zeros(count, np.bool_)
    f, s, e = np.empty(64), np.empty(64, np.int64), np.empty(64, np.int64)
    goal = -1
    g[start] = 0.0
    n = push(f, s, e, 0, 0.0, start, 0)
    expanded = 0
    while n > 0:
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
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
            n = push(f, s, e, n, g[i] + exit_cost[i], i, 1)
        for out in range(arcs.indptr[i], arcs.indptr[i + 1]):
            k = arcs.target[out]
            cost = g[i] + transition_cost(w, arcs.length[out], arcs.risk[out], 0.0, 0.0)
            if not closed[k] and cost < g[k]:
                g[k] = cost
                parent[k] = out
                if n == f.size:
                    f, s, e = grown(f), grown(s), grown(e)
                n = push(f, s, e, n, cost + np.hypot(gx - arcs.x[k], gy - arcs.y[k]), k, 0)
    if goal < 0:
        return np.inf, np.empty(0, np.int64), expanded
    steps = 0
    i = goal
    while i != start:
        steps += 1
        i = arcs.source[parent[i]]
    route = np.empty(steps, np.int64)
    i = goal
    for k in range(steps - 1, -1, -1):
        route[k] = parent[i]
        i = arcs.source[parent[i]]
    return g[goal], route, expanded
