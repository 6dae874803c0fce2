"""`scene`, `config`, `map`, `doctor`, `report`."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from rbtrg_robot.cli.scene_options import HeightRange, Resolution, Units, Up, chosen
from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import plain, say, say_json, say_text

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]
Json = Annotated[bool, typer.Option("--json", help="Machine-readable.")]

scene_app = typer.Typer(help="Built-in scenes and terrain files.", no_args_is_help=True)
config_app = typer.Typer(help="Configuration of the stack.", no_args_is_help=True)
map_app = typer.Typer(help="The elevation map of the running stack.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(scene_app, name="scene")
    app.add_typer(config_app, name="config")
    app.add_typer(map_app, name="map")
    app.command()(doctor)
    app.command()(report)


@scene_app.command("list")
def scene_list(as_json: Json = False) -> None:
    """Built-in scenes."""
    from hal.scenes import load_scene, scene_names

    scenes = {name: load_scene(name) for name in scene_names()}
    if as_json:
        say_json(
            [
                {"name": name, "extent": [round(v, 3) for v in x.extent], "description": x.description}
                for name, x in scenes.items()
            ]
        )
        return
    for name, scene in scenes.items():
        x0, y0, x1, y1 = scene.extent
        say(f"{name:18s} {x1 - x0:4.1f} x {y1 - y0:4.1f} m  {scene.description}")


@scene_app.command("show")
def scene_show(
    name: Annotated[str, typer.Argument(help="Built-in scene or terrain file.")],
    as_json: Json = False,
    png: Annotated[Path | None, typer.Option(help="Write a picture of the terrain.")] = None,
    resolution: Resolution = None,
    height_range: HeightRange = None,
    units: Units = None,
    up: Up = None,
) -> None:
    """Start pose, named goals, extent."""
    from hal.scenes import load_scene

    scene = load_scene(name, **chosen(resolution, height_range, units, up))
    if png is not None:
        from hal.scenes.picture import render_scene_png

        render_scene_png(scene, png)
    record = {
        "name": scene.name,
        "description": scene.description,
        "taken": scene.taken,
        "extent": [round(v, 3) for v in scene.extent],
        "resolution": scene.resolution,
        "friction": scene.friction,
        "start": list(scene.start),
        "goals": {k: list(v) for k, v in scene.goals.items()},
    }
    if as_json:
        say_json(record)
        return
    x0, y0, x1, y1 = scene.extent
    say(f"{scene.name}: {scene.description}" + (f"; taken so: {scene.taken}" if scene.taken else ""))
    say(f"  x {x0:.2f} to {x1:.2f} m, y {y0:.2f} to {y1:.2f} m, cells {scene.resolution} m")
    say(f"  start  x {scene.start[0]:.2f} y {scene.start[1]:.2f} yaw {scene.start[2] * 57.29578:.0f} deg")
    for goal, (x, y, yaw) in scene.goals.items():
        say(f"  goal {goal}: x {x:.2f} y {y:.2f}" + ("" if yaw is None else f" yaw {yaw * 57.29578:.0f} deg"))
    if png is not None:
        say(f"picture in {png}")


@config_app.command("show")
def config_show(
    config: Annotated[Path | None, typer.Option(help="YAML configuration.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="Set one key.")] = None,
    as_json: Json = False,
) -> None:
    """The whole configuration, defaults included."""
    from rbtrg_robot.config import load

    loaded = load(config, set_ or ())
    if as_json:
        say_json(loaded.model_dump(mode="json"))
    else:
        say_text(loaded.to_yaml())


@config_app.command("schema")
def config_schema() -> None:
    """JSON schema of the configuration, with units."""
    from rbtrg_robot.config import StackConfig

    say_json(StackConfig.model_json_schema())


@map_app.command("save")
def map_save(
    file: Annotated[Path, typer.Argument(help="FILE.npz; .tif, .pcd, or .png (and .yaml) for Nav2.")],
    force: Annotated[bool, typer.Option("--force", help="Overwrite FILE without asking.")] = False,
    robot: Robot = ROBOT,
) -> None:
    """Write the present map to FILE. `up --map FILE` loads .npz and .pcd."""
    from mapping.elevation import MapError
    from mapping.elevation.export import WRITERS, Limits
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.config import load
    from rbtrg_robot.orders.map import FetchMap, save
    from rbtrg_robot.orders.order import follow

    if file.suffix not in WRITERS:
        raise MapError(f"{file} must end in .npz, as `up --map` reads it, or in .tif, .pcd or .png")
    if not file.resolve().parent.is_dir():
        raise MapError(f"there is no folder {file.resolve().parent}")
    if os.path.isfile(file) and not force:  # False for a name that no file can have
        asked = f"{plain(str(file))} exists. Overwrite it?"
        if not (sys.stdin.isatty() and typer.confirm(asked)):
            raise MapError(f"{file} exists and stays; `--force` overwrites it")
    order = FetchMap()
    with connect(robot) as bus:
        end = follow(bus, order)
    if not order.patches:
        raise MapError(end.words)
    try:
        params = load().graph_params()
        limits = Limits(params.max_step, params.max_slope)
        known = save(order.patches, order.cloud, file, limits, order.areas)
    except OSError as error:
        raise MapError(f"cannot write {file}: {error.strerror}; make room or name another file") from error
    say(f"{known} known cells -> {file}")


@map_app.command("clear")
def map_clear(robot: Robot = ROBOT) -> None:
    """Forget what the robot touched. What was measured stays."""
    from mapping.elevation import MapError
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.orders.map import ForgetTouched
    from rbtrg_robot.orders.order import follow

    with connect(robot) as bus:
        end = follow(bus, ForgetTouched())
    if not end.ok:
        raise MapError(end.words)
    say(end.words)


def doctor(
    port: Annotated[int, typer.Option(help="TCP port of the router.")] = 7447, as_json: Json = False
) -> None:
    """Check what this machine lacks, in plain words. Exit status 1 on a fault."""
    from rbtrg_robot.process.doctor import Level, examine

    found = []
    for finding in examine(port):
        found.append(finding)
        if not as_json:
            mark = {Level.OK: "ok  ", Level.NOTE: "note", Level.FAULT: "BAD "}[finding.level]
            say(f"{mark} {finding.what}: {finding.words}")
    if as_json:
        say_json([{"what": x.what, "level": x.level.name.lower(), "words": x.words} for x in found])
    raise typer.Exit(any(finding.level is Level.FAULT for finding in found))


def report(
    run: Annotated[
        Path | None, typer.Argument(help="Folder of a run; default: the running or newest one.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Default: report-DATE.tar.gz.")] = None,
    log_dir: Annotated[Path, typer.Option(help="Where the newest run is looked for.")] = Path("logs"),
    robot: Robot = ROBOT,
) -> None:
    """Pack what a fault is reported with into one archive. Configuration, versions, doctor, status, last log lines, the
    last 60 s of a run."""
    from hal.errors import OperatorError
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.log.keep import runs
    from rbtrg_robot.log.read import LogError
    from rbtrg_robot.process.report import pack
    from rbtrg_robot.process.runfiles import read_state

    answer, port, newest = None, 7447, [found.folder for found in runs(log_dir)][-1:]
    try:
        state = read_state(robot)
        newest = [Path(state["log_dir"])] if state["log_dir"] else newest
        port = int(state["port"])
        with connect(robot) as bus:
            answer = bus.ask("status")
    except OperatorError:
        pass  # the report says that no status is in it
    if run is not None and not run.is_dir():
        raise LogError(f"there is no folder {run}; `rbtrg-robot log list` lists the runs")
    if run is None and not newest and answer is None:
        raise LogError(
            f"no stack is up and no run lies in {log_dir}; name a run's folder: `rbtrg-robot report RUN`"
        )
    target = out or Path(f"report-{time.strftime('%Y%m%d-%H%M%S')}.tar.gz")
    for line in pack(target, run or (newest[0] if newest else None), answer, port):
        say(f"missing: {line}")
    say(f"{target}, {target.stat().st_size / 1e6:.1f} MB")
