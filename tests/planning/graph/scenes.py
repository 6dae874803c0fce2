"""Random rescue-like ground with known obstacles, and plain-numpy judges of a graph on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.grid import ElevationGrid
from planning.graph.graph import TraversalGraph

LENGTH, WIDTH = 0.70, 0.43


@dataclass
class Scene:
    """`label` (rows, cols) int: between cells of different labels the ground breaks."""

    grid: ElevationGrid
    label: np.ndarray
    start: tuple[float, float]


def random_scene(seed: int, res: float = 0.04, size: float = 7.0, noise: float = 0.005) -> Scene:
    """Rolling ground, kerbs that may be crossed, thin walls, ledges and pits that may not; free around the start."""
    rng = np.random.default_rng(seed)
    n = round(size / res)
    y, x = np.mgrid[0:n, 0:n] * res
    z = 0.1 * np.sin(0.9 * x + rng.uniform(0, 6)) + 0.08 * np.cos(1.1 * y + rng.uniform(0, 6))
    label = np.zeros((n, n), int)
    kerb = rng.uniform(0, size)
    z[np.abs(x * np.cos(0.3) + y * np.sin(0.3) - kerb) < 0.3] += 0.07

    def place(mask: np.ndarray, height: float, name: int) -> None:
        label[mask] = name
        z[mask] += height

    for k in range(4):  # walls 0.05-0.15 m thick, 1 m high
        cx, cy, a = *rng.uniform(0, size, 2), rng.uniform(0, np.pi)
        u = (x - cx) * np.cos(a) + (y - cy) * np.sin(a)
        v = -(x - cx) * np.sin(a) + (y - cy) * np.cos(a)
        wall = (np.abs(u) < rng.uniform(0.8, 1.6)) & (
            np.abs(v) <= 0.5 * max(rng.uniform(0.05, 0.15), 1.5 * res)
        )
        place(wall & (label == 0), 1.0, 1 + k)
    for k in range(5):  # raised blocks and pits with vertical faces
        cx, cy, a = *rng.uniform(0, size, 2), rng.uniform(0, np.pi)
        u = (x - cx) * np.cos(a) + (y - cy) * np.sin(a)
        v = -(x - cx) * np.sin(a) + (y - cy) * np.cos(a)
        w = rng.uniform(0.15, 0.6, 2)
        height = rng.uniform(0.22, 0.6) * rng.choice([-1.0, 1.0])
        place((np.abs(u) < w[0]) & (np.abs(v) < w[1]) & (label == 0), height, 10 + k)
    start = (0.5 * size, 0.5 * size)
    free = np.hypot(x - start[0], y - start[1]) < 0.8
    label[free] = 0
    z[free] = 0.0
    rim = np.hypot(x - start[0], y - start[1])
    z *= np.clip((rim - 0.8) / 0.4, 0.0, 1.0) ** (label == 0)
    z += noise * rng.standard_normal(z.shape)
    return Scene(ElevationGrid(z.astype(np.float32), np.ones((n, n), bool), (0.0, 0.0), res), label, start)


def swept(graph: TraversalGraph, edge: np.ndarray, x: np.ndarray, y: np.ndarray, shrink: float) -> np.ndarray:
    """Which places x, y [m] lie under the footprint, `shrink` [m] smaller on each side, on its way along an edge."""
    a, b = graph.nodes[edge[0], :2], graph.nodes[edge[1], :2]
    d = np.hypot(*(b - a))
    u = (b - a) / d
    x, y = x - a[0], y - a[1]
    along, across = x * u[0] + y * u[1], -x * u[1] + y * u[0]
    front = 0.5 * LENGTH - shrink
    return (along >= -front) & (along <= d + front) & (np.abs(across) <= 0.5 * WIDTH - shrink)


def crossing_edges(graph: TraversalGraph, scene: Scene, shrink: float, step: float) -> list[tuple[int, int]]:
    """Edges whose swept footprint covers two neighbouring cells of different labels more than `step` [m] apart."""
    z, label = scene.grid.height, scene.label
    face_c = (label[:, 1:] != label[:, :-1]) & (np.abs(np.diff(z, axis=1)) > step)
    face_r = (label[1:] != label[:-1]) & (np.abs(np.diff(z, axis=0)) > step)
    pairs = [
        np.stack([at, at + beside], axis=1)
        for at, beside in ((np.argwhere(face_c), (0, 1)), (np.argwhere(face_r), (1, 0)))
    ]
    cells = np.concatenate(pairs) * scene.grid.resolution
    y, x = cells[..., 0] + scene.grid.origin[1], cells[..., 1] + scene.grid.origin[0]
    bad = [edge for edge in graph.edges if swept(graph, edge, x, y, shrink).all(axis=1).any()]
    return [(int(a), int(b)) for a, b in bad]


def drivable(scene: Scene, grow: float, headings: int = 16, step: float = 0.08) -> np.ndarray:
    """Positions (k, 2) a robot `grow` [m] larger on each side reaches from the start by driving straight and turning.

    A flood fill over (x, y, heading): an oracle of what a graph could cover, knowing only the labels.
    """
    grid = scene.grid
    rows, cols = grid.shape
    res = grid.resolution
    edge = np.zeros((rows, cols), bool)
    diff_c = scene.label[:, 1:] != scene.label[:, :-1]
    diff_r = scene.label[1:] != scene.label[:-1]
    edge[:, 1:] |= diff_c
    edge[:, :-1] |= diff_c
    edge[1:] |= diff_r
    edge[:-1] |= diff_r
    points = np.argwhere(edge)[:, ::-1] * res
    axis = np.arange(0.0, (cols - 1) * res, step)
    gx, gy = np.meshgrid(axis, axis)
    free = np.ones((headings, *gx.shape), bool)
    front, half = 0.5 * LENGTH + grow, 0.5 * WIDTH + grow
    angle = np.pi * np.arange(headings)[:, None, None] / headings
    cos, sin = np.cos(angle), np.sin(angle)
    for px, py in points:
        j0, j1 = np.searchsorted(axis, (py - 0.5, py + 0.5))
        i0, i1 = np.searchsorted(axis, (px - 0.5, px + 0.5))
        dx, dy = px - gx[j0:j1, i0:i1], py - gy[j0:j1, i0:i1]
        hit = (np.abs(dx * cos + dy * sin) <= front) & (np.abs(-dx * sin + dy * cos) <= half)
        free[:, j0:j1, i0:i1] &= ~hit
    for h in range(headings):
        c, s = np.cos(np.pi * h / headings), np.sin(np.pi * h / headings)
        ex, ey = front * abs(c) + half * abs(s), front * abs(s) + half * abs(c)
        limit = (cols - 1) * res
        free[h] &= (gx > ex) & (gx < limit - ex) & (gy > ey) & (gy < limit - ey)
    reached = np.zeros_like(free)
    i, j = round(scene.start[0] / step), round(scene.start[1] / step)
    stack = [(h, j, i) for h in range(headings) if free[h, j, i]]
    while stack:
        h, j, i = stack.pop()
        if not (0 <= j < free.shape[1] and 0 <= i < free.shape[2]) or reached[h, j, i] or not free[h, j, i]:
            continue
        reached[h, j, i] = True
        stack += [((h + 1) % headings, j, i), ((h - 1) % headings, j, i)]
        c, s = np.cos(np.pi * h / headings), np.sin(np.pi * h / headings)
        for sign in (1, -1):
            # a move of about two steps along the heading, rounded to the raster
            stack.append((h, j + sign * round(2 * s), i + sign * round(2 * c)))
    j, i = np.nonzero(reached.any(axis=0))
    return np.stack([axis[i], axis[j]], axis=1)
