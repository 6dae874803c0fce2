"""`explore`: see all ground of an area and come home."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Annotated

import typer

from rbtrg_robot.cli.drive import Robot
from rbtrg_robot.scope import ROBOT
from rbtrg_robot.terminal import say


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(context_settings={"ignore_unknown_options": True})(explore)


def explore(
    corners: Annotated[
        list[str] | None, typer.Argument(help="X0 Y0 X1 Y1: two corners of the area [m], frame map.")
    ] = None,
    area: Annotated[
        str, typer.Option("--area", help="FILE (YAML: a list of corners [x, y] in metres), or X0 Y0 X1 Y1.")
    ] = "",
    minutes: Annotated[
        float, typer.Option(min=0.0, help="Be back after about so many minutes; 0 = no limit.")
    ] = 0.0,
    until: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="End when this share of the area is seen; 0 = all of it.")
    ] = 0.0,
    back: Annotated[bool, typer.Option("--return/--no-return", help="Come home at the end.")] = True,
    accept: Annotated[
        bool, typer.Option("--accept", help="Come home although the way is likely to fail.")
    ] = False,
    wait: Annotated[bool, typer.Option("--wait", help="Watch until its end.")] = False,
    robot: Robot = ROBOT,
) -> None:
    """See all ground that can be reached. Or all of an area, and come home. Exit status as of `mission run`."""
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.cli.mission import send
    from rbtrg_robot.missions.file import exploration
    from rbtrg_robot.orders.who import me

    ground = {
        "area": _area([*([area] if area else []), *(corners or [])]),
        "minutes": minutes,
        "until": until,
    }
    mission = exploration(ground, back=back, accept=accept)
    with connect(robot) as bus:
        code, state = send(bus, mission.order(uuid.uuid4().hex[:12], owner=me()), wait=wait)
    if state is not None and wait:
        for line in state.result_description[0].split("; "):
            say(line)
        if code == 0 and state.action_status[0] == "FAILED":
            code = 3
    raise typer.Exit(code)


def _area(words: list[str]) -> list[list[float]]:
    from rbtrg_robot import yaml_file
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.yaml_file import YamlError

    if not words:
        return []
    if len(words) == 1:
        try:
            content = yaml_file.read(Path(words[0]))
        except OSError as error:
            raise ConfigError(
                f"cannot read {words[0]}: {error.strerror}; an area is a FILE or X0 Y0 X1 Y1 in metres"
            ) from error
        except YamlError as error:
            raise ConfigError(f"{words[0]} is not YAML: {error}") from error
        if not isinstance(content, list):
            raise ConfigError(f"{words[0]} must hold a list of corners [x, y] in metres")
        return content
    try:
        x0, y0, x1, y1 = (float(word) for word in words)
    except ValueError as error:
        raise ConfigError(f"an area is a FILE or X0 Y0 X1 Y1 in metres, got {' '.join(words)!r}") from error
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
