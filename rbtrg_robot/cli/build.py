"""`map build`, and `map close` of the run that goes on."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rbtrg_robot.cli.inspect import map_app
from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import say, say_json

if TYPE_CHECKING:
    from rbtrg_robot.hosts.map_build import Built, Progress

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]
LINE_PERIOD = 5.0
"""[s] between two lines of progress where there is no terminal."""
NOT_FOUND = 3
"""Exit status: a run is not in the map, because it was not found in those before."""


def register(app: typer.Typer) -> None:
    """Add the command to `map`, which `inspect` adds to the app."""
    del app
    map_app.command("build")(map_build)
    map_app.command("close")(map_close)


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
    from rbtrg_robot.hosts.map_build import build

    with _progress() as progress:
        built = build(runs, out, file=config, sets=set_ or (), drift=drift, progress=progress, say=_note)
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


def map_close(
    out: Annotated[
        Path | None, typer.Option(help="The map (.npz); default: closed.npz in the run's folder.")
    ] = None,
    least: Annotated[
        float, typer.Option(min=0.0, help="A map that moves less than this [m] is not taken.")
    ] = 0.1,
    drift: Annotated[
        float, typer.Option(help="How many times more than usual the odometry of this run drifts.")
    ] = 1.0,
    robot: Robot = ROBOT,
) -> None:
    """Close the loops of the map while the stack runs.

    On the robot's computer; the robot may drive. Its log so far becomes a map as by `build`. The robot goes on with it:
    at once where it stands; while it drives it moves in the map by 2 cm/s, and keeps its goal.
    """
    from rbtrg_robot.cli.close import close
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.process.runfiles import read_state

    folder = read_state(robot)["log_dir"]
    if not folder:
        raise ConfigError("the stack records nothing: start it without `--no-record`")
    run = Path(folder)
    with _progress() as progress, connect(robot) as bus:
        result = close(
            bus,
            run,
            out or run / "closed.npz",
            least,
            time.sleep,
            drift=drift,
            progress=progress,
            say=_note,
        )
    say(result.words)


@contextlib.contextmanager
def _progress() -> Iterator[Progress]:
    """A bar for each thing that is done, on a terminal; elsewhere a line now and then."""
    from rich.console import Console
    from rich.progress import Progress as Bars

    if not sys.stderr.isatty():
        yield _Lines()
        return
    with Bars(console=Console(stderr=True)) as bars:
        tasks: dict[str, Any] = {}

        def progress(what: str, share: float) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=1.0)
            bars.update(tasks[what], completed=share)

        yield progress


class _Lines:
    """Progress where there is no terminal."""

    def __init__(self) -> None:
        self._what, self._due = "", 0.0

    def __call__(self, what: str, share: float) -> None:
        now = time.monotonic()
        if what != self._what or now >= self._due:
            self._what, self._due = what, now + LINE_PERIOD
            say(f"{what}: {share:.0%}", error=True)


def _note(text: str) -> None:
    say(f"note: {text}", error=True)
