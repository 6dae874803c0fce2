"""The native graph in plain numpy and Python: what the kernels are timed and tested against."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from tools.baselines.native import NativeParams

F = np.float32


class NativeOracle:
    """Grows the native graph of a fully known grid; `nodes`, `edges`, `risk` hold the result."""

    def __init__(
        self, grid: ElevationGrid, start_xy: tuple[float, float], params: NativeParams, seed: int
    ) -> None:
        self.p = params
        self.z = grid.height
        self.res, (self.x0, self.y0) = grid.resolution, grid.origin
        rows, cols = grid.shape
        self.xs = (self.x0 + np.arange(cols) * self.res).astype(np.float32)
        self.ys = (self.y0 + np.arange(rows) * self.res).astype(np.float32)
        self.dist, self.radius = F(params.expand_dist), F(params.robot_size)
        self.random = np.random.RandomState(seed)
        self.xy = np.empty((0, 2), np.float32)
        self.height: list[np.float32] = []
        self.alive: list[bool] = []
        self.links: list[dict[int, float]] = []
        root = np.array([F(start_xy[0]) + self.dist, F(start_xy[1])], np.float32)
        while self.blocked(root):
            uy, ux = self.draw(), self.draw()
            root = root + self.dist * np.array([ux, uy], np.float32)
        self.add(root)
        self.grow()
        index = np.cumsum(self.alive) - 1
        keep = np.array(self.alive)
        self.nodes = np.column_stack([self.xy, self.height])[keep]
        pairs = [(a, b, r) for a, to in enumerate(self.links) for b, r in to.items() if a < b]
        self.edges = np.array([(index[a], index[b]) for a, b, _ in pairs], dtype=np.int64)
        self.risk = np.array([r for _, _, r in pairs])

    def draw(self) -> np.float32:
        return F(F(self.random.randint(0, 2**32, dtype=np.uint32)) / F(4294967296.0))

    def window(self, x: float, y: float, reach: float) -> tuple[slice, slice]:
        r0 = max(0, math.floor((y - reach - self.y0) / self.res))
        c0 = max(0, math.floor((x - reach - self.x0) / self.res))
        r1 = math.ceil((y + reach - self.y0) / self.res) + 1
        c1 = math.ceil((x + reach - self.x0) / self.res) + 1
        return slice(r0, max(r1, 0)), slice(c0, max(c1, 0))

    def blocked(self, p: NDArray[np.float32]) -> bool:
        rows, cols = self.window(float(p[0]), float(p[1]), float(self.radius))
        inside = (self.xs[cols] - p[0]) ** 2 + ((self.ys[rows] - p[1]) ** 2)[
            :, None
        ] <= self.radius * self.radius
        points = self.z[rows, cols][inside]
        if not len(points):
            return True
        median = np.partition(points, len(points) // 2)[len(points) // 2]
        outliers = np.count_nonzero(np.abs(points - median) > F(self.p.height_threshold))
        return bool(F(outliers) / F(len(points)) > F(self.p.collision_threshold))

    def add(self, p: NDArray[np.float32]) -> int:
        r = min(max(math.floor((p[1] - self.y0) / self.res + 0.5), 0), len(self.ys) - 1)
        c = min(max(math.floor((p[0] - self.x0) / self.res + 0.5), 0), len(self.xs) - 1)
        self.xy = np.vstack([self.xy, p[None]])
        self.height.append(self.z[r, c])
        self.alive.append(True)
        self.links.append({})
        return len(self.height) - 1

    def grow(self) -> None:
        all_pairs = float(F(self.dist - self.radius)) < 0.25 * float(self.dist)
        queue = deque([0])
        while queue:
            here = queue.popleft()
            ring: list[NDArray[np.float32]] = []
            failures = 0
            while len(ring) < self.p.sample_num and failures <= 1000:
                angle = F(float(F(2.0) * self.draw()) * math.pi)
                p = self.xy[here] + self.dist * np.array([F(math.cos(angle)), F(math.sin(angle))], np.float32)
                if self.blocked(p):
                    failures += 1
                else:
                    ring.append(p)
            for p in ring:
                d2 = ((self.xy - p) ** 2).sum(axis=1)
                near = int(np.argmin(d2))
                if not self.alive[near]:
                    continue
                if F(np.sqrt(d2[near])) < self.radius:
                    self.wire(here, near)
                    continue
                new = self.add(p)
                self.wire(here, new)
                if all_pairs:
                    for other in np.flatnonzero(d2 <= self.dist * self.dist):
                        if self.alive[other]:
                            self.wire(new, int(other))
                if self.links[new]:
                    queue.append(new)
                else:
                    self.alive[new] = False

    def wire(self, a: int, b: int) -> None:
        if a == b or b in self.links[a]:
            return
        pa, pb = self.xy[a], self.xy[b]
        d = F(np.sqrt(((pb - pa) ** 2).sum(dtype=np.float32)))
        limit = F(math.atan2(self.p.height_threshold, self.radius))
        if F(math.atan2(abs(self.height[a] - self.height[b]), d)) > limit:
            return
        u = (pb - pa) / d
        t = F(0.0)
        while t < d:
            if self.blocked(pa + t * u):
                return
            t = F(t + self.radius * F(0.5))
        risk = self.edge_risk(pa, pb, d, u)
        if risk is not None:
            self.links[a][b] = self.links[b][a] = risk

    def edge_risk(self, pa: Any, pb: Any, d: np.float32, u: Any) -> float | None:
        centre = (pa + pb) * F(0.5)
        minor = self.radius
        major = minor if d * F(0.5) < minor else F(np.sqrt((d * F(0.5)) ** 2 + minor * minor))
        rows, cols = self.window(float(centre[0]), float(centre[1]), float(major))
        dx, dy = np.meshgrid(self.xs[cols] - centre[0], self.ys[rows] - centre[1])
        lx, ly = u[0] * dx - u[1] * dy, u[1] * dx + u[0] * dy
        inside = dx * dx + dy * dy <= major * major
        if major != minor:
            inside &= lx * lx * minor * minor + ly * ly * major * major < major * major * minor * minor
        if np.count_nonzero(inside) < 3:
            return None
        points = np.stack([lx[inside], ly[inside], self.z[rows, cols][inside]]).astype(np.float64)
        vectors = np.linalg.eigh(np.cov(points))[1]
        risk = (0.8 * abs(vectors[2, 2]) + 0.2 * abs(vectors[2, 1])) / math.sqrt(3.0)
        return 0.0 if risk < 0.1 else float(risk)
