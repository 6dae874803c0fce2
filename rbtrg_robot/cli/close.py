"""`map close`: the loops of a run are closed while the stack goes on, and the robot may drive. The run's log so far
becomes a map (`map_build`). Once the robot stands without a goal it gets the map, and is told where it stands in it: by
its place in it at the end of the log, and by what odometry told since."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hal.errors import OperatorError
from rbtrg_robot.hosts.map_build import Built, Progress, build
from rbtrg_robot.hosts.offline import config_of
from rbtrg_robot.log.read import log_files
from rbtrg_robot.msg import Odometry
from rbtrg_robot.orders.map import LoadMap, read
from rbtrg_robot.orders.order import follow
from rbtrg_robot.orders.pose import SetPose
from rbtrg_robot.orders.still import LIMIT, Still
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.frames import MapFrame, Planar, offset_of

FLUSH_LOOKS, LOOK_EVERY = 300, 0.1
"""Looks at the log until the recorder has written again, and the time between them [s]."""
HEARD_FOR = 2.0
"""[s] of odometry before: the end of the log lies in it."""


class CloseError(OperatorError):
    """The loops of the run are not closed, or the robot does not know where it stands in the new map."""


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
    wait: float = LIMIT,
    progress: Progress = lambda _what, _share: None,
    say: Callable[[str], None] = lambda _text: None,
) -> Result:
    """Build the map of `run` so far into `out` (.npz) with its loops closed, and have the stack on `bus` go on with it
    if that moves any keyframe by `least` [m] or more.

    The robot may drive meanwhile. It gets the map when it has stood for two seconds without a goal, for which it has
    `wait` [s] from then on. pause: waits so many seconds for the log. Raises CloseError, ConfigError, LogError,
    MapError, which say what to do.
    """
    before = _listen(bus, run, pause)
    if before.prior and not (out.is_file() and before.prior == fingerprint(str(out))):
        raise CloseError(
            "the stack began with a prior map, in which the robot finds itself: loops are closed in maps that it makes "
            "alone; use `map build` on the logs"
        )
    built = build([run], out, drift=drift, areas=before.areas, progress=progress, say=say)
    loops, moved = len(built.record["closed"]), built.record["moved_m"]
    if not loops or moved < least:
        what = f"{loops} loops moved it by {moved:.2f} m" if loops else "no loop was closed"
        return Result(built, False, f"{what}: the stack goes on with the map that it has")
    then = before.odometry(built.stamp)
    if then is None:
        raise CloseError(
            f"the log {run} ends before the odometry was heard: try again, or see `rbtrg-robot status`"
        )
    prior = read(out, config_of(run, None, ()).elevation)
    bus.take(0.0)  # what was said meanwhile
    still = Still(wait)
    if not (end := follow(bus, still)).ok:
        raise CloseError(f"{out} is made, but the stack goes on with the map that it has. {end.words}")
    prior.areas = still.areas
    x, y = built.pose[:2, 3].tolist()
    x, y, yaw = moved_on((x, y, math.atan2(built.pose[1, 0], built.pose[0, 0])), then, still.place)
    end = follow(bus, LoadMap(prior))
    if not end.ok:
        raise CloseError(end.words)
    told = follow(bus, SetPose(x, y, yaw))
    where = f"x {x:.2f} y {y:.2f} yaw {math.degrees(yaw):.0f} deg"
    if not told.ok:
        raise CloseError(
            f"the map is loaded, but the robot was not told that it stands at {where}: {told.words}"
        )
    return Result(
        built,
        True,
        f"{loops} loops closed, the map moved by up to {moved:.2f} m; the robot stands at {where}",
    )


def _listen(bus: Bus, run: Path, pause: Callable[[float], None]) -> Still:
    """What the stack tells until the recorder has written to disk what was heard. Raises CloseError."""

    def size() -> int:
        return sum(file.stat().st_size for file in log_files(run))

    def hear() -> None:
        for received in bus.take(LOOK_EVERY):
            if received.topic in order.hears and (message := bus.open(received)) is not None:
                order.take(received.topic, message)

    order, before = Still(), -1
    bus.subscribe(order.hears)
    for _ in range(FLUSH_LOOKS):
        hear()
        if order.heard < HEARD_FOR:
            continue
        if before >= 0 and size() != before:
            break
        before = size() if before < 0 else before
        pause(LOOK_EVERY)
    hear()  # what is in the log may be newer than what was heard
    if order.heard < HEARD_FOR:
        raise CloseError("the odometry tells no pose, or there is no map; see `rbtrg-robot status`")
    return order


def moved_on(place: Planar, then: Odometry, now: Planar) -> Planar:
    """Where a robot is in `map` that was at `place` when odometry told `then`, and is at `now` in `odom`."""
    frame = MapFrame()
    frame.x, frame.y, frame.yaw = offset_of(place, then)
    return frame.pose2(*now)
