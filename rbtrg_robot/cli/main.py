"""The command line. Only what `--help` needs is imported here; each command brings the rest itself."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from rbtrg_robot import __version__
from rbtrg_robot.cli import (
    build,
    calibrate,
    convert,
    drive,
    explore,
    foxglove,
    home,
    importing,
    inspect,
    judging,
    keys,
    logs,
    mission,
    plan,
    policy,
    robots,
    service,
    stack,
    step,
    teleop,
    topic,
)
from rbtrg_robot.terminal import say

app = typer.Typer(
    name="rbtrg-robot",
    help="Bring a wheeled-legged robot up, send it goals, watch it, and replay what it did.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(show: bool) -> None:
    if show:
        say(f"rbtrg-robot {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand != "up":  # it counts the kernels itself
        from rbtrg_robot.cli.first_use import tell_once

        tell_once(lambda line: say(line, error=True))


stack.register(app)
drive.register(app)
home.register(app)
explore.register(app)
mission.register(app)
teleop.register(app)
logs.register(app)
judging.register(app)
step.register(app)
importing.register(app)
plan.register(app)
foxglove.register(app)
topic.register(app)
inspect.register(app)
build.register(app)
convert.register(app)
service.register(app)
keys.register(app)
calibrate.register(app)
policy.register(app)
robots.register(app)


def main() -> None:
    """Entry point: errors become one line and exit status 1."""
    try:
        app()
    except (KeyboardInterrupt, BrokenPipeError):
        sys.exit(130)
    except Exception as error:  # noqa: BLE001  the last place where an error can become one line
        from hal.errors import OperatorError, one_line

        text = one_line(error)
        if not isinstance(error, OperatorError):
            text = f"a fault in the program ({type(error).__name__}: {text}); {_keep(error)}"
        say(f"rbtrg-robot: {text}", error=True)
        sys.exit(1)


def _keep(error: Exception) -> str:
    """The traceback is for the developer: it goes to a file, and the operator is told where."""
    import tempfile
    import traceback

    with tempfile.NamedTemporaryFile("w", prefix="rbtrg-robot-", suffix=".txt", delete=False) as file:
        traceback.print_exception(error, file=file)
    return f"please report it with {file.name}"
