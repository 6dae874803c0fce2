"""`map close`: the loops of a run are closed while the stack goes on. The run's log so far becomes a map (`map_build`),
the robot goes on with it, and is told where it stands in it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hal.errors import OperatorError
from rbtrg_robot.hosts.map_build import Built, Progress, build
from rbtrg_robot.hosts.offline import config_of
from rbtrg_robot.log.read import log_files
from rbtrg_robot.orders.map import LoadMap, read
from rbtrg_robot.orders.order import follow
from rbtrg_robot.orders.pose import SetPose
from rbtrg_robot.orders.still import Still
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.wire.bus import Bus

FLUSH_LOOKS, LOOK_EVERY = 100, 0.1
"""Looks at the log until the recorder has written again, and the time between them [s]."""


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
    progress: Progress = lambda _what, _share: None,
    say: Callable[[str], None] = lambda _text: None,
) -> Result:
    """Build the map of `run` so far into `out` (.npz) with its loops closed, and have the stack on `bus` go on with it
    if that moves any keyframe by `least` [m] or more.

    The robot stands meanwhile and has no goal. pause: waits so many seconds for the log. Raises CloseError,
    ConfigError, LogError, MapError, which say what to do.
    """
    still = _standing(bus)
    if still.prior and not (out.is_file() and still.prior == fingerprint(str(out))):
        raise CloseError(
            "the stack began with a prior map, in which the robot finds itself: loops are closed in maps that it makes "
            "alone; use `map build` on the logs"
        )
    _written(run, pause)
    built = build([run], out, drift=drift, areas=still.areas, progress=progress, say=say)
    if built.stamp < still.since:
        raise CloseError(f"the log {run} ends before the robot stood: try again, or see `rbtrg-robot status`")
    loops, moved = len(built.record["closed"]), built.record["moved_m"]
    if not loops or moved < least:
        what = f"{loops} loops moved it by {moved:.2f} m" if loops else "no loop was closed"
        return Result(built, False, f"{what}: the stack goes on with the map that it has")
    prior = read(out, config_of(run, None, ()).elevation)
    bus.take(0.0)  # what was said meanwhile
    now = _standing(bus)
    if now.left(still):
        raise CloseError(f"the robot moved while {out} was made: let it stand, and try again")
    x, y = built.pose[:2, 3].tolist()
    yaw = math.atan2(built.pose[1, 0], built.pose[0, 0])
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


def _standing(bus: Bus) -> Still:
    order = Still()
    end = follow(bus, order)
    if not end.ok:
        raise CloseError(end.words)
    return order


def _written(run: Path, pause: Callable[[float], None]) -> None:
    """Wait until the recorder has written to disk again."""

    def size() -> int:
        return sum(file.stat().st_size for file in log_files(run))

    before = size()
    for _ in range(FLUSH_LOOKS):
        if size() != before:
            return
        pause(LOOK_EVERY)
