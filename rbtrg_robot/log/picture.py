"""A run seen from above, drawn from its log: the map at the end (untrusted dark, assumed orange), the last path, and
the driven way."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hal.scenes.picture import GREEN, RED, WHITE, TopView
from mapping.elevation.mirror import MapMirror
from mapping.elevation.tiles import ASSUMED
from rbtrg_robot import topics as t
from rbtrg_robot.config import ConfigError
from rbtrg_robot.log.read import read_run
from rbtrg_robot.wire.convert import LayoutError, map_patch, yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import MessageError, decode

PATH_COLOUR = (255, 170, 40)
TRACK_COLOUR = (90, 200, 255)
TRAIL_STEP = 0.02
"""[m] between drawn places of the robot."""


def picture(log: Path, out: Path) -> float:
    """Write FILE.png; returns the distance driven [m], by odometry. Raises LogError, ConfigError if there is no map
    to draw."""
    mirror, frame = MapMirror(), MapFrame()
    track: list[tuple[float, float]] = []
    path: list[tuple[float, float]] = []
    goals: list[tuple[float, float]] = []
    yaw = driven = 0.0
    for entry in read_run(log):
        topic = t.BY_NAME.get(entry.topic)
        if topic not in (t.TF, t.TF_STATIC, t.MAP_UPDATE, t.ODOM, t.ROUTE, t.GOAL_REQUEST):
            continue
        try:
            message = decode(entry.data, topic.kind)
            patch = map_patch(message, mirror.epoch) if topic is t.MAP_UPDATE else None
        except (MessageError, LayoutError):
            continue  # what was recorded broken is not drawn
        if topic in (t.TF, t.TF_STATIC):
            frame.take(message)
        elif patch is not None:
            mirror.apply(patch)
        elif topic is t.ODOM and frame.known:
            place = message.pose.pose
            x, y, yaw = frame.pose2(place.position.x, place.position.y, yaw_of(place.orientation))
            if not track:
                track.append((x, y))
            step = ((x - track[-1][0]) ** 2 + (y - track[-1][1]) ** 2) ** 0.5
            if step >= TRAIL_STEP:
                driven += step
                track.append((x, y))
        elif topic is t.ROUTE:
            path = [(p.pose.position.x, p.pose.position.y) for p in message.poses]
        elif (
            topic is t.GOAL_REQUEST and message.action == message.SET and (message.x, message.y) not in goals
        ):
            goals.append((message.x, message.y))
    if not mirror.resolution:
        raise ConfigError(
            f"{log} holds no elevation map: there is nothing to draw; where it holds sweeps, "
            f"`rbtrg-robot replay {log} --rerun odometry,elevation --out FULL.mcap` makes one"
        )
    patch = mirror.patch()
    grid, assumed = patch.grid(filled=True), patch.layers["source"] == ASSUMED
    if not grid.trusted.any():
        raise ConfigError(f"the elevation map in {log} holds no ground yet: there is nothing to draw")
    r, c = (np.flatnonzero(grid.trusted.any(axis=axis)) for axis in (1, 0))
    seen = slice(r[0], r[-1] + 1), slice(c[0], c[-1] + 1)
    x0, y0 = grid.origin
    corner = x0 + c[0] * grid.resolution, y0 + r[0] * grid.resolution
    view = TopView(grid.height[seen], grid.trusted[seen], corner, grid.resolution, assumed=assumed[seen])
    if path:
        view.line(path, PATH_COLOUR, 3)
    view.line(track, TRACK_COLOUR, 2)
    for number, (x, y) in enumerate(goals, 1):
        view.disc(x, y, RED, 5)
        view.label(x, y, f"goal {number}")
    if track:
        view.disc(*track[0], WHITE, 4)
        view.arrow(*track[-1], yaw, 0.4, GREEN)
    view.save(out)
    return driven
