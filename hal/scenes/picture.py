"""Ground seen from above: colour by height, hillshade, and what is drawn on it."""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, sin
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from hal.scenes.scene import Scene

STOPS = (
    (0.0, (38, 62, 92)),
    (0.3, (70, 130, 120)),
    (0.55, (190, 190, 120)),
    (0.8, (205, 140, 90)),
    (1.0, (245, 240, 235)),
)
"""Colours from the lowest to the highest point."""


Colour = tuple[int, int, int]
WHITE: Colour = (255, 255, 255)
RED: Colour = (235, 60, 60)
ORANGE: Colour = (224, 140, 64)
GREEN: Colour = (80, 220, 120)


class TopView:
    """A picture of an elevation grid, north (y) up, with things drawn at their place in metres."""

    def __init__(
        self,
        height: NDArray[np.floating],
        trusted: NDArray[np.bool_],
        origin: tuple[float, float],
        resolution: float,
        size: int = 900,
        assumed: NDArray[np.bool_] | None = None,
    ) -> None:
        """`height` (rows, cols) [m], finite; `trusted` (rows, cols), False is drawn dark; `assumed` (rows, cols) is
        drawn orange; `origin`: x, y [m] of the centre of cell [0, 0]; `resolution` [m]; `size`: pixels of the longer
        side."""
        self._rows, cols = height.shape
        self._zoom = size / max(self._rows, cols)
        self._origin = origin
        self._resolution = resolution
        pixels = max(1, round(cols * self._zoom)), max(1, round(self._rows * self._zoom))
        colours = _relief(np.asarray(height, np.float64), trusted, resolution)
        if assumed is not None:
            colours[assumed] = ORANGE
        relief = Image.fromarray(colours[::-1])
        self._image = relief.resize(pixels, Image.Resampling.BILINEAR)
        self._draw = ImageDraw.Draw(self._image)
        self._letter = max(11, size // 60)
        self._font = ImageFont.load_default(size=self._letter)

    @property
    def metre(self) -> float:
        """Pixels."""
        return self._zoom / self._resolution

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Of a place [m]."""
        x0, y0 = self._origin
        column, row = (x - x0) / self._resolution, (y - y0) / self._resolution
        return (column + 0.5) * self._zoom, (self._rows - 0.5 - row) * self._zoom

    def line(self, points: Iterable[tuple[float, float]], colour: Colour, width: int = 1) -> None:
        """Through the points [m]."""
        self._draw.line([self.pixel(x, y) for x, y in points], fill=colour, width=width)

    def disc(self, x: float, y: float, colour: Colour, radius: int = 3) -> None:
        """`radius` [pixels]."""
        px, py = self.pixel(x, y)
        box = [px - radius, py - radius, px + radius, py + radius]
        self._draw.ellipse(box, fill=colour, outline=(20, 20, 20))

    def arrow(self, x: float, y: float, yaw: float | None, length: float, colour: Colour) -> None:
        """From x, y [m] towards `yaw` [rad], `length` [m]; a disc alone without a yaw."""
        if yaw is not None:
            tip = (x + length * cos(yaw), y + length * sin(yaw))
            self.line([(x, y), tip], colour, 3)
            for side in (2.6, -2.6):
                wing = 0.4 * length * cos(yaw + side), 0.4 * length * sin(yaw + side)
                self.line([tip, (tip[0] + wing[0], tip[1] + wing[1])], colour, 3)
        self.disc(x, y, colour, 5)

    def label(self, x: float, y: float, text: str) -> None:
        """Beside x, y [m]."""
        _label(self._draw, self.pixel(x, y), text, self._font)

    def image(self) -> Image.Image:
        """With a bar of one metre."""
        left, bottom = 8, self._image.height - 10
        self._draw.line([(left, bottom), (left + self.metre, bottom)], fill=WHITE, width=3)
        _label(self._draw, (left + self.metre, self._image.height - 2.2 * self._letter), "1 m", self._font)
        return self._image

    def save(self, path: str | Path) -> None:
        """As PNG."""
        self.image().save(path)


def render_scene_png(scene: Scene, path: str | Path, *, size: int = 900) -> None:
    """Write a PNG of a scene with its start, goals and first ten benchmark pairs, `size` pixels on its longer side."""
    view = TopView(scene.height, scene.trusted, scene.origin, scene.resolution, size)
    if scene.allowed_area:
        view.line([*scene.allowed_area, scene.allowed_area[0]], WHITE)
    for start, goal in scene.pairs[:10]:
        view.line([start, goal], WHITE)
        view.disc(*start, GREEN)
        view.disc(*goal, RED)
    for name, (x, y, yaw) in scene.goals.items():
        view.arrow(x, y, yaw, 0.35, RED)
        view.label(x, y, name)
    view.arrow(*scene.start, 0.5, GREEN)
    view.save(path)


def _relief(height: NDArray[np.float64], trusted: NDArray[np.bool_], resolution: float) -> NDArray[np.uint8]:
    """(rows, cols, 3): height colours times the light from the north-west."""
    low, high = np.percentile(height, [0.5, 99.5])
    share = np.clip((height - low) / max(high - low, 1e-6), 0.0, 1.0)
    at = [s[0] for s in STOPS]
    colour = np.stack([np.interp(share, at, [s[1][k] for s in STOPS]) for k in range(3)], axis=-1)
    sy, sx = np.gradient(height, resolution)
    light = (0.5 * sx - 0.5 * sy + 0.7071) / np.sqrt(1.0 + sx**2 + sy**2)
    shade = 0.35 + 0.75 * np.clip(light, 0.0, 1.0)
    shade = np.where(trusted, shade, 0.45 * shade)
    return np.clip(colour * shade[..., None], 0, 255).astype(np.uint8)


def _label(
    draw: ImageDraw.ImageDraw,
    at: tuple[float, float],
    text: str,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
) -> None:
    draw.text(
        (at[0] + 8, at[1] + 4),
        text,
        font=font,
        fill=(255, 255, 255),
        stroke_width=2,
        stroke_fill=(20, 20, 20),
    )
