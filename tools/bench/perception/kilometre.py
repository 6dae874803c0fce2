"""One kilometre through a street: does a scan cost the same at the end, does memory stay, can the map be saved?

The clouds are made up: rays of a XT16 on level ground between two walls. Elevation map, planner's copy and graph run as
the stack runs them.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import MapPatch
from mapping.elevation.map import ElevationMap
from planning.graph.graph import GraphParams
from planning.risk.body import BodyModel
from rbtrg_robot.orders.map import save
from rbtrg_robot.stage_config import ElevationStageConfig
from rbtrg_robot.stages.map_graph import MapGraph
from rbtrg_robot.wire.convert import map_patch, patch_msg
from tools.bench.report import Report

TRUNK_HEIGHT = 0.45
"""Of the trunk over the ground [m]."""
EYE_HEIGHT = 0.55
"""Of the LiDAR over the ground [m]."""
STREET_WIDTH = 12.0
"""Between the walls [m]."""
SCAN_STRIDE = 0.25
"""From scan to scan [m]."""
PLAN_EVERY = 16
"""Scans from one look at the graph to the next."""
CLOUD_COUNT = 20
"""Made up, each with noise of its own."""
STAGE = ElevationStageConfig()


def street(rng: np.random.Generator, columns: int = 900) -> NDArray[np.float32]:
    """(n, 3) one scan in base_link [m]: the nearer of ground and wall on each ray, 2 cm of noise along it."""
    up, around = np.meshgrid(
        np.radians(np.arange(-15.0, 16.0, 2.0)), np.linspace(-np.pi, np.pi, columns, endpoint=False)
    )
    ray = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        ground = np.where(ray[:, 2] < 0.0, -EYE_HEIGHT / ray[:, 2], np.inf)
        wall = 0.5 * STREET_WIDTH / np.abs(ray[:, 1])
    far = np.minimum(ground, wall)
    seen = (far < 40.0) & (ray[:, 2] * far + EYE_HEIGHT < 2.5)
    points = ray[seen] * (far[seen] + rng.normal(0.0, 0.02, seen.sum()))[:, None]
    return (points + np.array([0.0, 0.0, EYE_HEIGHT - TRUNK_HEIGHT])).astype(np.float32)


@dataclass(slots=True)
class Drive:
    """Both sides of the map on the way."""

    folder: Path
    map: ElevationMap = field(init=False)
    planner: MapGraph = field(init=False)
    scan: list[float] = field(default_factory=list)
    """Thread time of the elevation side per scan [s]."""
    apply: list[float] = field(default_factory=list)
    """Of the planner's copy, per scan [s]."""
    sync: list[float] = field(default_factory=list)
    """Of bringing the graph to the newest map [s]."""
    memory: list[tuple[float, float]] = field(default_factory=list)
    """Of both sides after each sync [MB]."""

    def __post_init__(self) -> None:
        self.map = ElevationMap(ElevationConfig())
        self.map.warm_up()
        self.map.put_on(self.folder)
        self.planner = MapGraph(GraphParams(), BodyModel(), 0)
        self.planner.mirror.put_on(self.folder)

    def take(self, k: int, cloud: NDArray[np.float32], x: float, y: float, yaw: float) -> None:
        """Scan number `k` at a pose of the street's middle line."""
        start = time.thread_time()
        turned = 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
        self.map.fuse(cloud, (x, y, TRUNK_HEIGHT), turned, (k + 1) * 10**8)
        if k % STAGE.clean_every == 0:
            self.map.clean()
        patches: list[MapPatch] = self.map.take_patches() if k % STAGE.publish_every == 1 else []
        self.map.window(x, y, STAGE.window)
        self.scan.append(time.thread_time() - start)
        messages = [patch_msg(patch) for patch in patches]
        start = time.thread_time()
        for message in messages:
            self.planner.apply(map_patch(message, 0))
        self.apply.append(time.thread_time() - start)
        if k % PLAN_EVERY == PLAN_EVERY - 1:
            start = time.thread_time()
            self.planner.sync((x, y))
            self.sync.append(time.thread_time() - start)
            self.memory.append((self.map.store.nbytes / 1e6, self.planner.mirror.nbytes / 1e6))


def rows(report: Report, metres: float) -> None:
    """Drive `metres`, half of them along x and half along y: cost per scan in the last tenth against the first, memory
    of each side, a save."""
    rng = np.random.default_rng(0)
    clouds = [street(rng) for _ in range(CLOUD_COUNT)]
    with tempfile.TemporaryDirectory() as folder:
        drive = Drive(Path(folder))
        scans = int(metres / SCAN_STRIDE)
        for k in range(scans):
            way = k * SCAN_STRIDE
            half = 0.5 * metres
            x, y, yaw = (way, 0.0, 0.0) if way < half else (half, way - half, 0.5 * np.pi)
            drive.take(k, clouds[k % CLOUD_COUNT], x, y, yaw)
        elevation, mirror = np.max(drive.memory, axis=0)
        report.add("map_1km.metres", metres, "m")
        report.add("map_1km.cells", drive.map.store.counts()[1], "1")
        report.add("map_1km.scan_ms", 1e3 * float(np.mean(drive.scan)), "ms")
        report.add("map_1km.scan_ratio", growth(drive.scan), "1", 1.2)
        report.add("map_1km.mirror_ms", 1e3 * float(np.mean(drive.apply)), "ms")
        report.add("map_1km.mirror_ratio", growth(drive.apply), "1", 1.3)
        report.add("map_1km.graph_ms", 1e3 * float(np.median(drive.sync)), "ms")
        report.add("map_1km.graph_ratio", growth(drive.sync, 1), "1", 1.3)
        report.add("map_1km.elevation_mb", float(elevation), "MB", 150.0)
        report.add("map_1km.planner_mb", float(mirror), "MB", 150.0)
        report.add(
            "map_1km.disk_mb", (drive.map.store.shelf.nbytes + drive.planner.mirror.shelf.nbytes) / 1e6, "MB"
        )
        _save(report, drive, Path(folder) / "map.npz")


def growth(times: list[float], base: int = 0) -> float:
    """Mean of the last tenth against that of tenth number `base`: of the graph the second one, as the window that is
    planned on grows with
    the map for the first 60 to 100 m."""
    tenth = len(times) // 10
    return float(np.mean(times[-tenth:]) / np.mean(times[base * tenth : (base + 1) * tenth]))


def _save(report: Report, drive: Drive, file: Path) -> None:
    """Block by block as `map save` asks for it, and into a file."""
    stalls: list[float] = []
    patches: list[MapPatch] = []
    start = time.thread_time()
    for box in drive.map.boxes():
        begin = time.thread_time()
        message = patch_msg(drive.map.read(box))
        stalls.append(time.thread_time() - begin)
        patches.append(map_patch(message, 0))
    save(patches, drive.map.cloud.points, file)
    report.add("map_1km.save_s", time.thread_time() - start, "s", 60.0)
    report.add("map_1km.save_mb", file.stat().st_size / 1e6, "MB")
    report.add("map_1km.save_blocks", len(stalls), "1")
    report.add("map_1km.stall_ms", 1e3 * max(stalls), "ms", 100.0)
