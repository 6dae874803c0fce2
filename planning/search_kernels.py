"""A* kernels: plain over nodes for the native cost, over ordered pairs of nodes for the body-aware cost.

A state of the pair search is a directed edge (i, j), named by its CSR slot. Nearly all time goes into evaluating pose
sets, so the search is lazy: a state first enters the queue with a lower bound of its cost, its pose sets are evaluated
when it comes up, and it goes back if that made it dearer. The optimum is the same; the bounds are never above the
true cost. Evaluations are kept in tables, NaN = not evaluated yet. Paper: eq. 3-5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planning.footprint import Scratch, features_of, scratch
from planning.terrain import Laid


class Weights(NamedTuple):
    """`BodyModel` as plain numbers for the kernels."""

    scale: NDArray[np.float64]
    """(4,) divisors of the features."""
    clip: float
    mean: float
    tail: float
    native: float
    body: float
    unknown: float
    edge_step: float
    sweep_step: float
    """[rad]"""


class Roads(NamedTuple):
    """The graph as the kernels take it; one slot per directed edge."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    indptr: NDArray[np.int64]
    source: NDArray[np.int32]
    target: NDArray[np.int32]
    reverse: NDArray[np.int64]
    """Slot of the opposite direction."""
    length: NDArray[np.float64]
    heading: NDArray[np.float64]
    """Heading source -> target [rad]."""
    risk: NDArray[np.float32]
    sweep_ptr: NDArray[np.int64]
    """Row of each slot in the sweep table: one column per edge that leaves its target."""


class Tables(NamedTuple):
    """Evaluated pose sets: body term B and unknown term U; NaN = not yet."""

    edge: NDArray[np.float64]
    """(slots, 2)"""
    sweep: NDArray[np.float64]
    """(sum of degrees over slots, 2)"""
    low: NDArray[np.float64]
    """(slots, 2) lower bounds of `edge` from two of its poses."""


@njit(cache=True)
def push(f: np.ndarray, s: np.ndarray, e: np.ndarray, n: int, nf: float, ns: int, ne: int) -> int:
    """Add (nf, ns, ne) to a binary heap ordered by f, then s; returns the new size."""
    i = n
    while i > 0:
        p = (i - 1) >> 1
        if f[p] < nf or (f[p] == nf and s[p] <= ns):
            break
        f[i], s[i], e[i] = f[p], s[p], e[p]
        i = p
    f[i], s[i], e[i] = nf, ns, ne
    return n + 1


@njit(cache=True)
def pop(f: np.ndarray, s: np.ndarray, e: np.ndarray, n: int) -> int:
    """Remove the root (the caller has read it); returns the new size."""
    n -= 1
    nf, ns, ne = f[n], s[n], e[n]
    i = 0
    while True:
        c = 2 * i + 1
        if c >= n:
            break
        r = c + 1
        if r < n and (f[r] < f[c] or (f[r] == f[c] and s[r] < s[c])):
            c = r
        if nf < f[c] or (nf == f[c] and ns <= s[c]):
            break
        f[i], s[i], e[i] = f[c], s[c], e[c]
        i = c
    f[i], s[i], e[i] = nf, ns, ne
    return n


@njit(cache=True)
def grown(a: np.ndarray) -> np.ndarray:
    """`a` with room for twice as many."""
    out = np.empty(2 * a.size, a.dtype)
    out[: a.size] = a
    return out


@njit(cache=True)
def turn(yaw_in: float, yaw_out: float) -> float:
    """Shortest signed rotation [rad]; a half turn goes by +pi."""
    d = (yaw_out - yaw_in + np.pi) % (2.0 * np.pi) - np.pi
    return d + 2.0 * np.pi if d < -np.pi + 1e-9 else d


@njit(cache=True)
def set_moments(
    laid: Laid,
    work: Scratch,
    w: Weights,
    x: float,
    y: float,
    yaw: float,
    dx: float,
    dy: float,
    dyaw: float,
    n: int,
    out: np.ndarray,
) -> None:
    """Mean `out[0]` and tail mean `out[1]` (4,) of the scaled features of `n` poses, both ends in (eq. 3).

    `out[2]` is the largest value of each feature as it is, neither scaled nor clipped.

    The poses go from (x, y, yaw) to (x + dx, y + dy, yaw + dyaw). The tail is the ceil(n / 10) largest values.
    """
    k = max(1, (n + 9) // 10)
    poses = np.empty((n, 3))
    for i in range(n):
        t = i / (n - 1) if n > 1 else 0.0
        poses[i, 0] = x + t * dx
        poses[i, 1] = y + t * dy
        poses[i, 2] = yaw + t * dyaw
    values = np.empty((n, 4))
    features_of(laid, work, poses, values)
    out[2] = 0.0
    for i in range(n):
        for m in range(4):
            out[2, m] = max(out[2, m], values[i, m])
            values[i, m] /= w.scale[m]
            if m < 3:
                values[i, m] = min(w.clip, values[i, m])
    for m in range(4):
        total = 0.0
        for i in range(n):
            total += values[i, m]
        tail = 0.0
        for _ in range(k):
            best = 0
            for i in range(1, n):
                if values[i, m] > values[best, m]:
                    best = i
            tail += values[best, m]
            values[best, m] = -1.0
        out[0, m] = total / n
        out[1, m] = tail / k


@njit(cache=True)
def weigh(w: Weights, moments: np.ndarray) -> tuple[float, float]:
    """B and U of one pose set from its moments."""
    body = 0.0
    for m in range(3):
        body += w.mean * moments[0, m] + w.tail * moments[1, m]
    return body, w.mean * moments[0, 3] + w.tail * moments[1, 3]


@njit(cache=True)
def edge_moments(laid: Laid, work: Scratch, w: Weights, roads: Roads, slot: int, out: np.ndarray) -> None:
    """Moments of the poses along a directed edge; the opposite direction covers the same ground."""
    slot = min(slot, roads.reverse[slot])
    i, j = roads.source[slot], roads.target[slot]
    n = max(2, int(np.ceil(roads.length[slot] / w.edge_step - 1e-9)) + 1)
    dx, dy = roads.x[j] - roads.x[i], roads.y[j] - roads.y[i]
    set_moments(laid, work, w, roads.x[i], roads.y[i], roads.heading[slot], dx, dy, 0.0, n, out)


@njit(cache=True)
def turn_moments(
    laid: Laid, work: Scratch, w: Weights, x: float, y: float, yaw_in: float, yaw_out: float, out: np.ndarray
) -> None:
    """Moments of a turn in place."""
    d = turn(yaw_in, yaw_out)
    n = int(np.ceil(abs(d) / w.sweep_step - 1e-9)) + 1
    set_moments(laid, work, w, x, y, yaw_in, 0.0, 0.0, d, n, out)


@njit(cache=True)
def edge_risk(
    laid: Laid, work: Scratch, w: Weights, roads: Roads, tables: Tables, slot: int
) -> tuple[float, float]:
    """B and U of a directed edge, from the table or evaluated now."""
    if np.isnan(tables.edge[slot, 0]):
        moments = np.empty((3, 4))
        edge_moments(laid, work, w, roads, slot, moments)
        tables.edge[slot, 0], tables.edge[slot, 1] = weigh(w, moments)
        tables.edge[roads.reverse[slot]] = tables.edge[slot]
    return tables.edge[slot, 0], tables.edge[slot, 1]


@njit(cache=True)
def turn_risk(
    laid: Laid, work: Scratch, w: Weights, x: float, y: float, yaw_in: float, yaw_out: float
) -> tuple[float, float]:
    """B and U of a turn in place."""
    moments = np.empty((3, 4))
    turn_moments(laid, work, w, x, y, yaw_in, yaw_out, moments)
    return weigh(w, moments)


@njit(cache=True)
def sweep_risk(
    laid: Laid, work: Scratch, w: Weights, roads: Roads, tables: Tables, slot: int, out: int
) -> tuple[float, float]:
    """B and U of the turn from directed edge `slot` into `out`, which leaves the target of `slot`."""
    j = roads.target[slot]
    at = roads.sweep_ptr[slot] + out - roads.indptr[j]
    if np.isnan(tables.sweep[at, 0]):
        tables.sweep[at, 0], tables.sweep[at, 1] = turn_risk(
            laid, work, w, roads.x[j], roads.y[j], roads.heading[slot], roads.heading[out]
        )
    return tables.sweep[at, 0], tables.sweep[at, 1]


@njit(cache=True)
def route_moments(
    laid: Laid,
    w: Weights,
    xy: np.ndarray,
    flip: np.ndarray,
    start_yaw: float,
    goal_yaw: float,
    first: int,
    last: int,
    out: np.ndarray,
) -> None:
    """Moments of every pose set of transitions first..last - 1 of a route through points xy (n, 2).

    `out` is (n - 1, 3, 3, 4): transition, set (edge, sweep before it, terminal sweep), moment, feature; NaN where a
    set does not exist. `flip` marks edges that are evaluated from their far end, as the search does.
    """
    work = scratch(laid)
    for t in range(first, last):
        out[t] = np.nan
        x, y = xy[t, 0], xy[t, 1]
        dx, dy = xy[t + 1, 0] - x, xy[t + 1, 1] - y
        yaw = np.arctan2(dy, dx)
        n = max(2, int(np.ceil(np.hypot(dx, dy) / w.edge_step - 1e-9)) + 1)
        if flip[t]:
            set_moments(laid, work, w, x + dx, y + dy, np.arctan2(-dy, -dx), -dx, -dy, 0.0, n, out[t, 0])
        else:
            set_moments(laid, work, w, x, y, yaw, dx, dy, 0.0, n, out[t, 0])
        yaw_in = np.arctan2(y - xy[t - 1, 1], x - xy[t - 1, 0]) if t > 0 else start_yaw
        if not np.isnan(yaw_in):
            turn_moments(laid, work, w, x, y, yaw_in, yaw, out[t, 1])
        if t == xy.shape[0] - 2 and not np.isnan(goal_yaw):
            turn_moments(laid, work, w, x + dx, y + dy, yaw, goal_yaw, out[t, 2])


@njit(cache=True)
def reverse_slots(indptr: np.ndarray, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Slot of the opposite direction of every slot, -1 where it is missing."""
    out = np.full(target.size, -1, np.int64)
    for s in range(target.size):
        j = target[s]
        for o in range(indptr[j], indptr[j + 1]):
            if target[o] == source[s]:
                out[s] = o
                break
    return out


@njit(cache=True)
def low_risk(
    laid: Laid, work: Scratch, w: Weights, roads: Roads, tables: Tables, slot: int
) -> tuple[float, float]:
    """B and U of a directed edge if known, else lower bounds from two of its poses.

    Poses with scaled features x and y, out of n, put at least (x + y) / n into the mean and max(x, y) / k into the tail.
    """
    if not np.isnan(tables.edge[slot, 0]):
        return tables.edge[slot, 0], tables.edge[slot, 1]
    if np.isnan(tables.low[slot, 0]):
        back = roads.reverse[slot]
        i, j = roads.source[slot], roads.target[slot]
        n = max(2, int(np.ceil(roads.length[slot] / w.edge_step - 1e-9)) + 1)
        # The poses must be the edge's own: counted from the end that evaluates the edge.
        poses = np.empty((2, 3))
        for m in range(2):
            t = ((m + 1) * n // 3) / (n - 1)
            t = t if slot < back else 1.0 - t
            poses[m, 0] = roads.x[i] + t * (roads.x[j] - roads.x[i])
            poses[m, 1] = roads.y[i] + t * (roads.y[j] - roads.y[i])
            poses[m, 2] = roads.heading[slot]
        f = np.empty((2, 4))
        features_of(laid, work, poses, f)
        k = max(1, (n + 9) // 10)
        b = 0.0
        u = 0.0
        for m in range(4):
            x0, x1 = f[0, m] / w.scale[m], f[1, m] / w.scale[m]
            if m < 3:
                x0, x1 = min(w.clip, x0), min(w.clip, x1)
            both = x0 + x1 if n > 2 else max(x0, x1)
            top = max(x0, x1) if k == 1 else both
            u = (w.mean * both / n + w.tail * top / k) * (1.0 - 1e-6)
            if m < 3:
                b += u
        tables.low[slot, 0] = b
        tables.low[slot, 1] = u
        tables.low[back] = tables.low[slot]
    return tables.low[slot, 0], tables.low[slot, 1]


@njit(cache=True)
def distance_to_go(
    laid: Laid,
    work: Scratch,
    w: Weights,
    roads: Roads,
    tables: Tables,
    start: int,
    is_end: np.ndarray,
    exit_cost: np.ndarray,
) -> np.ndarray:
    """(nodes,) lower bound of the cost from each node over an end to the goal: Dijkstra backwards.

    Edges count with what is known of them and without their turns. It stops at the start: what is farther gets the
    start's value, which is still a consistent bound. inf: no end can be reached.
    """
    count = roads.x.size
    h = np.full(count, np.inf)
    closed = np.zeros(count, np.bool_)
    size = 64
    f, s, e = np.empty(size), np.empty(size, np.int64), np.empty(size, np.int64)
    n = 0
    for i in range(count):
        if is_end[i]:
            h[i] = exit_cost[i]
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
            n = push(f, s, e, n, h[i], i, 0)
    while n > 0:
        i = s[0]
        n = pop(f, s, e, n)
        if closed[i]:
            continue
        closed[i] = True
        if i == start:
            break
        for out in range(roads.indptr[i], roads.indptr[i + 1]):
            k = roads.target[out]
            if closed[k]:
                continue
            b, u = low_risk(laid, work, w, roads, tables, out)
            cost = h[i] + roads.length[out] * (1.0 + w.native * roads.risk[out] + w.body * b + w.unknown * u)
            if cost < h[k]:
                h[k] = cost
                if n == f.size:
                    f, s, e = grown(f), grown(s), grown(e)
                n = push(f, s, e, n, cost, k, 0)
    if closed[start]:
        for i in range(count):
            if not closed[i]:
                h[i] = h[start]
    return h


@njit(cache=True)
def search_pairs(
    laid: Laid,
    w: Weights,
    roads: Roads,
    tables: Tables,
    start: int,
    is_end: np.ndarray,
    exit_cost: np.ndarray,
    start_yaw: float,
    goal_yaw: float,
    sweeps: bool,
) -> tuple[float, np.ndarray, int]:
    """Route over ordered pairs to the end node with the least cost plus `exit_cost` (nodes,).

    That is zero for a goal node; for frontiers it is the optimistic cost still to go. A yaw of NaN was not
    requested. Returns the cost of the route (inf: none), the slots of its edges and the number of expanded states.
    """
    none = np.empty(0, np.int64)
    work = scratch(laid)
    h = distance_to_go(laid, work, w, roads, tables, start, is_end, exit_cost)
    if np.isinf(h[start]):
        return np.inf, none, 0
    slots = roads.target.size
    best = np.full(slots, np.inf)  # least evaluated cost of each state
    parent = np.full(slots, -1, np.int64)
    closed = np.zeros(slots, np.bool_)
    size = 256
    f, s, e = np.empty(size), np.empty(size, np.int64), np.empty(size, np.int64)
    # Queue entries: where the state was reached from, at what cost, and how far it is evaluated: not at all (0),
    # its edge (1), its edge and its turns (2).
    came, base, stage = np.empty(size, np.int64), np.empty(size), np.empty(size, np.int8)
    n = 0
    entries = 0
    expanded = 0
    slot = -1
    at = start
    while True:
        g = 0.0 if slot < 0 else best[slot]
        expanded += 1
        for out in range(roads.indptr[at], roads.indptr[at + 1]):
            if closed[out]:
                continue
            b, u = low_risk(laid, work, w, roads, tables, out)
            cost = g + roads.length[out] * (1.0 + w.native * roads.risk[out] + w.body * b + w.unknown * u)
            if cost >= best[out]:
                continue
            if entries == came.size:
                came, base, stage = grown(came), grown(base), grown(stage)
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
            came[entries], base[entries] = slot, g
            stage[entries] = 0 if np.isnan(tables.edge[out, 0]) else 1
            n = push(f, s, e, n, cost + h[roads.target[out]], out, entries)
            entries += 1
        # Take the most promising state and evaluate what its cost still lacks, until one is certain.
        slot = -1
        while n > 0:
            bound, out, entry = f[0], s[0], e[0]
            n = pop(f, s, e, n)
            if out < 0:  # the way on from an end: nothing in the queue can be cheaper
                return best[entry], walk_back(parent, entry), expanded
            if closed[out]:
                continue
            origin = came[entry]
            if stage[entry] == 2:
                if parent[out] != origin:
                    continue  # reached more cheaply in the meantime
                slot = out
                break
            at, k = roads.source[out], roads.target[out]
            b, u = edge_risk(laid, work, w, roads, tables, out)
            fixed = 1.0 + w.native * roads.risk[out]
            cost = base[entry] + roads.length[out] * (fixed + w.body * b + w.unknown * u)
            stage[entry] += 1
            if sweeps and (stage[entry] == 2 or cost + h[k] <= bound):
                stage[entry] = 2
                b2, u2 = 0.0, 0.0
                if origin >= 0:
                    b2, u2 = sweep_risk(laid, work, w, roads, tables, origin, out)
                elif not np.isnan(start_yaw):
                    b2, u2 = turn_risk(laid, work, w, roads.x[at], roads.y[at], start_yaw, roads.heading[out])
                b, u = max(b, b2), max(u, u2)
                if is_end[k] and not np.isnan(goal_yaw):
                    b2, u2 = turn_risk(laid, work, w, roads.x[k], roads.y[k], roads.heading[out], goal_yaw)
                    b, u = max(b, b2), max(u, u2)
                cost = base[entry] + roads.length[out] * (fixed + w.body * b + w.unknown * u)
            elif not sweeps:
                stage[entry] = 2
            if cost >= best[out]:
                continue
            if stage[entry] == 2:
                best[out] = cost
                parent[out] = origin
            n = push(f, s, e, n, cost + h[k], out, entry)
        if slot < 0:
            return np.inf, none, expanded
        closed[slot] = True
        at = roads.target[slot]
        if is_end[at]:
            if n == f.size:
                f, s, e = grown(f), grown(s), grown(e)
            n = push(f, s, e, n, best[slot] + exit_cost[at], -1, slot)


@njit(cache=True)
def walk_back(parent: np.ndarray, last: int) -> np.ndarray:
    """Slots from the start to `last`."""
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


@njit(cache=True)
def search_nodes(
    w: Weights, roads: Roads, start: int, is_end: np.ndarray, exit_cost: np.ndarray, gx: float, gy: float
) -> tuple[float, np.ndarray, int]:
    """The same by the native cost l (1 + sigma r), A* over nodes; no exit costs less than the way to (gx, gy) is long."""
    count = roads.x.size
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
        for out in range(roads.indptr[i], roads.indptr[i + 1]):
            k = roads.target[out]
            cost = g[i] + roads.length[out] * (1.0 + w.native * roads.risk[out])
            if not closed[k] and cost < g[k]:
                g[k] = cost
                parent[k] = out
                if n == f.size:
                    f, s, e = grown(f), grown(s), grown(e)
                n = push(f, s, e, n, cost + np.hypot(gx - roads.x[k], gy - roads.y[k]), k, 0)
    if goal < 0:
        return np.inf, np.empty(0, np.int64), expanded
    steps = 0
    i = goal
    while i != start:
        steps += 1
        i = roads.source[parent[i]]
    route = np.empty(steps, np.int64)
    i = goal
    for k in range(steps - 1, -1, -1):
        route[k] = parent[i]
        i = roads.source[parent[i]]
    return g[goal], route, expanded
