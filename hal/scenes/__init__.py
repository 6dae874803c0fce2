"""Terrain for the simulated robot: built-in scenes and scenes read from files."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from pathlib import Path

from hal.scenes import lanes, places, rescue
from hal.scenes.barn import barn
from hal.scenes.maze import maze
from hal.scenes.meadow import meadow
from hal.scenes.scene import Goal, Pose, Scene, SceneError
from hal.scenes.yard import field, flat, yard

__all__ = ["DEFAULT_SCENE", "Goal", "Pose", "Scene", "SceneError", "load_scene", "scene_names"]

DEFAULT_SCENE = "yard"

_BUILT_IN: dict[str, Callable[[], Scene]] = {
    "flat": flat,
    "field": field,
    "field_wall": lambda: field("wall"),
    "field_posts": lambda: field("posts"),
    "yard": yard,
    "maze": maze,
    "meadow": meadow,
    "rescue_slopes": rescue.slopes,
    "rescue_platform": rescue.platform,
    "rescue_steps": rescue.steps,
    "rescue_elevated": rescue.elevated,
    "lanes": lambda: lanes.lane(0).scene,
    "places": lambda: places.named("places").scene,
    "barn": lambda: barn(0),
}


SEEDED = ("maze", "lanes", "places", "barn")
"""Scenes that are another one for every seed."""


def scene_names() -> list[str]:
    """The built-in scenes."""
    return list(_BUILT_IN)


def load_scene(
    name: str | Path,
    *,
    resolution: float | None = None,
    height_range: tuple[float, float] | None = None,
    seed: int | None = None,
    start: Pose | None = None,
    units: str | None = None,
    up: str | None = None,
    **unknown: object,
) -> Scene:
    """A built-in scene by name, or a scene from a file (.npz, .png, .ply, .pcd, .stl, .obj, .world of the BARN
    challenge).

    `resolution` [m] and `height_range` [m], `units` and `up` say how to import a file, `start` where the robot starts
    on it (see `hal.scenes.files.read_scene`). `seed` picks a maze, a lane, a place or a world of the BARN challenge;
    `maze:7`, `lanes:7`, `places:house,7` and `barn:7` do the same in one word (see `hal.scenes.lanes` for more
    words). Raises SceneError."""
    if unknown:
        raise SceneError(
            f"no scene option {', '.join(sorted(unknown))}: there are resolution, height_range, start, units, up, seed"
        )
    if resolution is not None:
        (resolution,) = _numbers("resolution", [resolution], 1)
    if height_range is not None:
        low, high = _numbers("height_range", height_range, 2)
        height_range = (low, high)
    if start is not None:
        x, y, yaw = _numbers("start", start, 3)
        start = (x, y, yaw)
    if seed is not None:
        (value,) = _numbers("seed", [seed], 1)
        if value < 0 or value != int(value):
            raise SceneError(f"seed must be a whole number from 0 on, got {seed}")
        seed = int(value)
    text = str(name)
    base, _, number = text.partition(":")
    if base in ("maze", "barn") and not Path(text).is_file():
        if number and not number.isdecimal():
            raise SceneError(f"{text!r}: the seed after {base}: must be a whole number")
        seed = int(number) if number else seed
    if base in _BUILT_IN and (not number or base in SEEDED):
        if not resolution is height_range is start is units is up is None:
            raise SceneError(
                f"{base} is built in: resolution, height range, start, units and up are for files"
            )
        if base == "lanes":
            return lanes.named(text if seed is None else f"lanes:{seed}").scene
        if base == "places":
            return places.named(text if seed is None else f"{text},{seed}").scene
        if base == "maze":
            return maze(seed=seed or 0)
        if base == "barn":
            return barn(seed or 0)
        if seed is not None:
            raise SceneError(f"{base} has no seed: only {', '.join(SEEDED)} have")
        return _BUILT_IN[base]()
    if not Path(text).suffix:
        raise SceneError(f"no scene {text!r}: use one of {', '.join(_BUILT_IN)}, or a file")
    from hal.scenes.files import read_scene  # readers are only needed for files

    if seed is not None:
        raise SceneError(f"a scene from a file has no seed: only {', '.join(SEEDED)} have")
    return read_scene(
        Path(text), resolution=resolution, height_range=height_range, start=start, units=units, up=up
    )


def _numbers(option: str, values: object, count: int) -> list[float]:
    """Options come from command lines and config files: check before use."""
    try:
        numbers = [float(v) for v in values]  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count or not all(isfinite(v) for v in numbers):
        raise SceneError(f"{option} must be {count} finite number{'s' * (count > 1)}, got {values}")
    return numbers
