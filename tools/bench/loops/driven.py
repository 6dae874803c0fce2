"""Drives with physics and the stack's own odometry: their loops closed by `map build` on the log, and by themselves."""

from __future__ import annotations

import argparse
import math
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hal.rotation import wrap
from hal.scenes import Scene
from hal.scenes.files import save_scene
from hal.types import Array
from mapping.closing import Closed
from mapping.closing.graph import between
from mapping.elevation.map import ElevationMap
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.map_build import build
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import xyz, xyzw, yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import decode, stamp_of
from tools.bench.report import Report
from tools.bench.spent import Spent
from tools.closing import Way

GOAL_TIMEOUT = 240.0
"""Of a corner [s]."""
STAND_SECONDS = 20.0
"""After the last corner: what is searched then, and a jump into the closed map."""
WRONG_LOOP = (0.3, 2.0)
"""A closed loop that is further off is wrong [m], [deg]."""
WANTED_ERROR = (0.15, 0.3)
"""Everywhere after [m], [deg]."""
WALL_OFF = 0.3
"""A cell so far from the scene [m] shows a wall where none is, or none where it is."""


class Driven:
    """One drive, and what the truth says of it."""

    def __init__(self, scene: Scene, way: Way, options: argparse.Namespace, folder: Path) -> None:
        self.scene, self.way, self.run = scene, way, folder / "run.mcap"
        save_scene(scene, folder / "scene.npz")
        sets = [*options.set, "recorder.profile=full"]
        self.config = load(None, sets, scene=str(folder / "scene.npz"), seed=options.first)
        self._truth: list[tuple[int, Array]] = []
        self._odom: dict[int, float] = {}
        self._told: list[tuple[int, Array, Array]] = []
        self._frame, self._first = MapFrame(), MapFrame()
        self.reached = 0
        self.taken: set[str] = set()
        """Ids of the closed maps that the stack took."""

    def __call__(self, topic: Topic, payload: bytes, _now: int) -> None:
        """Hear the truth, the odometry, where that lies in `map`, and which map that is."""
        message: Any = decode(payload, topic.kind)
        if topic is t.TF_STATIC:
            self._frame.take(message)
            if not self._first.known:
                self._first.take(message)
            return
        if topic is t.MAP_STATUS:
            self.taken |= {message.prior} - {""}
            return
        pose, stamp = message.pose.pose, stamp_of(message)
        place = xyz(pose.position)
        if topic is t.TRUTH:
            self._truth.append((stamp, np.array([*place, yaw_of(pose.orientation)])))
            return
        self._odom[stamp] = place[2]
        if self._frame.known:
            turned = xyzw(pose.orientation)
            alone, told = (frame.pose3(place, turned)[0] for frame in (self._first, self._frame))
            self._told.append((stamp, alone, told))

    def at(self, stamps: list[int]) -> Array:
        """(n, 4) x, y, z [m], yaw [rad] of base_link by the truth."""
        known, poses = zip(*self._truth, strict=True)
        columns = np.array(poses).T
        columns[3] = np.unwrap(columns[3])
        return np.column_stack([np.interp(stamps, known, column) for column in columns])

    def off(self) -> Array:
        """(n, 2) how far [m] the robot is at each scan from where odometry alone has it in `map`, and from where it is
        told to be."""
        stamps = [stamp for stamp, *_ in self._told]
        places = np.array([[alone[:2], told[:2]] for _, alone, told in self._told])
        return np.asarray(np.linalg.norm(places - self.at(stamps)[:, None, :2], axis=2))

    def drive(self) -> tuple[ElevationMap, dict[str, float], Any]:
        """To every corner; the map that the stack has at the end, CPU [s] by stage, and the stage `loops` or None."""
        log = Lockstep.open_log(self.config, self.run) if "loops" in self.config.absent else None
        with Lockstep(self.config, log) as stack:
            stack.host.listen(self, {t.TRUTH, t.ODOM, t.TF_STATIC, t.MAP_STATUS})
            spent = Spent(stack)
            stack.wait_ready()
            for x, y in self.way[1:]:
                stack.send_goal(x, y)
                self.reached += stack.finish_goal(GOAL_TIMEOUT).state == "reached"
            stack.run(STAND_SECONDS)
            loops = None if "loops" in self.config.absent else stack.host.stage("loops")
            return stack.host.stage("elevation").map, spent.seconds, loops

    @property
    def length(self) -> float:
        """Driven [m], by the truth every 0.2 s."""
        places = np.array([pose[:2] for _, pose in self._truth[::10]])
        return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())

    def grounds(self, closed: Closed, stamps: list[int]) -> Array:
        """(n, 4) of the ground under each keyframe, seen at `stamps` [ns], by the truth."""
        out = self.at(stamps)
        for row, stamp, frame in zip(out, stamps, closed.keyframes, strict=True):
            row[2] -= self._odom[stamp] - frame.place[2]
        return out

    def walls_off(self, made: ElevationMap) -> float:
        """Share of trusted cells that show a wall where none is, or none where it is."""
        off, count = 0, 0
        for box in made.boxes():
            grid = made.read(box).grid()
            rows, cols = np.nonzero(grid.trusted)
            x, y = grid.origin[0] + cols * grid.resolution, grid.origin[1] + rows * grid.resolution
            z = np.array([self.scene.z(*at) for at in zip(x.tolist(), y.tolist(), strict=True)])
            off += int((np.abs(grid.height[rows, cols] - z) > WALL_OFF).sum())
            count += len(rows)
        return off / count


def largest(nodes: Array, grounds: Array) -> tuple[float, float]:
    """Largest error of keyframes (n, 4): place [m], heading [deg]."""
    off = nodes - grounds
    return float(np.linalg.norm(off[:, :3], axis=1).max()), float(np.degrees(np.abs(wrap(off[:, 3]))).max())


def wrongs(closed: Closed, grounds: Array) -> int:
    """Loops that were closed where there are none. grounds (n, 4): of the keyframes, by the truth."""
    count = 0
    for loop in closed.loops:
        off = loop.match.relative - between(grounds[loop.match.first], grounds[loop.match.second])
        count += bool(
            np.linalg.norm(off[:3]) > WRONG_LOOP[0] or abs(wrap(off[3])) > math.radians(WRONG_LOOP[1])
        )
    return count


def built_rows(report: Report, name: str, scene: Scene, way: Way, options: argparse.Namespace) -> None:
    """One drive whose log `map build` closes."""
    with tempfile.TemporaryDirectory() as folder:
        driven, out = Driven(scene, way, options, Path(folder)), Path(folder) / "map.npz"
        had, _, _ = driven.drive()
        _driven(report, name, driven)
        began = time.process_time()
        built = build([driven.run], out, drift=options.drift)
        spent = time.process_time() - began
        made = ElevationMap(driven.config.elevation)
        made.load_prior(out)
        assert built.closed is not None
        grounds = driven.grounds(built.closed, [frame["stamp_ns"] for frame in built.record["keyframes"]])
        for when, nodes in (("before", built.closed.driven), ("after", built.closed.nodes)):
            metres, degrees = largest(nodes, grounds)
            asked = WANTED_ERROR if when == "after" else (None, None)
            report.add(f"{name}.{when}_m", metres, "m", asked[0])
            report.add(f"{name}.{when}_deg", degrees, "deg", asked[1])
        report.add(f"{name}.walls_off_before", driven.walls_off(had), "share")
        report.add(f"{name}.walls_off_after", driven.walls_off(made), "share")
        _closed(report, name, built.closed, grounds)
        report.add(f"{name}.close_ms_per_m", 1e3 * spent / driven.length, "ms")


def online_rows(report: Report, name: str, scene: Scene, way: Way, options: argparse.Namespace) -> None:
    """One drive whose loops close by themselves; each map that comes of it is taken, however little it moves."""
    with tempfile.TemporaryDirectory() as folder:
        options.set += ["loops.online=true", f"loops.drift={options.drift}", "loops.least=0"]
        driven = Driven(scene, way, options, Path(folder))
        had, seconds, stage = driven.drive()
        _driven(report, name, driven)
        report.add(f"{name}.maps_taken", len(driven.taken), "1", 1.0, at_least=True)
        off = driven.off()
        report.add(f"{name}.worst_before_m", float(off[:, 0].max()), "m")
        report.add(f"{name}.worst_m", float(off[:, 1].max()), "m")
        report.add(f"{name}.before_m", float(off[-1, 0]), "m")
        report.add(f"{name}.after_m", float(off[-1, 1]), "m", WANTED_ERROR[0])
        report.add(f"{name}.walls_off_after", driven.walls_off(had), "share")
        if stage.closed is not None:
            scans = stage.recording.scans
            stamps = [scans[frame.scan].stamp for frame in stage.closed.keyframes]
            _closed(report, name, stage.closed, driven.grounds(stage.closed, stamps))
        stages = sum(share for stage, share in seconds.items() if not stage.startswith("robot"))
        report.add(f"{name}.close_ms_per_m", 1e3 * seconds["loops"] / driven.length, "ms")
        report.add(f"{name}.of_the_stages", seconds["loops"] / stages, "share")
        report.add(f"{name}.peak_mb", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, "MB")


def _driven(report: Report, name: str, driven: Driven) -> None:
    report.add(f"{name}.corners", driven.reached / (len(driven.way) - 1), "share", 1.0, at_least=True)
    report.add(f"{name}.driven", driven.length, "m")


def _closed(report: Report, name: str, closed: Closed, grounds: Array) -> None:
    report.add(f"{name}.loops", len(closed.loops), "1", 1.0, at_least=True)
    report.add(f"{name}.refused", len(closed.refused), "1")
    report.add(f"{name}.wrong", wrongs(closed, grounds), "1", 0.0)
