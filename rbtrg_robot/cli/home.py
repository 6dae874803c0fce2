"""`home`: drive home, say where it is, put it elsewhere."""

from __future__ import annotations

import math
import uuid
from typing import TYPE_CHECKING, Annotated

import typer

from rbtrg_robot.cli.drive import Robot
from rbtrg_robot.scope import ROBOT
from rbtrg_robot.terminal import say

if TYPE_CHECKING:
    from rbtrg_robot.wire.bus import Bus

app = typer.Typer(
    help="Drive home: where the run began, or where `home set` put it. Exit status as of `goal`.",
    invoke_without_command=True,
)


def register(parent: typer.Typer) -> None:
    """Add the commands."""
    parent.add_typer(app, name="home")


@app.callback()
def home(
    context: typer.Context,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for the end.")] = False,
    timeout: Annotated[float, typer.Option(help="Give up after this many seconds; 0 = never.")] = 0.0,
    robot: Robot = ROBOT,
) -> None:
    """Drive home: where the run began, or where `home set` put it. Exit status as of `goal`."""
    if context.invoked_subcommand is not None:
        return
    import time

    from rbtrg_robot.cli.drive import send
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.orders.who import me
    from rbtrg_robot.stages.navigation.goal import goal_request

    with connect(robot) as bus:
        x, y, yaw = _where(bus)
        fields = {"name": "home", "timeout": timeout, "owner": me()}
        code = send(bus, goal_request(time.time_ns(), uuid.uuid4().hex[:12], x, y, yaw, **fields), wait=wait)
    raise typer.Exit(code)


@app.command("set", context_settings={"ignore_unknown_options": True})
def put(
    place: Annotated[
        list[float] | None, typer.Argument(help="X Y in metres, frame map; without: where the robot stands.")
    ] = None,
    yaw: Annotated[float, typer.Option(help="Heading at home [deg].")] = 0.0,
    robot: Robot = ROBOT,
) -> None:
    """Home is here, or at X Y, until the stack ends."""
    from rbtrg_robot import msg
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.orders.mission import TellMission
    from rbtrg_robot.orders.order import follow

    if place and len(place) != 2:
        raise ConfigError(f"home is X Y in metres, got {' '.join(map(str, place))}")
    order = msg.MissionOrder()
    if place:
        order = msg.MissionOrder(has_home=True, home_x=place[0], home_y=place[1], home_yaw=math.radians(yaw))
    with connect(robot) as bus:
        end = follow(bus, TellMission("home", order=order))
        if not end.ok:
            say(f"rbtrg-robot: {end.words}", error=True)
            raise typer.Exit(1)
        _tell(*_where(bus))


@app.command()
def show(robot: Robot = ROBOT) -> None:
    """Where home is."""
    from rbtrg_robot.cli.link import connect

    with connect(robot) as bus:
        _tell(*_where(bus))


def _tell(x: float, y: float, yaw: float) -> None:
    say(f"home is at {x:.2f} {y:.2f}, heading {math.degrees(yaw):.0f} deg")


def _where(bus: Bus) -> tuple[float, float, float]:
    """x, y [m], heading [rad] in `map`. Exits where that is not known."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.mission import newest

    bus.subscribe([t.MISSION_STATE])
    state = newest(bus)
    if not state.has_home:
        say(
            "rbtrg-robot: where home is is not known: the robot does not know yet where it is; see "
            "`rbtrg-robot status`",
            error=True,
        )
        raise typer.Exit(1)
    return state.home_x, state.home_y, state.home_yaw
