"""`robot`: what robots there are, and what a folder lacks to be one."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from rbtrg_robot.terminal import say, say_json

robot_app = typer.Typer(help="Robots: folders that say what one is.", no_args_is_help=True)
Which = Annotated[str, typer.Argument(metavar="NAME|FOLDER", help="A name of `robot list`, or a folder.")]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON.")]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(robot_app, name="robot")


@robot_app.command("list")
def robot_list(as_json: AsJson = False) -> None:
    """The robots that come along, the default one first."""
    from hal.robots import DEFAULT, describe, names

    known = [describe(name) for name in sorted(names(), key=lambda name: (name != DEFAULT, name))]
    if as_json:
        say_json([{"name": robot.name, "title": robot.title, "folder": str(robot.folder)} for robot in known])
        return
    for robot in known:
        say(f"{robot.name:<8} {robot.title}; {', '.join(robot.backends)}; {', '.join(robot.controllers)}")


@robot_app.command("show")
def robot_show(which: Which = "", as_json: AsJson = False) -> None:
    """The facts of a robot."""
    from hal.robots import DEFAULT, describe

    robot = describe(which or DEFAULT)
    if as_json:
        say_json(robot.model_dump(mode="json"))
        return
    body = robot.body
    say(f"{robot.title} ({robot.folder})")
    say(
        f"  body       {body.length} x {body.width} m, {body.mass} kg, base_link {robot.height:.3f} m above ground"
    )
    say(
        f"  stands on  {'wheels' if robot.wheeled else 'feet'} of {robot.limbs.radius} m, "
        f"{2 * robot.limbs.tread:.3f} m apart"
    )
    for lidar in robot.mounted(robot.lidars):
        assert lidar.mount is not None
        say(
            f"  lidar      {lidar.name}: {lidar.model} at {', '.join(f'{v:g}' for v in lidar.mount.translation)}"
        )
    say(f"  backends   {', '.join(robot.backends)}")
    for name, controller in robot.controllers.items():
        able = robot.capabilities(name)
        say(
            f"  {name:<10} {controller.what}: {able.max_vx:g} m/s, faces of {able.max_step:.2f} m, "
            f"slopes of {math.degrees(able.max_slope):.0f} deg, gaps of {able.max_gap:.2f} m"
        )


@robot_app.command("check")
def robot_check(which: Which) -> None:
    """What a folder lacks, and what that costs. It is built, put on flat ground and driven. Exit status 1 where
    something is wrong."""
    from hal.robots import describe
    from hal.robots.check import findings

    robot = describe(which)
    say(f"{robot.title} ({robot.folder})")
    wrong = 0
    for finding in findings(robot):
        say(f"  {finding.verdict:<8} {finding.words}")
        wrong += finding.verdict == "wrong"
    if wrong:
        say(f"{wrong} wrong: mend {robot.folder}, then check again")
        raise typer.Exit(1)
