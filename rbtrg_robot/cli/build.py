"""`map build`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rbtrg_robot.cli.inspect import map_app
from rbtrg_robot.terminal import say, say_json

if TYPE_CHECKING:
    from rbtrg_robot.hosts.map_build import Built

NOT_FOUND = 3
"""Exit status: a run is not in the map, because it was not found in those before."""


def register(app: typer.Typer) -> None:
    """Add the command to `map`, which `inspect` adds to the app."""
    del app
    map_app.command("build")(map_build)


def map_build(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Logs: a run's folder, or an .mcap file.")
    ],
    out: Annotated[Path, typer.Option(help="The map (.npz); FILE.json and FILE.png are written beside it.")],
    config: Annotated[Path | None, typer.Option(help="YAML over the configuration in the logs.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="Set one key.")] = None,
    drift: Annotated[
        float,
        typer.Option(help="How many times more than the robot's own the odometry of these logs drifts."),
    ] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable.")] = False,
) -> None:
    """Make one map of one or more runs whose loops are closed. Exit status 3: a run was not found in those before it
    and is left out."""
    from rich.console import Console
    from rich.progress import Progress

    from rbtrg_robot.hosts.map_build import build

    with Progress(console=Console(stderr=True), disable=not sys.stderr.isatty()) as bar:
        tasks: dict[str, Any] = {}

        def progress(what: str, share: float) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=1.0)
            bar.update(tasks[what], completed=share)

        built = build(
            runs,
            out,
            file=config,
            sets=set_ or (),
            drift=drift,
            progress=progress,
            say=lambda text: say(f"note: {text}", error=True),
        )
    if as_json:
        say_json(built.record)
    else:
        _tell(built, out)
    if built.record["not_in_the_map"]:
        raise typer.Exit(NOT_FOUND)


def _tell(built: Built, out: Path) -> None:
    record = built.record
    for number, run in enumerate(record["runs"], 1):
        say(f"run {number}: {run['driven_m']:.0f} m, {run['scans']} scans, {run['kept']} kept  {run['log']}")
    for loop in record["closed"]:
        say(
            f"closed   {loop['first']:4d} - {loop['second']:4d}  {loop['certainty']:.0%} certain, off by "
            f"{loop['residual_m']:.3f} m and {loop['residual_deg']:.2f} deg"
        )
    for loop in record["refused"]:
        say(f"refused  {loop['first']:4d} - {loop['second']:4d}  {loop['why']}")
    say(
        f"{len(record['keyframes'])} keyframes, {len(record['closed'])} loops closed, "
        f"{len(record['refused'])} refused; "
        f"the way moved by up to {record['moved_m']:.2f} m and {record['moved_deg']:.2f} deg"
    )
    for log in record["not_in_the_map"]:
        say(f"not in the map: {log} was not found in the runs before it", error=True)
    say(
        f"{record['known_cells']} known cells -> {out}; {out.with_suffix('.json')}, {out.with_suffix('.png')}"
    )
