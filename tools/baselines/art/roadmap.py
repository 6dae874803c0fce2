"""A lazy roadmap: edges are tested only when a route wants to use them."""

from __future__ import annotations

import heapq
import math

import numpy as np
from numba import njit

from tools.baselines.art.contact import half_angle


@njit(cache=True)
def yaw_of(q):
    """Heading [rad] of a quaternion w, x, y, z."""
    return math.atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]))


@njit(cache=True)
def seconds(a, b, speed):
    """Time [s] from pose a to b (7,) at the largest speeds along, across and in yaw, all at once; height is left
    out."""
    yaw = yaw_of(a[3:])
    dx, dy = b[0] - a[0], b[1] - a[1]
    c, s = math.cos(yaw), math.sin(yaw)
    turn = math.pi - (math.pi - (yaw_of(b[3:]) - yaw)) % (2.0 * math.pi)
    return max(abs(c * dx + s * dy) / speed[0], abs(c * dy - s * dx) / speed[1], abs(turn) / speed[2])


@njit(cache=True)
def connect(poses, speed):
    """Edges (m, 2) and costs (m,): each pose to the ceil((e + e/6) ln n) nearest of the n before it, in space plus half
    angle."""
    n = poses.shape[0]
    factor = math.e + math.e / 6.0
    most = math.ceil(factor * math.log(max(n, 2))) + 1
    edges = np.empty((n * most, 2), np.int64)
    cost = np.empty(n * most)
    m = 0
    away = np.empty(n)
    for i in range(1, n):
        for j in range(i):
            dx, dy, dz = poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1], poses[i, 2] - poses[j, 2]
            away[j] = math.sqrt(dx * dx + dy * dy + dz * dz) + half_angle(poses[i, 3:], poses[j, 3:])
        k = min(i, math.ceil(factor * math.log(i + 1.0)))
        for j in np.argsort(away[:i])[:k]:
            edges[m, 0], edges[m, 1] = i, j
            cost[m] = seconds(poses[i], poses[j], speed)
            m += 1
    return edges[:m], cost[:m]


@njit(cache=True)
def cheapest(poses, first, target, edge, cost, alive, start, goal, speed):
    """Vertices and edges of the cheapest route over edges that are alive (A*); both empty without one.

    Vertex i's edges: `target[first[i]:first[i + 1]]`, their numbers in `edge`.
    """
    n = poses.shape[0]
    g = np.full(n, np.inf)
    parent = np.full(n, -1, np.int64)
    by = np.full(n, -1, np.int64)
    g[start] = 0.0
    queue = [(0.0, start)]
    done = np.zeros(n, np.bool_)
    while len(queue) > 0:
        _, i = heapq.heappop(queue)
        if done[i]:
            continue
        done[i] = True
        if i == goal:
            break
        for k in range(first[i], first[i + 1]):
            if not alive[edge[k]]:
                continue
            j = target[k]
            new = g[i] + cost[edge[k]]
            if new < g[j]:
                g[j], parent[j], by[j] = new, i, edge[k]
                d = poses[j, :3] - poses[goal, :3]
                heapq.heappush(queue, (new + math.sqrt((d * d).sum()) / speed[0], j))
    count = 0
    k = goal
    while parent[k] >= 0:
        count += 1
        k = parent[k]
    nodes, used = np.empty(count + 1, np.int64), np.empty(count, np.int64)
    k = goal
    nodes[count] = goal
    for m in range(count - 1, -1, -1):
        used[m] = by[k]
        k = parent[k]
        nodes[m] = k
    if nodes[0] != start:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.inf
    return nodes, used, g[goal]
