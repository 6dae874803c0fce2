"""Plain-numpy reading of the body-risk formulas and of the pair search: slow, obvious, shared with nothing."""

from __future__ import annotations

import heapq
import math

import numpy as np

L, W = 0.70, 0.43
SCALE = np.array([0.30, 30.0, 0.30])


def sample(grid, x, y):
    """Bilinear height and nearest-cell trust at x, y; outside the grid the edge value, untrusted."""
    rows, cols = grid.shape
    col = (np.asarray(x) - grid.origin[0]) / grid.resolution
    row = (np.asarray(y) - grid.origin[1]) / grid.resolution
    near_c, near_r = np.floor(col + 0.5).astype(int), np.floor(row + 0.5).astype(int)
    inside = (near_c >= 0) & (near_c < cols) & (near_r >= 0) & (near_r < rows)
    trust = np.zeros(np.shape(col), bool)
    trust[inside] = grid.trusted[near_r[inside], near_c[inside]]
    col, row = np.clip(col, 0, cols - 1), np.clip(row, 0, rows - 1)
    c0, r0 = np.minimum(col.astype(int), cols - 2), np.minimum(row.astype(int), rows - 2)
    fc, fr = col - c0, row - r0
    h = grid.height.astype(float)
    z = (h[r0, c0] * (1 - fc) + h[r0, c0 + 1] * fc) * (1 - fr) + (
        h[r0 + 1, c0] * (1 - fc) + h[r0 + 1, c0 + 1] * fc
    ) * fr
    return z, trust


def features(grid, pose):
    """d_fb, a_lr, p_int, u of one pose."""
    nx = math.ceil(round(L / grid.resolution, 9)) + 1
    ny = math.ceil(round(W / grid.resolution, 9)) + 1
    sx, sy = np.meshgrid(np.linspace(-L / 2, L / 2, nx), np.linspace(-W / 2, W / 2, ny), indexing="ij")
    x, y, yaw = pose
    z, ok = sample(
        grid, x + sx * math.cos(yaw) - sy * math.sin(yaw), y + sx * math.sin(yaw) + sy * math.cos(yaw)
    )
    if not ok.any():
        return np.array([0.0, 0.0, 0.0, 1.0])
    means = {}
    for name, fx, fy in (("FL", 1, 1), ("FR", 1, -1), ("BL", -1, 1), ("BR", -1, -1)):
        band = (fx * sx >= L / 4 - 1e-9) & (fy * sy >= W / 4 - 1e-9)
        means[name] = z[band & ok].mean() if (band & ok).any() else z[band].mean()
    fl, fr, bl, br = (means[k] for k in ("FL", "FR", "BL", "BR"))
    return np.array(
        [
            abs((fl + fr) / 2 - (bl + br) / 2),
            math.degrees(math.atan2(abs((fl + bl) / 2 - (fr + br) / 2), W)),
            max(0.0, z[ok].max() - max(means.values())),
            1.0 - ok.mean(),
        ]
    )


def set_risk(grid, poses, w_mean=0.5, w_tail=0.5):
    """B and U of a pose set."""
    f = np.array([features(grid, p) for p in poses])
    x = np.column_stack([np.minimum(3.0, f[:, :3] / SCALE), f[:, 3]])
    k = max(1, math.ceil(round(0.1 * len(x), 9)))
    a = w_mean * x.mean(0) + w_tail * np.sort(x, axis=0)[::-1][:k].mean(0)
    return a[:3].sum(), a[3]


def edge(grid, p, q, **weights):
    n = max(2, math.ceil(round(math.dist(p[:2], q[:2]) / 0.05, 9)) + 1)
    yaw = math.atan2(q[1] - p[1], q[0] - p[0])
    return set_risk(
        grid,
        [(p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]), yaw) for t in np.linspace(0, 1, n)],
        **weights,
    )


def turn(grid, p, yaw_in, yaw_out, **weights):
    d = math.atan2(math.sin(yaw_out - yaw_in), math.cos(yaw_out - yaw_in))
    if abs(abs(d) - math.pi) < 1e-9:
        d = math.pi
    n = math.ceil(round(abs(d) / math.radians(5), 9)) + 1
    return set_risk(
        grid, [(p[0], p[1], yaw_in + (d * i / (n - 1) if n > 1 else 0.0)) for i in range(n)], **weights
    )


def dijkstra(grid, graph, start, goal, start_yaw=None, goal_yaw=None, variant="full"):
    """Optimal cost and node sequence over ordered pairs, without heuristic, every pose set evaluated."""
    xyz = graph.nodes
    nbr = {i: list(graph.indices[graph.indptr[i] : graph.indptr[i + 1]]) for i in range(len(xyz))}
    risk = {(i, int(j)): float(graph.risk[graph.indptr[i] + n]) for i in nbr for n, j in enumerate(nbr[i])}
    weights = {"w_mean": 1.0, "w_tail": 0.0} if variant == "mean-only" else {}
    memo = {}

    def once(key, f):
        if key not in memo:
            memo[key] = f()
        return memo[key]

    def heading(i, j):
        return math.atan2(xyz[j, 1] - xyz[i, 1], xyz[j, 0] - xyz[i, 0])

    def over_edge(node, yaw_in, yaw_out):
        d = abs(math.remainder(yaw_out - yaw_in, 2 * math.pi))
        edgy = graph.turn_edge[node] > graph.params.max_turn_step
        return 4.0 * d if edgy and d > math.radians(30) else 0.0

    def cost(i, j, k):
        extra = 0.0
        sets = [once((j, k), lambda: edge(grid, xyz[j], xyz[k], **weights))]
        if variant != "edge-only":
            yaw_in = start_yaw if i is None else heading(i, j)
            if yaw_in is not None:
                sets.append(once((i, j, k), lambda: turn(grid, xyz[j], yaw_in, heading(j, k), **weights)))
                extra += over_edge(j, yaw_in, heading(j, k))
            if k == goal and goal_yaw is not None:
                sets.append(once(("g", j), lambda: turn(grid, xyz[k], heading(j, k), goal_yaw, **weights)))
                extra += over_edge(k, heading(j, k), goal_yaw)
        length = math.dist(xyz[j, :2], xyz[k, :2])
        b, u = max(s[0] for s in sets), max(s[1] for s in sets)
        return length * (1 + 3 * risk[j, k] + (0 if variant == "native" else b + u)) + extra

    heap = [(cost(None, start, int(j)), start, int(j), (start, int(j))) for j in nbr[start]]
    heapq.heapify(heap)
    done = set()
    while heap:
        g, i, j, route = heapq.heappop(heap)
        if j == goal:
            return g, route
        if (i, j) in done:
            continue
        done.add((i, j))
        for k in nbr[j]:
            if (j, int(k)) not in done:
                heapq.heappush(heap, (g + cost(i, j, int(k)), j, int(k), (*route, int(k))))
    return math.inf, ()
