"""`import`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rbtrg_robot.terminal import plain, say

if TYPE_CHECKING:
    from rbtrg_robot.importer.bag import Bag
    from rbtrg_robot.importer.run import Found


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("import")(import_bag)


def import_bag(
    bag: Annotated[Path, typer.Argument(help="MCAP, rosbag2 (.db3, split, zstd; its folder) or ROS 1 .bag.")],
    out: Annotated[Path, typer.Option(help="Folder of the run that is made.")],
    map_: Annotated[
        list[str] | None,
        typer.Option("--map", metavar="ROLE=TOPIC", help="Or ROLE= for none; may be repeated."),
    ] = None,
    mount: Annotated[
        list[str] | None,
        typer.Option(metavar="ROLE=X,Y,Z,ROLL,PITCH,YAW", help="In base_link [m, deg]; may be repeated."),
    ] = None,
    urdf: Annotated[Path | None, typer.Option(help="URDF that tells where the sensors sit.")] = None,
    imu_unit: Annotated[str, typer.Option(help="Of the accelerometer: auto, m/s2 or g.")] = "auto",
) -> None:
    """Make a run of ours from a recording of another robot. `replay --rerun odometry,elevation` works on it."""
    from rich.table import Table

    from rbtrg_robot.cli.table import plain_console
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.importer.bag import Bag
    from rbtrg_robot.importer.mounts import parse_mount
    from rbtrg_robot.importer.run import look, used

    if imu_unit not in ("auto", "m/s2", "g"):
        raise ConfigError(f"--imu-unit is auto, m/s2 or g, got {imu_unit!r}")
    if out.exists():
        raise ConfigError(f"{out} exists; name another folder with --out")
    named = _pairs(map_ or [], "--map wants ROLE=TOPIC")
    mounts = {
        role: parse_mount(text)
        for role, text in _pairs(mount or [], "--mount wants ROLE=X,Y,Z,ROLL,PITCH,YAW").items()
    }
    recording = Bag(bag)
    found = look(recording, named, mounts, urdf, imu_unit)
    table = Table(box=None, pad_edge=False)
    for title in ("role", "topic", "what it is, or what a log without it costs"):
        table.add_column(title)
    for row in found.rows():
        table.add_row(*map(plain, row))
    plain_console().print(table)
    told = len(found.notes)
    for note in found.notes:
        say(f"note: {note}")
    counts = _convert(recording, found, out)
    for note in found.notes[told:]:
        say(f"note: {note}")
    for name, count in sorted(counts.items()):
        say(f"{name:32s} {count:8d}")
    if not used(counts):
        raise ConfigError(f"nothing came out that a re-run can use; {out} holds what was handed on")
    say(
        f"{sum(counts.values())} messages -> {out}; next: rbtrg-robot replay {out} --rerun "
        "odometry,elevation --out NEW.mcap"
    )


def _convert(recording: Bag, found: Found, out: Path) -> dict[str, int]:
    from rich.progress import Progress

    from rbtrg_robot.importer.run import convert_bag

    with Progress(disable=not sys.stdout.isatty()) as bar:
        task = bar.add_task("import", total=recording.count or None)
        return convert_bag(recording, found, out, lambda done: bar.update(task, completed=done))


def _pairs(items: list[str], words: str) -> dict[str, str]:
    from rbtrg_robot.config import ConfigError

    out = {}
    for item in items:
        role, sign, value = item.partition("=")
        if not sign or not role:
            raise ConfigError(f"{words}, got {item!r}")
        out[role] = value
    return out
