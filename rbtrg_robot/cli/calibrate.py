"""`calibrate`."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import say, say_text

if TYPE_CHECKING:
    from rbtrg_robot.hosts.calibrate import Sample
    from rbtrg_robot.topics import Topic

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]
calibrate_app = typer.Typer(help="Find how sensors are mounted.", no_args_is_help=True)
COMMAND_PERIOD = 0.05
"""[s] between two velocities; the robot lets go after 0.2 s of silence."""
TRUNK_TILT = 0.2
"""[rad] of the trunk to either side."""


@dataclass(frozen=True, slots=True)
class Part:
    """Of the motion that is driven: for so long [s]."""

    lasts: float
    ahead: float = 0.0
    """[m/s]"""
    turning: float = 0.0
    """[rad/s]"""
    roll: float = 0.0
    """Of the trunk [rad],"""
    pitch: float = 0.0
    """nose-down positive."""


COURSE = (
    Part(2.0),
    Part(5.0, turning=0.6),
    Part(5.0, turning=-0.6),
    Part(2.5, ahead=0.3),
    Part(2.5, ahead=-0.3),
    Part(1.5),
    *[Part(0.8, pitch=side * TRUNK_TILT) for side in (1.0, -1.0)] * 3,
    *[Part(0.8, roll=side * TRUNK_TILT) for side in (1.0, -1.0)] * 3,
    Part(1.0),
)
"""Turns show clocks, and roll and pitch of a mount. Trunk tilts show its yaw; driving ahead does if the trunk cannot
tilt."""


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(calibrate_app, name="calibrate")


@calibrate_app.callback()
def _group() -> None:
    pass


@calibrate_app.command("lidar")
def calibrate_lidar(
    log: Annotated[Path | None, typer.Option("--log", help="A log of a motion instead of the robot.")] = None,
    drive: Annotated[
        bool,
        typer.Option(
            "--drive", help="Drive: turn on the spot both ways, 0.75 m ahead and back, tilt the trunk."
        ),
    ] = False,
    seconds: Annotated[float, typer.Option(min=5.0, max=120.0, help="How long to watch.")] = 20.0,
    config: Annotated[
        Path | None,
        typer.Option(help="Configuration of the stack, YAML; else that of the running one, or of the log."),
    ] = None,
    sets: Annotated[list[str] | None, typer.Option("--set", metavar="A.B=C", help="One value of it.")] = None,
    robot: Robot = ROBOT,
) -> None:
    """Print mounts and time offsets of the LiDARs. With their certainty, and parts of the robot that they see, for
    the configuration.

    Let the robot stand for a second on level ground with walls in sight, then turn and drive it. Moves nothing
    without --drive."""
    from rbtrg_robot.config import ConfigError, load, of_log
    from rbtrg_robot.hosts.calibrate import as_yaml, calibrate, samples_of
    from rbtrg_robot.log.read import CONFIG, first_of

    if log is not None:
        if drive:
            raise ConfigError("--log and --drive: choose one")
        base = of_log(first_of(log).attachments.get(CONFIG, b""))[0]
        stack = load(config, sets or (), base=base)
        samples = list(samples_of(log))
    else:
        base = {} if config is not None else of_log(_running(robot))[0]
        stack = load(config, sets or (), base=base)
        samples = _watch(robot, seconds, drive)
    say("comparing what gyro, wheels and LiDARs saw", error=True)
    found, parts = calibrate(samples, stack.mounted_lidars(), stack.odometry, stack.own_parts)
    say_text(as_yaml(found, [lidar.time_offset for lidar in stack.lidars], parts))


def _running(robot: str) -> bytes:
    """Configuration of the running stack, YAML: mounts are found as an error of the configured ones. Raises
    ConfigError if it is not on this computer."""
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.log.read import CONFIG

    with connect(robot) as bus:
        folder = json.loads(bus.ask("status") or b"{}").get("log_dir", "")
    file = Path(folder) / CONFIG
    if not folder or not file.is_file():
        raise ConfigError(
            "the configuration of the running stack is not on this computer, or it records nothing: name its "
            "file with --config"
        )
    return file.read_bytes()


def _watch(robot: str, seconds: float, drive: bool) -> list[Sample]:
    """What the sensors say from now on; drives `COURSE` by hand's right of way if told to."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.hosts.calibrate import HEARD, sample_of
    from rbtrg_robot.wire.messages import stamp_of

    out: list[Sample] = []
    with connect(robot) as bus:
        bus.subscribe([replace(topic, depth=10_000) for topic in HEARD])  # every sample counts
        if drive:
            bus.advertise(t.TELEOP)
            bus.advertise(t.TELEOP_TRUNK)
            bus.subscribe([t.ROBOT_STATE])
        seen = 0
        """Newest stamp of the robot [ns], which velocities echo."""
        began = time.monotonic()
        length = sum(part.lasts for part in COURSE) if drive else seconds
        say(f"watching for {length:.0f} s", error=True)
        while (now := time.monotonic() - began) < length:
            if drive:
                _order(bus, now, seen)
            end = time.monotonic() + COMMAND_PERIOD
            while (left := end - time.monotonic()) > 0.0:
                for received in bus.take(left):
                    message = bus.open(received)
                    if received.topic is t.ROBOT_STATE:
                        seen = stamp_of(message) if message is not None else seen
                        continue
                    sample = None if message is None else sample_of(t.BY_NAME[received.topic.name], message)
                    out += [] if sample is None else [sample]
        if drive:
            _order(bus, length, seen)
            say("`rbtrg-robot resume` gives the motion back to the stack", error=True)
    return out


def _order(bus: Any, after: float, seen: int) -> None:
    """What `COURSE` asks for `after` its begin [s]; `seen`: newest stamp of the robot [ns]."""
    for topic, message in orders(after, seen):
        bus.publish(topic, message, time.time_ns())


def orders(after: float, stamp: int) -> list[tuple[Topic, Any]]:
    """Velocity and trunk tilt of `COURSE`, `after` [s] its begin, stamped with `stamp` [ns]; rest when it is over."""
    from rbtrg_robot import msg
    from rbtrg_robot import topics as t
    from rbtrg_robot.wire.messages import header

    part = Part(0.0)
    for candidate in COURSE:
        if after < candidate.lasts:
            part = candidate
            break
        after -= candidate.lasts
    velocity = msg.TwistStamped(header=header(stamp, "base_link"))
    velocity.twist.linear.x, velocity.twist.angular.z = part.ahead, part.turning
    out: list[tuple[Topic, Any]] = [(t.TELEOP, velocity)]
    if part.roll or part.pitch:
        tilt = msg.TrunkCommand(header=header(stamp, "base_link"), roll=part.roll, pitch=part.pitch)
        out.append((t.TELEOP_TRUNK, tilt))
    return out
