"""The part of a scene that scanner stations would see, and benchmark queries drawn from its geometry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.lidar.caster import NumbaCaster, Surface
from hal.scenes.scene import Pair, SceneError


def survey(
    surface: Surface,
    stations: Sequence[tuple[float, float, float]],
    seed: int,
    *,
    noise: float,
    grazing: float,
    looks: int = 2,
) -> NDArray[np.float32]:
    """Heights (rows, cols) [m] measured from `stations` (x, y, height above the ground there [m]); NaN where unseen.

    A cell counts when `looks` stations see it freely and steeper than `grazing` [rad] over the surface there.
    `noise` is the standard deviation of the heights [m].
    """
    height = surface.height
    rows, cols = height.shape
    x0, y0 = surface.origin
    x, y = np.meshgrid(x0 + surface.resolution * np.arange(cols), y0 + surface.resolution * np.arange(rows))
    slope_y, slope_x = np.gradient(height.astype(np.float64), surface.resolution)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1).reshape(-1, 3)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    cells = np.stack([x, y, height], axis=-1).reshape(-1, 3).astype(np.float64)
    caster = NumbaCaster(surface)
    seen = np.zeros(len(cells), np.int64)
    for sx, sy, above in stations:
        r, c = round((sy - y0) / surface.resolution), round((sx - x0) / surface.resolution)
        eye = np.array([sx, sy, height[r, c] + above])
        to_cell = cells - eye
        distance = np.linalg.norm(to_cell, axis=1)
        direction = to_cell / np.maximum(distance, 1e-9)[:, None]
        facing = -np.einsum("ij,ij->i", direction, normal) > np.sin(grazing)
        ask = np.flatnonzero(facing)
        origins = np.tile(eye.astype(np.float32), (len(ask), 1))
        reach = caster.cast(origins, direction[ask].astype(np.float32))
        seen[ask[reach > distance[ask] - 0.01]] += 1
    random = np.random.default_rng(seed)
    measured = height + noise * random.standard_normal(height.shape)
    return np.where((seen >= looks).reshape(height.shape), measured, np.nan).astype(np.float32)


def relief(height: NDArray[np.float32], cells: int) -> NDArray[np.float32]:
    """(rows, cols) height range within a square of +-`cells` cells [m], the edge repeated outside."""
    high, low = height, height
    for axis in (0, 1):
        high = _extreme(high, cells, axis, np.maximum)
        low = _extreme(low, cells, axis, np.minimum)
    return high - low


def highest_near(height: NDArray[np.float64], cells: int) -> NDArray[np.float64]:
    """(rows, cols) greatest height within a square of +-`cells` cells [m]."""
    return _extreme(_extreme(height, cells, 0, np.maximum), cells, 1, np.maximum)


def _extreme(values: NDArray[Any], cells: int, axis: int, pick: np.ufunc) -> NDArray[Any]:
    pad = [(0, 0), (0, 0)]
    pad[axis] = (cells, cells)
    padded = np.pad(values, pad, mode="edge")
    n = values.shape[axis]
    out = values
    for k in range(2 * cells + 1):
        out = pick(out, padded[k : k + n] if axis == 0 else padded[:, k : k + n])
    return out


def draw_pairs(
    surface: Surface,
    lanes: Sequence[tuple[float, float, float, float]],
    seed: int,
    *,
    count: int = 40,
    length: tuple[float, float] = (4.2, 6.2),
    highest: float = 1.2,
    must: Sequence[tuple[float, float, float, float]] = (),
) -> tuple[Pair, ...]:
    """Start and goal pairs inside `lanes` (x_min, x_max, y_min, y_max), `length` [m] apart; the first ones do not
    depend on `count`.

    Endpoints keep 0.26 m from anything `highest` [m] above or below them. Pair number k starts inside `must[k]` when
    there is one: elements that the benchmark wants an endpoint on."""
    random = np.random.default_rng(seed)
    room = relief(surface.height, round(0.26 / surface.resolution))

    def draw(rects: Sequence[tuple[float, float, float, float]]) -> tuple[float, float]:
        for _ in range(10_000):
            x0, x1, y0, y1 = rects[int(random.integers(len(rects)))]
            x, y = (round(float(random.uniform(a, b)), 2) for a, b in ((x0, x1), (y0, y1)))
            r = round((y - surface.origin[1]) / surface.resolution)
            c = round((x - surface.origin[0]) / surface.resolution)
            if room[r, c] < highest:
                return x, y
        raise SceneError("no free place for an endpoint: widen the lanes")

    pairs: list[Pair] = []
    for _ in range(100_000):
        if len(pairs) == count:
            return tuple(pairs)
        k = len(pairs)
        start, goal = draw([must[k]] if k < len(must) else lanes), draw(lanes)
        if length[0] <= np.hypot(goal[0] - start[0], goal[1] - start[1]) <= length[1]:
            pairs.append((start, goal))
    raise SceneError("no pair of endpoints at the wanted distance: change the lanes or the length")
