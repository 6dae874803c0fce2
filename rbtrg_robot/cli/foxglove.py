"""`foxglove`: the stack in the Foxglove app."""

from __future__ import annotations

import importlib.util
from typing import Annotated

import typer

from rbtrg_robot.cli.drive import Robot
from rbtrg_robot.scope import ROBOT
from rbtrg_robot.terminal import say


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(foxglove)


def foxglove(
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="TCP port; 0 = any.")] = 8765,
    view_only: Annotated[
        bool, typer.Option("--view-only", help="Take no goals; the stop is always taken.")
    ] = False,
    origin: Annotated[
        list[str] | None,
        typer.Option(metavar="URL", help="Web page that may connect beside the app: http://HOST:PORT."),
    ] = None,
    robot: Robot = ROBOT,
) -> None:
    """Serve the topics to the Foxglove app until Ctrl-C. On an address other than loopback no goals are taken."""
    from hal.errors import OperatorError
    from rbtrg_robot.cli.link import connect

    if importlib.util.find_spec("websockets") is None:
        raise OperatorError("websockets is not installed: `uv sync --extra foxglove`")
    from rbtrg_robot.bridge.foxglove import Foxglove

    local = host in ("127.0.0.1", "::1", "localhost")
    commands = local and not view_only
    with connect(robot) as bus:
        server = Foxglove(bus, host, port, commands=commands, origins=origin or ())
        taken = "goals and the stop" if commands else "only the stop"
        say(f"ws://{host}:{server.port}, takes {taken}; Ctrl-C ends it")
        try:
            server.run(lambda: False)
        except KeyboardInterrupt:
            return
