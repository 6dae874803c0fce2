"""Painting terrain: simple solids laid onto a height array."""

from __future__ import annotations

from math import cos, sin

import numpy as np
from numpy.typing import NDArray

Rect = tuple[float, float, float, float]
"""x_min, x_max, y_min, y_max [m]."""


class Canvas:
    """A height array under construction. Solids stand on the datum z = 0 and the higher one wins."""

    def __init__(self, rect: Rect, resolution: float) -> None:
        x0, x1, y0, y1 = rect
        cols, rows = round((x1 - x0) / resolution) + 1, round((y1 - y0) / resolution) + 1
        self.resolution = resolution
        self.origin = (x0, y0)
        self.x, self.y = np.meshgrid(x0 + resolution * np.arange(cols), y0 + resolution * np.arange(rows))
        self.height = np.zeros((rows, cols))

    def inside(self, rect: Rect) -> NDArray[np.bool_]:
        """Cells whose centre lies in the rectangle."""
        x0, x1, y0, y1 = rect
        e = 1e-6
        return (self.x >= x0 - e) & (self.x <= x1 + e) & (self.y >= y0 - e) & (self.y <= y1 + e)

    def raise_to(self, where: NDArray[np.bool_], top: float | NDArray[np.float64]) -> None:
        """Lift the cells to at least `top` [m]."""
        np.copyto(self.height, np.maximum(self.height, top), where=where)

    def box(self, rect: Rect, top: float) -> None:
        """A block with vertical sides."""
        self.raise_to(self.inside(rect), top)

    def bar(self, start: tuple[float, float], end: tuple[float, float], width: float, top: float) -> None:
        """A straight wall or rail of `width` [m] between two points."""
        near, where = self._along(start, end, width)
        height = self.height[near]
        np.copyto(height, np.maximum(height, top), where=where)

    def wall(
        self, start: tuple[float, float], end: tuple[float, float], width: float, top: NDArray[np.float64]
    ) -> None:
        """A straight wall of `width` [m] between two points whose top (rows, cols) [m] follows the ground."""
        near, where = self._along(start, end, width)
        np.copyto(self.height[near], top[near], where=where)

    def _along(
        self, start: tuple[float, float], end: tuple[float, float], width: float
    ) -> tuple[tuple[slice, slice], NDArray[np.bool_]]:
        """Rows and columns around a strip between two points, and their cells that lie on it."""
        (ax, ay), (bx, by) = start, end
        length = float(np.hypot(bx - ax, by - ay))
        ux, uy = (bx - ax) / length, (by - ay) / length
        e = 1e-6
        half = 0.5 * width + e
        near = self._window(min(ax, bx) - half, max(ax, bx) + half, min(ay, by) - half, max(ay, by) + half)
        x, y = self.x[near], self.y[near]
        along = (x - ax) * ux + (y - ay) * uy
        across = np.abs((y - ay) * ux - (x - ax) * uy)
        return near, (along >= -e) & (along <= length + e) & (across <= half)

    def _window(self, x0: float, x1: float, y0: float, y1: float) -> tuple[slice, slice]:
        """Rows and columns that hold the rectangle and a cell around it: large scenes are painted piece by piece."""
        (ox, oy), r = self.origin, self.resolution
        return (
            slice(max(int((y0 - oy) / r) - 1, 0), max(int((y1 - oy) / r) + 3, 0)),
            slice(max(int((x0 - ox) / r) - 1, 0), max(int((x1 - ox) / r) + 3, 0)),
        )

    def block(self, centre: tuple[float, float], size: tuple[float, float], yaw: float, top: float) -> None:
        """A turned block."""
        dx, dy = 0.5 * size[0] * cos(yaw), 0.5 * size[0] * sin(yaw)
        x, y = centre
        self.bar((x - dx, y - dy), (x + dx, y + dy), size[1], top)

    def ramp(self, rect: Rect, low: float, high: float, uphill: str) -> None:
        """A slope from `low` to `high` [m], climbing towards `uphill`: one of +x, -x, +y, -y."""
        x0, x1, y0, y1 = rect
        share = (self.x - x0) / (x1 - x0) if uphill[1] == "x" else (self.y - y0) / (y1 - y0)
        if uphill[0] == "-":
            share = 1.0 - share
        self.raise_to(self.inside(rect), low + (high - low) * np.clip(share, 0.0, 1.0))

    def border(self, thickness: float, top: float) -> None:
        """A wall around everything."""
        x0, y0 = self.x[0, 0], self.y[0, 0]
        x1, y1 = self.x[-1, -1], self.y[-1, -1]
        edge = np.minimum(np.minimum(self.x - x0, x1 - self.x), np.minimum(self.y - y0, y1 - self.y))
        self.raise_to(edge <= thickness + 1e-6, top)

    def roughen(self, rect: Rect, amplitude: float, scale: float, seed: int) -> None:
        """Random relief of +-`amplitude` [m] and grain `scale` [m], fading out over 0.3 m to the rim."""
        random = np.random.default_rng(seed)
        x0, x1, y0, y1 = rect
        knots = random.uniform(-1.0, 1.0, (int((y1 - y0) / scale) + 3, int((x1 - x0) / scale) + 3))
        u, v = (self.x - x0) / scale, (self.y - y0) / scale
        where = self.inside(rect)
        j = np.clip(u.astype(int), 0, knots.shape[1] - 2)
        i = np.clip(v.astype(int), 0, knots.shape[0] - 2)
        a, b = _smooth(u - j), _smooth(v - i)
        relief = (1 - b) * ((1 - a) * knots[i, j] + a * knots[i, j + 1]) + b * (
            (1 - a) * knots[i + 1, j] + a * knots[i + 1, j + 1]
        )
        rim = np.minimum(np.minimum(self.x - x0, x1 - self.x), np.minimum(self.y - y0, y1 - self.y))
        relief *= amplitude * np.clip(rim / 0.3, 0.0, 1.0)
        np.copyto(self.height, self.height + relief, where=where)

    def array(self) -> NDArray[np.float32]:
        """(rows, cols) float32 [m]."""
        return self.height.astype(np.float32)


def _smooth(t: NDArray[np.float64]) -> NDArray[np.float64]:
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
