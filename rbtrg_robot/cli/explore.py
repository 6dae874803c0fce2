"""`explore`: see all ground of an area; `cover`: drive over it in lanes; and come home."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from rbtrg_robot.cli.drive import Robot
from rbtrg_robot.scope import ROBOT
from rbtrg_robot.terminal import say


def register(app: typer.Typer) -> None:
    """Add the command."""
    for command in (explore, cover):
        app.command(context_settings={"ignore_unknown_options": True})(command)


Corners = Annotated[
    list[str] | None, typer.Argument(help="X0 Y0 X1 Y1: two corners of the area [m], frame map.")
]
Area = Annotated[
    str, typer.Option("--area", help="FILE (YAML: a list of corners [x, y] in metres), or X0 Y0 X1 Y1.")
]
Minutes = Annotated[float, typer.Option(min=0.0, help="Be back after about so many minutes; 0 = no limit.")]
Back = Annotated[bool, typer.Option("--return/--no-return", help="Come home at the end.")]
Accept = Annotated[bool, typer.Option("--accept", help="Come home although the way is likely to fail.")]
Wait = Annotated[bool, typer.Option("--wait", help="Watch until its end.")]


def explore(
    corners: Corners = None,
    area: Area = "",
    minutes: Minutes = 0.0,
    until: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="End when this share of the area is seen; 0 = all of it.")
    ] = 0.0,
    back: Back = True,
    accept: Accept = False,
    wait: Wait = False,
    robot: Robot = ROBOT,
) -> None:
    """See all ground that can be reached. Or all of an area, and come home. Exit status as of `mission run`."""
    ground = {"area": _area(area, corners), "minutes": minutes, "until": until}
    _go_out("explore", ground, back=back, accept=accept, wait=wait, robot=robot)


def cover(
    corners: Corners = None,
    area: Area = "",
    swath: Annotated[
        float,
        typer.Option(min=0.3, max=50.0, help="From one lane to the next: as wide as the sensor sees [m]."),
    ] = 2.0,
    minutes: Minutes = 0.0,
    back: Back = True,
    accept: Accept = False,
    wait: Wait = False,
    robot: Robot = ROBOT,
) -> None:
    """Drive over an area in lanes, and come home. Exit status as of `mission run`."""
    ground = {"area": _area(area, corners), "minutes": minutes, "swath": swath}
    _go_out("cover", ground, back=back, accept=accept, wait=wait, robot=robot)


def _go_out(
    kind: Literal["explore", "cover"],
    ground: dict[str, Any],
    *,
    back: bool,
    accept: bool,
    wait: bool,
    robot: str,
) -> None:
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.cli.mission import send
    from rbtrg_robot.missions.file import outing
    from rbtrg_robot.orders.who import me

    mission = outing(kind, ground, back=back, accept=accept)
    with connect(robot) as bus:
        code, state = send(bus, mission.order(uuid.uuid4().hex[:12], owner=me()), wait=wait)
    if state is not None and wait:
        for line in state.result_description[0].split("; "):
            say(line)
        if code == 0 and state.action_status[0] == "FAILED":
            code = 3
    raise typer.Exit(code)


def _area(area: str, corners: list[str] | None) -> list[list[float]]:
    from rbtrg_robot import yaml_file
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.yaml_file import YamlError

    words = [*([area] if area else []), *(corners or [])]
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
