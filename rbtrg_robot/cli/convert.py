"""`map convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rbtrg_robot.cli.inspect import map_app
from rbtrg_robot.cli.scene_options import HeightRange, Resolution, Units, Up, chosen
from rbtrg_robot.terminal import say

BAGS = (".bag", ".mcap", ".db3")


def register(app: typer.Typer) -> None:
    """Add the command to `map`, which `inspect` adds to the app."""
    del app
    map_app.command("convert")(map_convert)


def map_convert(
    source: Annotated[
        Path, typer.Argument(metavar="FILE", help="A saved map, a scene file, or a bag with a GridMap.")
    ],
    out: Annotated[Path, typer.Argument(help="FILE.npz, .tif, .pcd, or .png (and .yaml) for Nav2.")],
    topic: Annotated[str, typer.Option(help="Of the map in a bag that holds several.")] = "",
    layer: Annotated[str, typer.Option(help="Of the map in a bag.")] = "elevation",
    force: Annotated[bool, typer.Option("--force", help="Overwrite OUT.")] = False,
    resolution: Resolution = None,
    height_range: HeightRange = None,
    units: Units = None,
    up: Up = None,
) -> None:
    """Write a map as another file. `up --map` and `plan` read .npz and .pcd."""
    from mapping.elevation.export import WRITERS, Limits, write
    from rbtrg_robot.config import ConfigError, load
    from rbtrg_robot.hosts.plan import map_of
    from rbtrg_robot.importer.grid_map import grid_in

    if out.suffix not in WRITERS:
        raise ConfigError(f"{out} must end in {', '.join(WRITERS)}")
    if out.exists() and not force:
        raise ConfigError(f"{out} exists and stays; `--force` overwrites it")
    config = load(None, (), scene_options=chosen(resolution, height_range, units, up) or None)
    bag = source.suffix in BAGS or source.is_dir()
    ground = grid_in(source, topic, layer) if bag else str(source)
    elevation, taken = map_of(ground, config)
    if taken:
        say(f"{source} is taken so: {taken}", error=True)
    params = config.graph_params()
    try:
        known = write(elevation, out, Limits(params.max_step, params.max_slope))
    except OSError as error:
        raise ConfigError(f"cannot write {out}: {error.strerror}") from error
    say(f"{known} known cells of {elevation.params.resolution:g} m -> {out}")
