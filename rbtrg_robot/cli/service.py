"""`service`: the stack as a service of systemd."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import say, say_text

app = typer.Typer(help="The stack as a service of systemd.", no_args_is_help=True)
User = Annotated[bool, typer.Option("--user", help="A service of yours, not of the whole computer.")]


def register(main: typer.Typer) -> None:
    """Add the commands."""
    main.add_typer(app, name="service")


@app.command()
def install(
    config: Annotated[Path | None, typer.Option(help="YAML configuration of the stack.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="Set one key.")] = None,
    robot: Annotated[
        str | None, typer.Option("--robot", envvar=NAMED, help="Name of the robot, over the configuration's.")
    ] = None,
    user: User = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the unit file, write nothing.")] = False,
) -> None:
    """Write the unit file. It is `up` of this installation with this configuration."""
    from rbtrg_robot.config import load
    from rbtrg_robot.process import service

    loaded = load(config, set_ or (), robot=robot)  # a wrong key fails here, not at the next boot
    options = [] if config is None else ["--config", str(config.resolve())]
    for one in set_ or ():
        options += ["--set", one]
    options += [] if robot is None else ["--robot", robot]
    text = service.unit(loaded.robot, options, user=user)
    if dry_run:
        say_text(text)
        return
    path = service.unit_path(loaded.robot, user=user)
    service.write(path, text)
    name = service.unit_name(loaded.robot)
    systemctl = "systemctl --user" if user else "sudo systemctl"
    say(f"{path} is written: {loaded.backend} backend, robot {loaded.robot!r}. Next:")
    say(f"  {systemctl} daemon-reload")
    say(f"  {systemctl} enable --now {name}")
    if user:
        say("  loginctl enable-linger        # it starts at boot and goes on after you log out")
        say(f"  rbtrg-robot status --robot {loaded.robot}")
    else:
        folder = f"XDG_RUNTIME_DIR=/run/{name}"
        say(f"  {folder} rbtrg-robot status --robot {loaded.robot}        # as user {service.account()}")


@app.command()
def show(
    robot: Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")] = ROBOT,
    user: User = False,
) -> None:
    """Print the unit file that is installed."""
    from rbtrg_robot.process import service

    path = service.unit_path(robot, user=user)
    try:
        text = path.read_text()
    except OSError as error:
        raise service.ServiceError(
            f"cannot read {path}: {error.strerror}; write it with `rbtrg-robot service install`"
        ) from error
    say(f"# {path}")
    say_text(text)
