"""`mission`: run it, see it, interrupt it, record one, convert one."""

from __future__ import annotations

import json
import math
import os
import select
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from rbtrg_robot.cli.drive import Robot
from rbtrg_robot.orders.who import me
from rbtrg_robot.scope import ROBOT
from rbtrg_robot.terminal import say, say_json

if TYPE_CHECKING:
    from rbtrg_robot.missions.geojson import Origin
    from rbtrg_robot.wire.bus import Bus

app = typer.Typer(help="Missions: steps one after the other.", no_args_is_help=True)
FINISHED, UNANSWERED, REFUSED, FAILED, STOPPED = 0, 1, 2, 3, 4
EXIT = {"finished": FINISHED, "failed": FAILED, "stopped": STOPPED}
ANSWER_LIMIT = 3.0
"""Seconds without any answer from the mission process."""
LONGEST_SILENCE = 15.0
"""The same while a mission is watched: the process may be restarting."""


def register(parent: typer.Typer) -> None:
    """Add the commands."""
    parent.add_typer(app, name="mission")


@app.command()
def run(
    file: Annotated[Path, typer.Argument(help="Mission file (YAML).")],
    at: Annotated[int, typer.Option("--at", min=1, help="Begin with this step.")] = 1,
    wait: Annotated[bool, typer.Option("--wait", help="Watch until its end.")] = False,
    check: Annotated[bool, typer.Option("--check", help="Print the numbered steps, send nothing.")] = False,
    update: Annotated[
        bool, typer.Option("--update", help="Change the running mission from its next step on.")
    ] = False,
    robot: Robot = ROBOT,
) -> None:
    """Send the robot on a mission. Exit status: 0 started (finished with --wait), 2 refused, 3 failed, 4 stopped or
    paused by Ctrl-C."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.missions.file import load, numbered

    mission = load(file)
    order = mission.order(uuid.uuid4().hex[:12], start=at, owner=me())
    if check:
        for line in numbered(order):
            say(line)
        return
    with connect(robot) as bus:
        bus.subscribe([t.MISSION_STATE])
        if update:
            running = newest(bus)
            order = mission.order(running.order_id, update=running.order_update_id + 1, start=at, owner=me())
        code, _ = send(bus, order, wait=wait, update=update)
        if wait or code:
            raise typer.Exit(code)
        if mission.on_comms_loss not in (None, "continue"):
            say(
                f"it will {mission.on_comms_loss} unless somebody watches: `rbtrg-robot mission status --follow`"
            )


def send(bus: Bus, order: Any, *, wait: bool, update: bool = False) -> tuple[int, Any]:
    """Send an order, with `wait` watch it to its end; Ctrl-C pauses it. Returns the exit status and the newest
    state."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.missions import words

    bus.subscribe([t.MISSION_STATE])
    try:
        state = _ask(bus, "update" if update else "run", order=order)
        say(words.lines(state)[0])
        return _follow(bus, state) if wait else (FINISHED, state)
    except KeyboardInterrupt:
        say(words.lines(_ask(bus, "pause", order_id=order.order_id))[0])
        return STOPPED, None


@app.command()
def status(
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable.")] = False,
    follow: Annotated[bool, typer.Option("--follow", help="Watch until its end.")] = False,
    robot: Robot = ROBOT,
) -> None:
    """How far the mission is. With --follow the mission knows that an operator is in contact."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.missions import words

    with connect(robot) as bus:
        bus.subscribe([t.MISSION_STATE])
        state = newest(bus)
        if as_json:
            say_json(words.as_record(state))
            return
        for line in words.lines(state):
            say(line)
        if follow and state.phase not in ("idle", *EXIT):
            raise typer.Exit(_follow(bus, state)[0])


@app.command()
def pause(robot: Robot = ROBOT) -> None:
    """The robot stands. `mission resume` begins the present step again."""
    _tell(robot, "pause")


@app.command()
def resume(robot: Robot = ROBOT) -> None:
    """Go on with it. After a pause, an emergency stop, driving by hand or a restart of the stack."""
    _tell(robot, "resume")


@app.command()
def skip(robot: Robot = ROBOT) -> None:
    """Leave the present step out."""
    _tell(robot, "skip")


@app.command()
def stop(robot: Robot = ROBOT) -> None:
    """End the mission; the robot stands. This is no emergency stop: that is `rbtrg-robot stop`."""
    _tell(robot, "stop")


@app.command()
def answer(text: Annotated[str, typer.Argument(help="One of the choices.")], robot: Robot = ROBOT) -> None:
    """Answer the question of the present step."""
    _tell(robot, "answer", answer=text)


@app.command()
def schema() -> None:
    """JSON schema of a mission file."""
    from rbtrg_robot.missions.file import MissionFile

    say_json(MissionFile.model_json_schema())


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(help="FILE.yaml or FILE.geojson.")],
    target: Annotated[Path, typer.Argument(help="FILE.geojson or FILE.yaml.")],
    origin: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="LATITUDE LONGITUDE YAW",
            help="Of the origin of `map`, and the yaw from east to its x axis [deg]. Without: metres.",
        ),
    ] = None,
) -> None:
    """A mission file to GeoJSON and back."""
    from rbtrg_robot.missions import file, geojson

    place = _origin(origin)
    if source.suffix == ".geojson":
        text = file.dump(geojson.load(source, place))
    else:
        text = json.dumps(geojson.to_geojson(file.load(source), place), indent=1)
    _write(target, text)


@app.command()
def record(
    file: Annotated[Path, typer.Argument(help="Mission file to write (YAML).")],
    spacing: Annotated[
        float, typer.Option(min=0.0, help="A step every so many metres; 0 = only on Enter.")
    ] = 0.0,
    name: Annotated[str, typer.Option(help="Name of the mission.")] = "",
    robot: Robot = ROBOT,
) -> None:
    """Drive the robot once; where you press Enter becomes a step. `q` or Ctrl-C writes the file."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.missions.recording import HELP, Recording
    from rbtrg_robot.wire.convert import yaw_of
    from rbtrg_robot.wire.frames import MapFrame

    if not file.resolve().parent.is_dir():
        _fail(f"there is no folder {file.resolve().parent}")
    frame = MapFrame()
    with connect(robot) as bus:
        bus.subscribe([t.MISSION_STATE, t.TF_STATIC, t.ODOM])
        recording = Recording(name, newest(bus, keep=(t.TF_STATIC, frame)).map, spacing)
        say(HELP)
        try:
            for line in _typed(bus):
                if isinstance(line, str):
                    if line.strip() == "q":
                        break
                    say(recording.say(line))
                elif t.TF_STATIC.carried(line[1], line[0]):
                    frame.take(line[1])
                elif t.ODOM.carried(line[1], line[0]) and frame.known:
                    pose = line[1].pose.pose
                    here = frame.pose2(pose.position.x, pose.position.y, yaw_of(pose.orientation))
                    if said := recording.at(here):
                        say(said)
        except KeyboardInterrupt:
            say()
    from rbtrg_robot.missions.file import dump

    _write(file, dump(recording.mission()))


def _typed(bus: Bus) -> Iterator[Any]:
    """Lines of the terminal as str, messages as (topic, message), until the end of the input."""
    typed = ""
    while True:
        for received in bus.take(0.1):
            message = bus.open(received)
            if message is not None:
                yield received.topic, message
        if select.select([sys.stdin], [], [], 0.0)[0]:
            data = os.read(sys.stdin.fileno(), 4096)  # `readline` would hide a second line from `select`
            *full, typed = (typed + data.decode(errors="replace")).split("\n")
            yield from full
            if not data:
                return


def _tell(robot: str, action: str, **fields: Any) -> None:
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.missions import words

    with connect(robot) as bus:
        bus.subscribe([t.MISSION_STATE])
        for line in words.lines(_ask(bus, action, **fields)):
            say(line)


def newest(bus: Bus, keep: Any = None) -> Any:
    """The newest state of the mission process; `keep`: (topic, frame) that is fed meanwhile."""
    from rbtrg_robot import topics as t

    deadline = time.monotonic() + ANSWER_LIMIT
    while time.monotonic() < deadline:
        for received in bus.take(0.1):
            message = bus.open(received)
            if keep is not None and received.topic is keep[0] and message is not None:
                keep[1].take(message)
            if received.topic is t.MISSION_STATE and message is not None:
                return message
    _silent()


def _ask(bus: Bus, action: str, **fields: Any) -> Any:
    """Send a request until it is answered; the state then. Exits where it is refused or nobody answers."""
    from rbtrg_robot.orders.mission import TellMission
    from rbtrg_robot.orders.order import follow

    order = TellMission(action, **fields)
    outcome = follow(bus, order)
    if order.state is None:
        _silent()
    if not outcome.ok:
        _fail(outcome.words, REFUSED)
    return order.state


def _follow(bus: Bus, begun: Any) -> tuple[int, Any]:
    """Print what changes until the mission of a state ends, and be in contact meanwhile. Returns the exit status and
    the last state."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.missions import words
    from rbtrg_robot.orders.mission import Present

    shown, heard, present = "", time.monotonic(), Present(bus)
    while True:
        present()
        if time.monotonic() - heard > LONGEST_SILENCE:
            _silent()
        for received in bus.take(0.1):
            state: Any = bus.open(received)
            if received.topic is not t.MISSION_STATE or state is None:
                continue
            heard = time.monotonic()
            if state.order_id != begun.order_id:
                _fail("another mission took its place", STOPPED)
            text = words.lines(state)[0]
            if text != shown:
                shown = text
                say(text)
            if state.phase in EXIT:
                return EXIT[state.phase], state


def _origin(origin: tuple[float, float, float] | None) -> Origin | None:
    from rbtrg_robot.missions.geojson import Origin

    return Origin(origin[0], origin[1], math.radians(origin[2])) if origin else None


def _write(target: Path, text: str) -> None:
    try:
        target.write_text(text if text.endswith("\n") else f"{text}\n")
    except OSError as error:
        _fail(f"cannot write {target}: {error.strerror}")
    say(f"-> {target}")


def _silent() -> NoReturn:
    from rbtrg_robot.cli.link import see_also

    _fail(f"the mission process does not answer; {see_also()}")


def _fail(text: str, code: int = UNANSWERED) -> NoReturn:
    say(f"rbtrg-robot: {text}", error=True)
    raise typer.Exit(code)
