"""Robots by their names or folders."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import yaml
from pydantic import ValidationError

from hal.robots.robot import Robot, RobotError

FILE = "robot.yaml"
DEFAULT = "go2w"
"""The robot of a name that says no other."""
_FOLDER = Path(__file__).parent


def names() -> list[str]:
    """The robots of ours."""
    return sorted(file.parent.name for file in _FOLDER.glob(f"*/{FILE}"))


def folder_of(name: str) -> Path:
    """Folder of a robot of ours, or of a path. Raises RobotError."""
    own = _FOLDER / name
    folder = own if name and (own / FILE).is_file() else Path(name)
    if not (folder / FILE).is_file():
        raise RobotError(f"no robot {name!r}: use {', '.join(names())}, or a folder that holds {FILE}")
    return folder


@cache
def describe(name: str = DEFAULT) -> Robot:
    """A robot by its name or folder. Raises RobotError."""
    folder = folder_of(name)
    file = folder / FILE
    try:
        values = yaml.load(file.read_text(), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RobotError(f"cannot read {file}: {error}") from error
    if not isinstance(values, dict):
        raise RobotError(f"{file} must hold `key: value` lines")
    try:
        return Robot.model_validate({**values, "folder": folder})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise RobotError(f"{file}: {where or 'it'}: {first['msg']}{more}") from error


def envelope_file(controller: str) -> Path:
    """Of `CONTROLLER` of the default robot, or of `ROBOT/CONTROLLER`. Raises RobotError."""
    robot, _, name = controller.rpartition("/")
    return describe(robot or DEFAULT).envelope_file(name)
