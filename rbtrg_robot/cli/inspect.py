"""`scene`, `config`, `map`, `doctor`, `report`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from rbtrg_robot.cli.scene_options import HeightRange, Resolution, Units, Up, chosen
from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import say, say_json, say_text

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]

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
def scene_list() -> None:
    """Built-in scenes."""
    from hal.scenes import load_scene, scene_names

    for name in scene_names():
        scene = load_scene(name)
        x0, y0, x1, y1 = scene.extent
        say(f"{name:18s} {x1 - x0:4.1f} x {y1 - y0:4.1f} m  {scene.description}")


@scene_app.command("show")
def scene_show(
    name: Annotated[str, typer.Argument(help="Built-in scene or terrain file.")],
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable.")] = False,
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
) -> None:
    """The whole configuration, defaults included."""
    from rbtrg_robot.config import load

    say_text(load(config, set_ or ()).to_yaml())


@config_app.command("schema")
def config_schema() -> None:
    """JSON schema of the configuration, with units."""
    from rbtrg_robot.config import StackConfig

    say_json(StackConfig.model_json_schema())


@map_app.command("save")
def map_save(file: Annotated[Path, typer.Argument(help="FILE.npz.")], robot: Robot = ROBOT) -> None:
    """Write the present map to FILE (.npz); `up --map FILE` loads it."""
    from mapping.elevation import MapError
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.orders.map import FetchMap, save
    from rbtrg_robot.orders.order import follow

    if file.suffix != ".npz":
        raise MapError(f"{file} must end in .npz: `up --map` reads it by that")
    if not file.resolve().parent.is_dir():
        raise MapError(f"there is no folder {file.resolve().parent}")
    order = FetchMap()
    with connect(robot) as bus:
        end = follow(bus, order)
    if not order.patches:
        raise MapError(end.words)
    try:
        known = save(order.patches, order.cloud, file)
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


def doctor(port: Annotated[int, typer.Option(help="TCP port of the router.")] = 7447) -> None:
    """Check what this machine lacks, in plain words. Exit status 1 on a fault."""
    from rbtrg_robot.process.doctor import Level, examine

    worst = 0
    for finding in examine(port):
        mark = {Level.OK: "ok  ", Level.NOTE: "note", Level.FAULT: "BAD "}[finding.level]
        say(f"{mark} {finding.what}: {finding.words}")
        worst = max(worst, finding.level is Level.FAULT)
    raise typer.Exit(worst)


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
    target = out or Path(f"report-{time.strftime('%Y%m%d-%H%M%S')}.tar.gz")
    for line in pack(target, run or (newest[0] if newest else None), answer, port):
        say(f"missing: {line}")
    say(f"{target}, {target.stat().st_size / 1e6:.1f} MB")
