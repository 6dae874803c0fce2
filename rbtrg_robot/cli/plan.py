"""`plan`."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rbtrg_robot.cli.scene_options import HeightRange, Resolution, Units, Up, chosen
from rbtrg_robot.terminal import say, say_json

if TYPE_CHECKING:
    from rbtrg_robot.hosts.plan import MapPlanner, Route

REACHED, REJECTED, ABORTED = 0, 2, 3
"""As `goal`: there is a route; start or goal cannot be asked for; there is none to the goal."""
LARGEST_FILE = 10_000_000
"""Bytes of a file of questions."""
Place = tuple[float, float]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(context_settings={"ignore_unknown_options": True})(plan)  # a place may begin with a minus


def plan(
    map_: Annotated[
        str, typer.Argument(metavar="MAP", help="A scene, or any file that --scene or --map reads.")
    ],
    places: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[START] GOAL",
            help="Each X,Y or X Y in metres, START with its heading X,Y,DEG, GOAL or a goal's name. "
            "Without START, or with the word `start`, from that of the scene.",
        ),
    ] = None,
    yaw: Annotated[float | None, typer.Option(help="Heading at the goal [deg].")] = None,
    variant: Annotated[str | None, typer.Option(help="native, edge-only, mean-only, full.")] = None,
    method: Annotated[
        str | None, typer.Option(help="rb_trg, an installed planner, or module:function.")
    ] = None,
    pairs: Annotated[
        Path | None, typer.Option(help="FILE with a line `X Y GOALX GOALY [GOALDEG]` per question.")
    ] = None,
    png: Annotated[Path | None, typer.Option(help="Picture: the route over the risk.")] = None,
    geojson: Annotated[Path | None, typer.Option(help="The routes as lines in metres.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable, with the path.")] = False,
    resolution: Resolution = None,
    height_range: HeightRange = None,
    units: Units = None,
    up: Up = None,
    config: Annotated[Path | None, typer.Option(help="YAML over the defaults.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="A.B=C", help="Set one key over them.")
    ] = None,
) -> None:
    """Plan on a map, without a robot. Exit status 0: there is a route; 2: rejected; 3: there is none."""
    from rbtrg_robot.config import ConfigError, load
    from rbtrg_robot.hosts.plan import MapPlanner

    for drawn in (png, geojson):
        if drawn is not None:
            _writable(drawn)
    sets = [*(set_ or [])]
    sets += [f"planner.variant={variant}"] if variant else []
    sets += [f"planner.method={method}"] if method else []
    if pairs is not None and places:
        raise ConfigError("--pairs brings its own starts and goals: leave START and GOAL out")
    start, goal = _start_and_goal(places or [])
    questions = [] if pairs is None else _read(pairs)
    at = questions[0][0] if questions else None if start == "start" else _start(start)[0]
    options = chosen(resolution, height_range, units, up)
    planner = MapPlanner(map_, load(config, sets, scene_options=options or None), at)
    if planner.taken:
        say(f"{map_} is taken so: {planner.taken}", error=True)
    if pairs is None and not goal:
        raise ConfigError(f"say a goal: X,Y{' or ' + ', '.join(planner.goals) if planner.goals else ''}")
    questions = questions or [_question(planner, start, goal, yaw)]
    if png is not None and len(questions) > 1:
        raise ConfigError("--png draws one route: ask one question")
    routes: list[Route] = []
    advised = False  # another start costs graphs: it is told once
    for place, heading, end, end_yaw in questions:
        route = planner.plan(place, end, heading, end_yaw, other_start=not advised)
        routes.append(route)
        advised |= bool(route.advice)
        if not as_json:
            lead = f"({place[0]:g}, {place[1]:g}) -> ({end[0]:g}, {end[1]:g}): " if pairs else ""
            say(lead + route.words)
        if png is not None:
            try:
                planner.image(route).save(png)
                say(f"picture -> {png}", error=as_json)
            except ConfigError as error:
                say(f"no picture: {error}", error=True)
    if geojson is not None:
        geojson.write_text(json.dumps(_features(routes)))
    if as_json:
        rows = [dataclasses.asdict(route) for route in routes]
        say_json(rows if pairs else rows[0])
    elif pairs:
        say(f"{sum(r.ok and r.reaches_goal for r in routes)} of {len(routes)} reach their goal")
    worst = max((_status(route) for route in routes), default=REACHED)
    if worst:
        raise typer.Exit(worst)


def _status(route: Route) -> int:
    if route.ok:
        return REACHED if route.reaches_goal else ABORTED
    return (
        REJECTED
        if route.reason
        in ("invalid", "goal_in_obstacle", "start_not_on_graph", "outside_area", "keep_out_area")
        else ABORTED
    )


def _start_and_goal(words: list[str]) -> tuple[str, str]:
    """The words for the two places, each `X,Y` or `X Y` or a name; `start` where there is one place, empty where there
    is none."""
    from rbtrg_robot.config import ConfigError

    found: list[str] = []
    left = iter(words)
    for word in left:
        found.append(word if not _is_number(word) else f"{word},{next(left, '')}")
    if len(found) > 2:
        raise ConfigError(f"say two places, START and GOAL, each X,Y in metres or a name; got {len(found)}")
    if len(found) == 2:
        return found[0], found[1]
    return "start", found[0] if found else ""


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _writable(path: Path) -> None:
    """Before anything is planned. Raises ConfigError."""
    from rbtrg_robot.config import ConfigError

    try:
        with path.open("ab"):
            pass
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error


def _question(
    planner: MapPlanner, start: str, goal: str, yaw: float | None
) -> tuple[Place, float, Place, float | None]:
    from rbtrg_robot.config import ConfigError

    at: float | None
    if start == "start":
        x, y, heading = planner.start
    else:
        (x, y), heading = _start(start)
    if goal in planner.goals:
        gx, gy, at = planner.goals[goal]
    elif "," in goal:
        gx, gy = _numbers(goal, (2,), "GOAL")
        at = None
    else:
        known = f"goals here are {', '.join(planner.goals)}" if planner.goals else "this map names none"
        raise ConfigError(f"GOAL is X,Y or a name; {known}, got {goal!r}")
    return (x, y), heading, (gx, gy), at if yaw is None else math.radians(yaw)


def _start(text: str) -> tuple[Place, float]:
    x, y, *more = _numbers(text, (2, 3), "START")
    return (x, y), math.radians(more[0]) if more else 0.0


def _numbers(text: str, counts: tuple[int, ...], what: str) -> list[float]:
    from rbtrg_robot.config import ConfigError

    try:
        values = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if len(values) not in counts or not all(map(math.isfinite, values)):
        raise ConfigError(
            f"{what} is {'X,Y' if counts == (2,) else 'X,Y or X,Y,DEG'} in metres, got {text!r}"
        )
    return values


def _read(path: Path) -> list[tuple[Place, float, Place, float | None]]:
    from hal.regular import open_regular
    from rbtrg_robot.config import ConfigError

    try:
        with open_regular(path) as file:
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    if len(data) > LARGEST_FILE:
        raise ConfigError(f"{path} has more than {LARGEST_FILE / 1e6:.0f} MB: split it")
    lines = data.decode(errors="replace").splitlines()
    out: list[tuple[Place, float, Place, float | None]] = []
    for number, line in enumerate(lines, 1):
        text = line.split("#")[0].strip()
        if text:
            x, y, gx, gy, *more = _numbers(text, (4, 5), f"line {number} of {path}")
            out.append(
                ((x, y), math.atan2(gy - y, gx - x), (gx, gy), math.radians(more[0]) if more else None)
            )
    if not out:
        raise ConfigError(f"{path} holds no line `X Y GOALX GOALY`")
    return out


def _features(routes: list[Route]) -> dict[str, Any]:
    """Lines in the frame of the map, metres: for programs that draw them, not for places on earth."""
    return {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "geometry": {"type": "LineString", "coordinates": [[x, y, z] for x, y, z, _ in route.path]},
                "properties": {
                    key: value
                    for key, value in dataclasses.asdict(route).items()
                    if key not in ("path", "worst")
                }
                | {f"worst_{key}": value for key, value in route.worst.items()},
            }
            for route in routes
            if route.ok
        ],
    }
