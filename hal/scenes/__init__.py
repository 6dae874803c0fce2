"""Terrain for the simulated robot: built-in scenes and scenes read from files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hal.scenes import rescue
from hal.scenes.maze import maze
from hal.scenes.scene import Goal, Pose, Scene, SceneError
from hal.scenes.yard import flat, yard

__all__ = ["Goal", "Pose", "Scene", "SceneError", "load_scene", "scene_names"]

_BUILT_IN: dict[str, Callable[..., Scene]] = {
    "flat": flat,
    "yard": yard,
    "maze": maze,
    "rescue_slopes": rescue.slopes,
    "rescue_platform": rescue.platform,
    "rescue_steps": rescue.steps,
    "rescue_elevated": rescue.elevated,
}


def scene_names() -> list[str]:
    """The built-in scenes."""
    return list(_BUILT_IN)


def load_scene(name: str, **options: Any) -> Scene:
    """A built-in scene by name. Raises SceneError."""
    if name not in _BUILT_IN:
        raise SceneError(f"no scene {name!r}: use one of {', '.join(_BUILT_IN)}")
    return _BUILT_IN[name](**options)
