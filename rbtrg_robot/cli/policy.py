"""`policy`."""

from __future__ import annotations

from typing import Annotated

import typer

from rbtrg_robot.terminal import say

policy_app = typer.Typer(help="Learnt locomotion policies of others.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(policy_app, name="policy")


Model = Annotated[str, typer.Option("--robot-model", help="Name or folder of the robot.")]


@policy_app.command("get")
def policy_get(
    name: Annotated[str, typer.Argument(help="Of the policy; a wrong one lists those that are known.")],
    source: Annotated[
        str,
        typer.Option(help="Another URL that holds the repository's files; they are checked all the same."),
    ] = "",
    model: Model = "",
) -> None:
    """Fetch a public policy, check it, keep it in the data folder. `--policy NAME` then finds it."""
    from hal.robots import DEFAULT, RobotError, describe

    robot = describe(model or DEFAULT)
    if not robot.fetches:
        raise RobotError(f"robot {robot.name} knows no public policies: `fetches` in its robot.yaml is empty")
    for line in robot.load(robot.fetches)(name, source):
        say(line)


@policy_app.command("check")
def policy_check(
    policy: Annotated[
        str, typer.Argument(help="Folder, description or file of a policy, or name of a fetched one.")
    ],
    controller: Annotated[str, typer.Option(help="That drives with it.")] = "policy",
    model: Model = "",
) -> None:
    """What a policy needs, and what it does in simulation.

    It tells what a robot that stands would be asked for first, then drives the simulated one on flat ground. Exit
    status 1 where it does not drive.
    """
    from hal.robots import DEFAULT, RobotError, describe
    from hal.robots.check import driven

    robot = describe(model or DEFAULT)
    if not robot.tells:
        raise RobotError(f"robot {robot.name} takes no learnt policies: `tells` in its robot.yaml is empty")
    for line in robot.load(robot.tells)(policy):
        say(line)
    finding = driven(robot, controller, policy)
    say(f"{finding.verdict}: {finding.words}")
    if finding.verdict != "ok":
        raise typer.Exit(1)
