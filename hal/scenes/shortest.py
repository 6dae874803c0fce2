"""The shortest way between walls, for a disc that stays clear of them."""

from __future__ import annotations

from math import cos, pi

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
CORNERS_AROUND = 16
"""Corners of the polygon that goes round a wall's end."""


def shortest(walls: Points, start: tuple[float, float], goal: tuple[float, float], clearance: float) -> float:
    """Length [m] of the shortest way from start to goal that keeps `clearance` [m] from all walls; infinite without
    one.

    `walls` (n, 5): x, y of both ends and thickness [m]. Exact but for the polygons round the walls' ends: at most 2 %
    of such an arc too long."""
    a, b, reach = walls[:, :2], walls[:, 2:4], clearance + 0.5 * walls[:, 4]
    angle = 2.0 * pi * np.arange(CORNERS_AROUND) / CORNERS_AROUND
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / cos(pi / CORNERS_AROUND)
    corners = [end + (r + 1e-6) * ring for ends in (a, b) for end, r in zip(ends, reach, strict=True)]
    nodes = np.vstack([[start, goal], *corners])
    keep: NDArray[np.bool_] = np.all(_to_segments(nodes, a, b) >= reach, axis=1)
    keep[:2] = True
    nodes = nodes[keep]
    i, j = np.triu_indices(len(nodes), 1)
    free: NDArray[np.bool_] = np.ones(len(i), np.bool_)
    for k in range(len(walls)):
        (left,) = np.nonzero(free)
        free[left] = _between(nodes[i[left]], nodes[j[left]], a[k], b[k]) >= reach[k] - 1e-9
    leg = np.full((len(nodes), len(nodes)), np.inf)
    leg[i[free], j[free]] = leg[j[free], i[free]] = np.hypot(*(nodes[i[free]] - nodes[j[free]]).T)
    best, open_ = np.full(len(nodes), np.inf), np.ones(len(nodes), np.bool_)
    best[0] = 0.0
    while True:  # Dijkstra on the dense matrix
        waiting = np.where(open_, best, np.inf)
        node = int(np.argmin(waiting))
        if node == 1 or not np.isfinite(waiting[node]):
            return float(best[1])
        open_[node] = False
        best = np.minimum(best, best[node] + leg[node])


def _to_segments(p: Points, a: Points, b: Points) -> Points:
    """(n, m) distance of points (n, 2) to segments (m, 2), (m, 2)."""
    d = b - a
    share = ((p[:, None] - a) * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-12)
    return np.linalg.norm(p[:, None] - (a + np.clip(share, 0.0, 1.0)[..., None] * d), axis=-1)


def _between(p: Points, q: Points, a: Points, b: Points) -> Points:
    """(n,) distance of segments p-q (n, 2) to one segment a-b; 0 where they cross."""
    near = np.minimum(_to_segments(p, a[None], b[None])[:, 0], _to_segments(q, a[None], b[None])[:, 0])
    d = q - p
    for end in (a, b):
        share = ((end - p) * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-12)
        near = np.minimum(near, np.linalg.norm(end - (p + np.clip(share, 0.0, 1.0)[:, None] * d), axis=-1))

    def side(u: Points, v: Points, w: Points) -> Points:
        return (v[..., 0] - u[..., 0]) * (w[..., 1] - u[..., 1]) - (v[..., 1] - u[..., 1]) * (
            w[..., 0] - u[..., 0]
        )

    crossed = (side(p, q, a) * side(p, q, b) < 0.0) & (side(a, b, p) * side(a, b, q) < 0.0)
    return np.where(crossed, 0.0, near)
