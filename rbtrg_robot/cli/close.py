"""`map close`: the loops of a run are closed while the stack goes on and the robot drives. The run's log so far becomes
a map (`map_build`). The stack gets it with where `odom` lies in it, by the robot's place in it at the end of the log.
The robot glides there in `map`, or is there at once while it stands (`rbtrg_robot.stages.closing`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hal.errors import OperatorError
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.hosts.map_build import Built, Progress, build
from rbtrg_robot.hosts.offline import config_of
from rbtrg_robot.log.read import log_files
from rbtrg_robot.orders.heard import Heard
from rbtrg_robot.orders.map import LoadMap, read
from rbtrg_robot.orders.order import follow
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import xyz, yaw_of
from rbtrg_robot.wire.frames import closed_map

FLUSH_LOOKS, LOOK_EVERY = 300, 0.1
"""Looks at the log until the recorder has written again, and the time between them [s]."""
HEARD_FOR = 5.0
"""[s] of odometry before: the newest scan that is kept lies in it. Of a robot that stands it is 2 s older than the end
of the log."""


class CloseError(OperatorError):
    """The loops of the run are not closed, or the stack does not go on with the new map."""


@dataclass(frozen=True, slots=True)
class Result:
    """What came of it."""

    built: Built
    loaded: bool
    """The robot goes on with the new map."""
    words: str


def close(
    bus: Bus,
    run: Path,
    out: Path,
    least: float,
    pause: Callable[[float], None],
    *,
    drift: float = 1.0,
    progress: Progress = lambda _what, _share: None,
    say: Callable[[str], None] = lambda _text: None,
) -> Result:
    """Build the map of `run` so far into `out` (.npz) with its loops closed, and have the stack on `bus` go on with it
    if that moves any keyframe by `least` [m] or more.

    pause: waits so many seconds for the log. Raises CloseError, ConfigError, LogError, MapError, which say what to do.
    """
    heard = _listen(bus, run, pause)
    if heard.prior and not heard.prior.startswith(t.MAP_CLOSED.name):
        raise CloseError(
            "the stack began with a prior map, in which the robot finds itself: loops are closed in maps that it makes "
            "alone; use `map build` on the logs"
        )
    built = build([run], out, drift=drift, areas=heard.areas, until=heard.newest, progress=progress, say=say)
    loops, moved = len(built.record["closed"]), built.record["moved_m"]
    if not loops or moved < least:
        what = f"{loops} loops moved it by {moved:.2f} m" if loops else "no loop was closed"
        return Result(built, False, f"{what}: the stack goes on with the map that it has")
    then = heard.odometry(built.stamp)
    if then is None:
        raise CloseError(
            f"the log {run} ends before the odometry was heard: try again, or see `rbtrg-robot status`"
        )
    prior = closed(built, read(out, config_of(run, None, ()).elevation), *then)
    prior.id = f"{t.MAP_CLOSED.name}:{out.name}:{built.stamp}"
    bus.take(0.0)  # what was said meanwhile
    end = follow(bus, LoadMap(prior))
    if not end.ok:
        raise CloseError(f"{out} is made, but the stack goes on with the map that it has. {end.words}")
    return Result(built, True, f"{loops} loops closed, the map moved by up to {moved:.2f} m; {end.words}")


def closed(built: Built, prior: msg.MapPrior, then: msg.Odometry, higher: float) -> msg.MapPrior:
    """The map as the stack goes on with it. then: what odometry told of its newest scan; higher: how much higher [m]
    the stack's map lay then."""
    here = then.pose.pose
    said = np.array([*xyz(here.position), yaw_of(here.orientation)])
    there = np.array([*built.pose[:3, 3], math.atan2(built.pose[1, 0], built.pose[0, 0])])
    return closed_map(prior, there, said, higher, built.stamp)


def _listen(bus: Bus, run: Path, pause: Callable[[float], None]) -> Heard:
    """What the stack tells until the recorder has written to disk what was heard. Raises CloseError."""

    def size() -> int:
        return sum(file.stat().st_size for file in log_files(run))

    def hear() -> None:
        for received in bus.take(LOOK_EVERY):
            if received.topic in heard.hears and (message := bus.open(received)) is not None:
                heard.take(received.topic, message)

    heard, before = Heard(), -1
    bus.subscribe(heard.hears)
    for _ in range(FLUSH_LOOKS):
        hear()
        if heard.seconds < HEARD_FOR:
            continue
        if before >= 0 and size() != before:
            break
        before = size() if before < 0 else before
        pause(LOOK_EVERY)
    hear()  # what is in the log may be newer than what was heard
    if heard.seconds < HEARD_FOR:
        raise CloseError("the odometry tells no pose, or there is no map; see `rbtrg-robot status`")
    return heard
