"""`map build`: runs in, a map whose loops are closed out, with a picture and a JSON file beside it that tell why."""

from __future__ import annotations

import json
import math
import os
import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hal.scenes.picture import GREEN, ORANGE, RED, WHITE, TopView
from hal.types import Array
from mapping.closing import Closed, Closing, Recording, corrected, fuse
from mapping.closing.graph import between
from mapping.elevation.map import ElevationMap
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import to_text
from rbtrg_robot.config import ConfigError, StackConfig
from rbtrg_robot.hosts.offline import Window, config_of, feed, stages_for
from rbtrg_robot.hosts.swept import Swept
from rbtrg_robot.log.read import LogError, read_run
from rbtrg_robot.log.summary import overview
from rbtrg_robot.stages.reader import Reader
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.messages import MessageError, decode, stamp_of

Progress = Callable[[str, float], None]
"""Called with what is being done and the share of it that is."""
PICTURE_PIXELS = (900, 1500)
"""Of the picture's longer side, at least and at most."""
OF_ODOMETRY = ("odometry", "own_parts", "lidars", "robot_model", "unitree")
"""Settings with which odometry would tell other poses than the log has."""
LOOP_COLOUR, WAY_COLOUR = GREEN, WHITE


@dataclass(slots=True)
class Built:
    """What came of it."""

    runs: list[dict[str, Any]] = field(default_factory=list)
    closed: Closed | None = None
    record: dict[str, Any] = field(default_factory=dict)
    """As in the JSON file."""
    stamp: int = 0
    """Of the newest scan [ns]."""
    pose: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) of base_link in `map` then."""


def build(
    runs: Sequence[Path],
    out: Path,
    *,
    file: Path | None = None,
    sets: Sequence[str] = (),
    drift: float = 1.0,
    areas: Sequence[msg.GroundArea] = (),
    until: int = 2**62,
    progress: Progress = lambda _what, _share: None,
    say: Callable[[str], None] = lambda _text: None,
) -> Built:
    """Write the map of `runs` to `out` (.npz), and beside it what was found (.json) and a picture (.png). The first
    run's `map` is the map's frame; `areas` are drawn on it. Scans after `until` [ns] are left out: a log may
    grow while it is read.

    Where a log holds the deskewed clouds they are used, else its sweeps along the poses that it holds. Where there are
    none, or settings of the odometry are others, odometry runs again. The configuration is
    that of each log, of the elevation map that of the first, changed by `file` and `sets`; drift: see `Closing`. Raises
    ConfigError, LogError, MapError, which say what to do.
    """
    if out.suffix != ".npz":
        raise ConfigError(f"{out} must end in .npz: `up --map` reads it by that")
    if not 0.1 <= drift <= 100.0:
        raise ConfigError(f"--drift is 0.1 to 100 times that of the robot's own odometry, got {drift:g}")
    if not out.resolve().parent.is_dir():
        raise ConfigError(f"there is no folder {out.resolve().parent}")
    built = Built()
    try:
        recording = Recording(out.resolve().parent)
    except OSError as error:
        raise _cannot(out, error) from error
    try:
        readers = [
            _read(recording, number, log, file, sets, built, until, progress, say)
            for number, log in enumerate(runs)
        ]
        params = config_of(runs[0], file, sets).elevation
        closing = Closing(recording, params, readers[0].origin, drift)
        closed = built.closed = closing.close(lambda share: progress("loops", share))
        poses = corrected(recording.scans, closed.keyframes, closed.nodes)
        which = [n for n, scan in enumerate(recording.scans) if scan.run not in closed.lost]
        made = fuse(recording, poses, params, which, lambda share: progress("map", share))
        made.save(out, to_text(areas))
        built.stamp, built.pose = recording.scans[which[-1]].stamp, poses[which[-1]]
        built.pose[2, 3] += made.alignment.height
        built.record = _record(built, closed, recording, poses, made)
        _beside(out, ".json", json.dumps(built.record, indent=1).encode())
        _picture(made, closed, out.with_suffix(".png"))
    except OSError as error:
        raise _cannot(out, error) from error
    finally:
        recording.close()
    return built


def _cannot(out: Path, error: OSError) -> ConfigError:
    return ConfigError(f"cannot write {out}: {error.strerror}; make room or name another file")


def _read(
    recording: Recording,
    number: int,
    log: Path,
    file: Path | None,
    sets: Sequence[str],
    built: Built,
    until: int,
    progress: Progress,
    say: Callable[[str], None],
) -> Reader:
    config = config_of(log, file, sets, say)
    reader = Reader(recording, number, config)
    reader.until = until
    wanted = frozenset(reader.inputs)
    name = f"run {number + 1}"
    progress(name, 0.0)
    held = overview(log)
    before = len(recording.scans)

    def done(seconds: float) -> None:
        progress(name, min(seconds / max(held.seconds, 1e-9), 1.0))

    def take(topic: Topic, payload: bytes, _now: int, _stamp: int, _sequence: int) -> None:
        if topic in wanted:
            try:
                reader.take(topic, decode(payload, topic.kind))
            except MessageError:
                reader.refused += 1

    def counted(topic: Topic) -> int:
        return held.topics[topic.name].count if topic.name in held.topics else 0

    logged = config_of(log, None, ())
    told = all(getattr(config, name) == getattr(logged, name) for name in OF_ODOMETRY)
    if counted(t.CLOUD):
        for entry in read_run(log):
            topic = t.BY_NAME.get(entry.topic)
            if topic in wanted and entry.type == topic.type:
                take(topic, entry.data, entry.log_time, entry.publish_time, entry.sequence)
                done((entry.log_time - held.begin) / 1e9)
    elif told and counted(t.ODOM) and counted(t.ODOM_HEALTH) and not config.odometry.without:
        _sweeps(reader, config, log, lambda stamp: done((stamp - held.begin) / 1e9))
    else:
        stages = stages_for(log, ["odometry"], config)
        feed(log, stages, config, take, Window(held.begin), done, say)
    kept = recording.scans[before:]
    if not kept:
        raise LogError(
            f"{log} holds no scan with a pose: its odometry never began or was lost; see `rbtrg-robot log info {log}`"
        )
    if reader.refused:
        say(f"{name}: {reader.refused} messages could not be used")
    built.runs.append(
        {"log": str(log), "driven_m": round(kept[-1].along, 2), "scans": reader.scans, "kept": len(kept)}
    )
    return reader


def _sweeps(reader: Reader, config: StackConfig, log: Path, done: Callable[[int], None]) -> None:
    """Sweeps at the poses that the odometry told while the log was made."""
    swept = Swept(config)
    poses: dict[int, msg.Odometry] = {}
    healths: dict[int, msg.OdometryHealth] = {}
    heard: tuple[Topic, ...] = (t.ODOM, t.ODOM_HEALTH, t.JOINTS, t.TF_STATIC, *swept.topics)
    wanted = {topic.name: topic for topic in heard}
    for entry in read_run(log, raw=True):
        topic = wanted.get(entry.topic)
        if topic is None:
            continue
        done(entry.log_time)
        try:
            if topic in swept.topics:
                swept.sweep(swept.topics[topic], entry.data, entry.type)
                continue
            if entry.type != topic.type:
                continue
            message: Any = decode(entry.data, topic.kind)
            if topic is t.ODOM:
                poses[stamp_of(message)] = message
            elif topic is t.ODOM_HEALTH:
                healths[stamp_of(message)] = message
            else:
                reader.take(topic, message)
        except MessageError:
            reader.refused += 1
        for stamp in sorted(poses.keys() & healths.keys()):
            if stamp > reader.until:
                return
            told, health = poses.pop(stamp), healths.pop(stamp)
            pose = swept.pose(told)
            swept.health(health)
            if health.health == "lost" or not reader.wants(pose.matrix, stamp):
                reader.scans += 1
                continue
            reader.scan(told, swept.clouds())


def _record(
    built: Built, closed: Closed, recording: Recording, poses: Array, made: ElevationMap
) -> dict[str, Any]:
    """Everything that was found, in metres and degrees."""
    moved = between(closed.driven, closed.nodes)
    away = np.linalg.norm(moved[:, :3], axis=1)
    return {
        "runs": built.runs,
        "not_in_the_map": [built.runs[run]["log"] for run in closed.lost],
        "keyframes": [
            {
                "run": frame.run + 1,
                "stamp_ns": recording.scans[frame.scan].stamp,
                "along_m": round(frame.along, 2),
                "x": round(float(node[0]), 3),
                "y": round(float(node[1]), 3),
                "z": round(float(node[2]), 3),
                "yaw_deg": round(math.degrees(node[3]), 2),
            }
            for frame, node in zip(closed.keyframes, closed.nodes, strict=True)
        ],
        "closed": [
            {
                "first": loop.match.first,
                "second": loop.match.second,
                "certainty": round(loop.match.certainty, 3),
                "residual_m": round(float(np.linalg.norm(loop.off[:3])), 3),
                "residual_deg": round(abs(math.degrees(loop.off[3])), 3),
                "weight": round(loop.weight, 3),
            }
            for loop in closed.loops
        ],
        "refused": [
            {
                "first": refusal.first,
                "second": refusal.second,
                "certainty": round(refusal.certainty, 3),
                "why": refusal.why,
            }
            for refusal in closed.refused
        ],
        "moved_m": round(float(away.max()), 3),
        "moved_deg": round(float(np.degrees(np.abs(moved[:, 3])).max()), 3),
        "odometry_sigmas": round(closed.stretch, 2),
        "known_cells": int(made.store.counts()[1]),
        "recording_mb": round(recording.nbytes / 1e6, 1),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3),
    }


def _beside(out: Path, suffix: str, data: bytes) -> None:
    part = out.with_name(f".{out.name}{suffix}.part")
    part.write_bytes(data)
    os.replace(part, out.with_suffix(suffix))


def _picture(made: ElevationMap, closed: Closed, path: Path) -> None:
    """The map from above, the way by odometry in orange, the corrected one white, closed loops green, refused ones
    red."""
    corners = np.array(made.boxes())
    row, col = corners[:, :2].min(axis=0)
    rows, cols = (corners[:, :2] + corners[:, 2:]).max(axis=0) - (row, col)
    step = max(1, math.ceil(max(rows, cols) / PICTURE_PIXELS[1]))
    height = np.full((-(-rows // step), -(-cols // step)), -np.inf, np.float32)
    for box in made.boxes():
        grid = made.read(box).grid()
        i, j = np.nonzero(grid.trusted)
        np.maximum.at(height, ((i + box[0] - row) // step, (j + box[1] - col) // step), grid.height[i, j])
    known = np.isfinite(height)
    r = made.params.resolution
    origin = (float((col + 0.5 * (step - 1)) * r), float((row + 0.5 * (step - 1)) * r))
    view = TopView(
        np.where(known, height, 0.0), known, origin, step * r, max(PICTURE_PIXELS[0], *height.shape)
    )
    for refusal in closed.refused:
        if refusal.first != refusal.second and refusal.certainty > 0.0:
            view.line([_xy(closed.nodes[k]) for k in (refusal.first, refusal.second)], RED)
    for nodes, colour in ((closed.driven, ORANGE), (closed.nodes, WAY_COLOUR)):
        for run in sorted({frame.run for frame in closed.keyframes} - set(closed.lost)):
            own = [k for k, frame in enumerate(closed.keyframes) if frame.run == run]
            view.line([_xy(nodes[k]) for k in own], colour)
    for loop in closed.loops:
        view.line([_xy(closed.nodes[k]) for k in (loop.match.first, loop.match.second)], LOOP_COLOUR, 2)
        view.disc(*_xy(closed.nodes[loop.match.second]), LOOP_COLOUR)
    view.save(path)


def _xy(node: Array) -> tuple[float, float]:
    return float(node[0]), float(node[1])
