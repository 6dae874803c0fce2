"""A scene as a picture: colour by height, hillshade, start, goals and benchmark pairs."""

from __future__ import annotations

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


def render_scene_png(scene: Scene, path: str | Path, *, size: int = 900) -> None:
    """Write a PNG of about `size` pixels on its longer side, north (y) up."""
    rows, cols = scene.height.shape
    zoom = size / max(rows, cols)
    image = Image.fromarray(_relief(scene)[::-1]).resize(
        (max(1, round(cols * zoom)), max(1, round(rows * zoom))), Image.Resampling.BILINEAR
    )
    draw = ImageDraw.Draw(image)
    letter = max(11, size // 60)
    font = ImageFont.load_default(size=letter)
    x0, y0 = scene.origin

    def pixel(x: float, y: float) -> tuple[float, float]:
        return ((x - x0) / scene.resolution + 0.5) * zoom, (rows - 0.5 - (y - y0) / scene.resolution) * zoom

    if scene.allowed_area:
        outline = [pixel(x, y) for x, y in scene.allowed_area]
        draw.line([*outline, outline[0]], fill=(255, 255, 255), width=1)
    for start, goal in scene.pairs:
        draw.line([pixel(*start), pixel(*goal)], fill=(255, 255, 255), width=1)
        _disc(draw, pixel(*start), 3, (80, 220, 120))
        _disc(draw, pixel(*goal), 3, (235, 60, 60))
    metre = zoom / scene.resolution
    for name, (x, y, yaw) in scene.goals.items():
        _arrow(draw, pixel(x, y), yaw, 0.35 * metre, (235, 60, 60))
        _label(draw, pixel(x, y), name, font)
    _arrow(draw, pixel(*scene.start[:2]), scene.start[2], 0.5 * metre, (80, 220, 120))
    _label(draw, (8 + metre, image.height - 2.2 * letter), "1 m", font)
    draw.line([(8, image.height - 10), (8 + metre, image.height - 10)], fill=(255, 255, 255), width=3)
    image.save(path)


def _relief(scene: Scene) -> NDArray[np.uint8]:
    """(rows, cols, 3): height colours times the light from the north-west."""
    height = scene.height.astype(np.float64)
    low, high = np.percentile(height, [0.5, 99.5])
    share = np.clip((height - low) / max(high - low, 1e-6), 0.0, 1.0)
    at = [s[0] for s in STOPS]
    colour = np.stack([np.interp(share, at, [s[1][k] for s in STOPS]) for k in range(3)], axis=-1)
    sy, sx = np.gradient(height, scene.resolution)
    light = (0.5 * sx - 0.5 * sy + 0.7071) / np.sqrt(1.0 + sx**2 + sy**2)
    shade = 0.35 + 0.75 * np.clip(light, 0.0, 1.0)
    shade = np.where(scene.trusted, shade, 0.45 * shade)
    return np.clip(colour * shade[..., None], 0, 255).astype(np.uint8)


def _disc(draw: ImageDraw.ImageDraw, at: tuple[float, float], r: float, colour: tuple[int, int, int]) -> None:
    draw.ellipse([at[0] - r, at[1] - r, at[0] + r, at[1] + r], fill=colour, outline=(20, 20, 20))


def _arrow(
    draw: ImageDraw.ImageDraw,
    at: tuple[float, float],
    yaw: float | None,
    length: float,
    colour: tuple[int, int, int],
) -> None:
    if yaw is not None:
        tip = (at[0] + length * cos(yaw), at[1] - length * sin(yaw))
        draw.line([at, tip], fill=colour, width=3)
        for side in (2.6, -2.6):
            wing = (tip[0] + 0.4 * length * cos(yaw + side), tip[1] - 0.4 * length * sin(yaw + side))
            draw.line([tip, wing], fill=colour, width=3)
    _disc(draw, at, 5, colour)


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
