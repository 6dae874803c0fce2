"""Equations 1 to 5 of the paper in plain numpy, to be read beside it.

Guo, Zhang, Schwertfeger, "Robot-Body-Aware Traversal Risk Graph Planning for Wheeled-Legged Robots in Complex Terrain"
(2026). The kernels compute the same, faster, and are tested against this file. Nothing here calls them. Where the paper
is
silent (corner bands, ties of half turns, ground beyond the map), the docstring names the choice.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph
from planning.risk.body import BodyModel

Array = NDArray[np.float64]
Pose = Sequence[float]
"""x, y [m], yaw [rad] in `map`."""


def sample(grid: ElevationGrid, x: Array, y: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Eq. 1: elevation H and trust M at points x, y [m].

    H is bilinear between cell centres, M is that of the nearest cell (halves round up). Beyond the map H is that of the
    nearest border cell and M is false. Heights of unknown cells must be filled before.
    """
    rows, cols = grid.shape
    col = (np.asarray(x) - grid.origin[0]) / grid.resolution
    row = (np.asarray(y) - grid.origin[1]) / grid.resolution
    near_c, near_r = np.floor(col + 0.5).astype(int), np.floor(row + 0.5).astype(int)
    inside = (near_c >= 0) & (near_c < cols) & (near_r >= 0) & (near_r < rows)
    trust = np.zeros(np.shape(col), bool)
    trust[inside] = grid.trusted[near_r[inside], near_c[inside]]
    col, row = np.clip(col, 0, cols - 1), np.clip(row, 0, rows - 1)
    c, r = np.minimum(col.astype(int), cols - 2), np.minimum(row.astype(int), rows - 2)
    u, v = col - c, row - r
    h = grid.height
    low, high = h[r, c] * (1 - u) + h[r, c + 1] * u, h[r + 1, c] * (1 - u) + h[r + 1, c + 1] * u
    return low * (1 - v) + high * v, trust


def footprint(body: BodyModel, resolution: float) -> tuple[Array, Array]:
    """Samples of the body along and across it [m], two (n, m): ceil(side / resolution) + 1 a side, both ends in."""
    n, m = (math.ceil(round(side / resolution, 9)) + 1 for side in (body.length, body.width))
    along = np.linspace(-body.length / 2, body.length / 2, n)
    across = np.linspace(-body.width / 2, body.width / 2, m)
    sx, sy = np.meshgrid(along, across, indexing="ij")
    return sx, sy


def features(grid: ElevationGrid, pose: Pose, body: BodyModel) -> Array:
    """Eq. 2: d_fb [m], a_lr [deg], p_int [m], u [-] of one pose.

    A corner is the quarter of each side (ours). Its height is the mean of its trusted samples, of all where none is
    trusted. A body over nothing trusted has no risk but the unknown, u = 1.
    """
    sx, sy = footprint(body, grid.resolution)
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    z, trusted = sample(grid, x + sx * c - sy * s, y + sx * s + sy * c)
    if not trusted.any():
        return np.array([0.0, 0.0, 0.0, 1.0])
    corner = {}
    for name, ahead, left in (("FL", 1, 1), ("FR", 1, -1), ("BL", -1, 1), ("BR", -1, -1)):
        band = (ahead * sx >= body.length / 4 - 1e-9) & (left * sy >= body.width / 4 - 1e-9)
        corner[name] = z[band & trusted].mean() if (band & trusted).any() else z[band].mean()
    front, back = (corner["FL"] + corner["FR"]) / 2, (corner["BL"] + corner["BR"]) / 2
    left, right = (corner["FL"] + corner["BL"]) / 2, (corner["FR"] + corner["BR"]) / 2
    d_fb = abs(front - back)
    a_lr = math.degrees(math.atan2(abs(left - right), body.width))
    p_int = max(0.0, z[trusted].max() - max(corner.values()))
    return np.array([d_fb, a_lr, p_int, 1.0 - trusted.mean()])


def aggregate(values: Array, body: BodyModel) -> Array:
    """Eq. 3: A_m (4,) = w_mu mean + w_t mean of the k = ceil(K / 10) largest of the K scaled features (K, 4)."""
    x = np.column_stack([np.minimum(body.clip, values[:, :3] / body.scales[:3]), values[:, 3]])
    k = max(1, math.ceil(round(0.1 * len(x), 9)))
    tail: Array = np.sort(x, axis=0)[::-1][:k].mean(axis=0)
    return body.weight_mean * x.mean(axis=0) + body.weight_tail * tail


def set_risk(grid: ElevationGrid, poses: Sequence[Pose], body: BodyModel) -> tuple[float, float]:
    """B = A_fb + A_lr + A_int and U = A_u of one pose set."""
    a = aggregate(np.array([features(grid, pose, body) for pose in poses]), body)
    return float(a[:3].sum()), float(a[3])


def heading(p: Sequence[float], q: Sequence[float]) -> float:
    """Of the straight way p -> q [rad]."""
    return math.atan2(q[1] - p[1], q[0] - p[0])


def edge_set(p: Sequence[float], q: Sequence[float], body: BodyModel) -> list[Pose]:
    """Poses from p to q, at most `edge_step` apart, both ends in, with the heading of the edge."""
    n = max(2, math.ceil(round(math.dist(p[:2], q[:2]) / body.edge_step, 9)) + 1)
    yaw = heading(p, q)
    return [(p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]), yaw) for t in np.linspace(0, 1, n)]


def sweep_set(p: Sequence[float], yaw_in: float, yaw_out: float, body: BodyModel) -> list[Pose]:
    """Poses of the shortest turn at p, at most `sweep_step` apart, both ends in. A half turn goes by +pi (ours)."""
    d = math.atan2(math.sin(yaw_out - yaw_in), math.cos(yaw_out - yaw_in))
    if abs(abs(d) - math.pi) < 1e-9:
        d = math.pi
    n = math.ceil(round(abs(d) / math.radians(body.sweep_step), 9)) + 1
    return [(p[0], p[1], yaw_in + (d * i / (n - 1) if n > 1 else 0.0)) for i in range(n)]


def transition(
    length: float, risk: float, sets: Sequence[tuple[float, float]], body: BodyModel, variant: str = "full"
) -> float:
    """Eq. 4 and 5: cost [m] of an edge with native risk r, B and U being the worst of its pose sets (edge, sweeps)."""
    b, u = max(s[0] for s in sets), max(s[1] for s in sets)
    if variant == "native":
        b = u = 0.0
    return length * (1 + body.weight_native * risk + body.weight_body * b + body.weight_unknown * u)


def cheapest_route(
    grid: ElevationGrid,
    graph: TraversalGraph,
    start: int,
    goal: int,
    body: BodyModel,
    *,
    start_yaw: float | None = None,
    goal_yaw: float | None = None,
    variant: str = "full",
    turn_cost: Callable[[int, float], float] = lambda _node, _turn: 0.0,
    backward: float = math.inf,
) -> tuple[float, tuple[int, ...]]:
    """Least sum of eq. 5 over all routes, and its nodes: Dijkstra over ordered pairs, every pose set evaluated.

    A metre driven backward costs `backward` times as much; in the paper the robot only drives forward.

    `turn_cost(node, turn [rad])` adds [m] to turns on the spot; the paper has none. inf, () where there is no route.
    """
    if variant == "mean-only":
        body = body.model_copy(update={"weight_mean": 1.0, "weight_tail": 0.0})
    xyz = graph.nodes
    edges = {i: range(int(graph.indptr[i]), int(graph.indptr[i + 1])) for i in range(len(xyz))}
    memo: dict[Any, tuple[float, float]] = {}

    def risk_of(key: Any, poses: Callable[[], list[Pose]]) -> tuple[float, float]:
        if key not in memo:
            memo[key] = set_risk(grid, poses(), body)
        return memo[key]

    def cost(i: int | None, came: int, slot: int, j: int, way: int) -> float:
        """Of driving edge `slot` out of node j, reached from i; came, way: 0 forward, 1 backward, to j and on."""
        k = int(graph.indices[slot])
        here, there = xyz[j].tolist(), xyz[k].tolist()
        out, extra = heading(here, there) + way * math.pi, 0.0
        sets = [risk_of((j, k), lambda: edge_set(here, there, body))]
        if variant != "edge-only":
            yaw_in = start_yaw if i is None else heading(xyz[i].tolist(), here) + came * math.pi
            if yaw_in is not None:
                sets.append(risk_of((i, came, j, k, way), lambda: sweep_set(here, yaw_in, out, body)))
                extra += turn_cost(j, math.remainder(out - yaw_in, 2 * math.pi))
            if k == goal and goal_yaw is not None:
                sets.append(risk_of(("goal", j, way), lambda: sweep_set(there, out, goal_yaw, body)))
                extra += turn_cost(k, math.remainder(goal_yaw - out, 2 * math.pi))
        length = math.dist(here[:2], there[:2]) * (backward if way else 1.0)
        return extra + transition(length, float(graph.risk[slot]), sets, body, variant)

    ways = (0,) if math.isinf(backward) else (0, 1)
    queue: list[tuple[float, int, int, int, tuple[int, ...]]] = []
    for slot in edges[start]:
        k = int(graph.indices[slot])
        queue += [(cost(None, 0, slot, start, way), start, k, way, (start, k)) for way in ways]
    heapq.heapify(queue)
    done = set()
    while queue:
        g, i, j, came, route = heapq.heappop(queue)
        if j == goal:
            return g, route
        if (i, j, came) in done:
            continue
        done.add((i, j, came))
        for slot in edges[j]:
            k = int(graph.indices[slot])
            for way in ways:
                if (j, k, way) not in done:
                    heapq.heappush(queue, (g + cost(i, came, slot, j, way), j, k, way, (*route, k)))
    return math.inf, ()
