"""The elevation map against the truth of the synthetic runs: error, cost, clearing, thin and low things."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hal.robots import describe
from hal.rotation import rotation, turn
from hal.scenes import Scene
from hal.types import NS, Array, ImuSample, JointSample, LidarScan
from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import MapPatch
from mapping.elevation.map import ElevationMap
from mapping.elevation.tiles import LIDAR
from mapping.odometry.contacts import wheel_contacts
from mapping.odometry.deskew import deskew, mount_matrix
from mapping.odometry.types import ScanOdometry
from rbtrg_robot.stage_config import ElevationStageConfig
from tools.bench.report import Report
from tools.synthetic import SyntheticRun, arena_run, clearing_run, feature_run
from tools.synthetic_scenes import FEATURES, OBSTACLE

RMSE_LIMIT = {"xt16": 5.0, "mid360": 10.0}
"""True poses, gyro deskew [mm]."""
ENGINE_LIMIT = {"xt16": 20.0, "mid360": 35.0}
"""Default engine [mm]."""
STAGE = ElevationStageConfig()
"""How often the stack cleans up and publishes."""
FINE_CELL = 0.02
"""Cell size of the error figures [m]."""
FLAT_MARGIN = 0.06
"""Cells nearer than this to any change of the true height are edges, not flat [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """One scan with the true pose at its end."""

    stamp: int
    cloud: NDArray[np.float32]
    """(n, 3) base_link, deskewed to `stamp`: rotation from the gyro, translation from the truth."""
    position: Array
    orientation: Array
    contacts: Array
    """(k, 3) base_link."""


def registered(run: SyntheticRun) -> Iterator[Registered]:
    """The scans of a run on true poses, deskewed with the run's noisy gyro."""
    mount = mount_matrix(run.extrinsics)
    imu: list[ImuSample] = []
    joints: JointSample | None = None
    for sample in run.samples():
        if isinstance(sample, ImuSample):
            imu = [*imu[-100:], sample]
        elif isinstance(sample, JointSample):
            joints = sample
        elif isinstance(sample, LidarScan):
            end = sample.stamp + run.lidar.period
            inside = [s for s in imu if sample.stamp <= s.stamp <= end]
            stamps = np.array([s.stamp for s in inside])
            position, orientation = run.truth(stamps)
            track = np.zeros((len(stamps), 10))
            track[:, :3], track[-1, 6:] = position, orientation[-1]
            for k in range(len(inside) - 2, -1, -1):
                back = -0.5 * (inside[k].gyro + inside[k + 1].gyro) * (stamps[k + 1] - stamps[k]) / NS
                track[k, 6:] = track[k + 1, 6:]
                turn(track[k, 6:], *back)
            p = sample.points
            xyz = np.stack([p["x"], p["y"], p["z"]], axis=1) @ mount[:3, :3].T + mount[:3, 3]
            cloud = deskew(xyz.astype(np.float32), p["time"], stamps, track, sample.stamp, np.zeros(3))
            contacts = np.zeros((0, 3)) if joints is None else wheel_contacts(describe().limbs, joints)
            yield Registered(int(stamps[-1]), cloud, position[-1], orientation[-1], contacts)


@dataclass(slots=True)
class Mapper:
    """Runs a map as the stack does; keeps the cost."""

    run: SyntheticRun
    resolution: float = 0.04
    map: ElevationMap = field(init=False)
    fusion: list[float] = field(default_factory=list)
    """Thread time per scan [s]."""
    cleanup: list[float] = field(default_factory=list)
    deltas: list[float] = field(default_factory=list)
    scans: int = 0

    def __post_init__(self) -> None:
        self.map = ElevationMap(ElevationConfig(resolution=self.resolution))
        self.map.warm_up()

    def take(self, scan: Registered | ScanOdometry) -> None:
        """Fuse one scan; clean up at every third."""
        start = time.thread_time()
        self.map.fuse(scan.cloud, scan.position, scan.orientation, scan.stamp, self.run.sensor)
        self.fusion.append(time.thread_time() - start)
        if isinstance(scan, Registered):
            self.map.fuse_ground(scan.contacts, scan.position, scan.orientation, scan.stamp)
        self.scans += 1
        if self.scans % STAGE.clean_every == 0:
            start = time.thread_time()
            self.map.clean()
            self.cleanup.append(time.thread_time() - start)
        if self.scans % STAGE.publish_every == 1:
            start = time.thread_time()
            self.map.take_patches()
            self.deltas.append(time.thread_time() - start)


@dataclass(slots=True)
class EngineMap:
    """A map on an engine's poses, to be scored against the truth: `take` is an `OnScan` for one engine."""

    run: SyntheticRun
    mapper: Mapper = field(init=False)
    first: ScanOdometry | None = None

    def __post_init__(self) -> None:
        self.mapper = Mapper(self.run, FINE_CELL)

    def take(self, scan: ScanOdometry) -> None:
        """Fuse one result of the engine."""
        if len(scan.cloud):
            self.first = self.first or scan
            self.mapper.take(scan)

    def rmse_mm(self) -> float:
        """See `flat_rmse_mm`; the map is laid over the truth by x, y, z and heading of its first pose."""
        assert self.first is not None
        position, orientation = self.run.truth(self.first.stamp)
        a, b = rotation(orientation[0]), rotation(np.ascontiguousarray(self.first.orientation))
        heading = np.arctan2(a[1, 0], a[0, 0]) - np.arctan2(b[1, 0], b[0, 0])
        return flat_rmse_mm(self.run.scene, self.mapper.map.full(), heading, position[0], self.first.position)


def flat_rmse_mm(
    scene: Scene, patch: MapPatch, heading: float = 0.0, at: Array | None = None, mapped: Array | None = None
) -> float:
    """RMS height error of trusted LiDAR cells where the true ground is level for `FLAT_MARGIN` around [mm].

    heading [rad], `at` (3,) in the world and `mapped` (3,) in the map: the same pose, to lay one over the other.
    """
    at, mapped = (np.zeros(3) if v is None else v for v in (at, mapped))
    layers = patch.layers
    row, col = np.nonzero((layers["source"] == LIDAR) & (layers["trusted"] > 0.5))
    x, y = (
        patch.origin[0] + col * patch.resolution - mapped[0],
        patch.origin[1] + row * patch.resolution - mapped[1],
    )
    c, s = np.cos(heading), np.sin(heading)
    r = np.round((at[1] + s * x + c * y - scene.origin[1]) / scene.resolution).astype(int)
    k = np.round((at[0] + c * x - s * y - scene.origin[0]) / scene.resolution).astype(int)
    n = round(FLAT_MARGIN / scene.resolution)
    rows, cols = scene.height.shape
    inside = (r >= n) & (r < rows - n) & (k >= n) & (k < cols - n)
    r, k = r[inside], k[inside]
    got = layers["elevation"][row[inside], col[inside]] - mapped[2] + at[2]
    around = [scene.height[r + a, k + b] for a in range(-n, n + 1) for b in range(-n, n + 1)]
    flat = np.ptp(around, axis=0) < 1e-6
    return 1e3 * float(np.sqrt(np.mean(np.square(got[flat] - scene.height[r, k][flat]))))


def rows(report: Report, lidars: list[str], seconds: float, seed: int) -> None:
    """Rows of the map on true poses: `map_rmse_mm.LIDAR.truth`, CPU, `cleared_s`, `seen.FEATURE`."""
    for lidar in lidars:
        run = arena_run(lidar, seed=seed, duration=seconds)
        fine = Mapper(run, FINE_CELL)
        for scan in registered(run):
            fine.take(scan)
        rmse = flat_rmse_mm(run.scene, fine.map.full())
        report.add(f"map_rmse_mm.{lidar}.truth", rmse, "mm", RMSE_LIMIT.get(lidar))
        if lidar == "xt16":
            fusion, cleanup, deltas = cost_ms(run)
            report.add("cpu_ms.fusion", fusion, "ms", 1.0)
            report.add("cpu_ms.cleanup", cleanup, "ms", 15.0)
            report.add("cpu_ms.deltas", deltas, "ms")
    report.add("cleared_s", cleared_s(seed), "s", 1.5)
    for name in FEATURES:
        report.add(f"seen.{name}", float(seen(name, seed)), "1", 1.0, at_least=True)


def cost_ms(run: SyntheticRun, scans: int = 90, repeats: int = 5) -> tuple[float, float, float]:
    """Thread time of fusion, clean-up and of working out the deltas [ms]: median over scans of the best of `repeats`
    (the machine is shared)."""
    taken = [scan for scan, _ in zip(registered(run), range(scans), strict=False)]
    fusion, cleanup, deltas = [], [], []
    for _ in range(repeats):
        mapper = Mapper(run)
        for scan in taken:
            mapper.take(scan)
        fusion.append(mapper.fusion)
        cleanup.append(mapper.cleanup)
        deltas.append(mapper.deltas)
    return tuple(1e3 * float(np.median(np.min(times, axis=0))) for times in (fusion, cleanup, deltas))  # type: ignore[return-value]


def cleared_s(seed: int) -> float:
    """From the removal of an obstacle (0.4 x 0.4 x 0.8 m) until no cell of its ground stands higher than 0.1 m [s]."""
    run = clearing_run("xt16", removed_at=8.0, duration=14.0, seed=seed)
    mapper = Mapper(run)
    x, y, _ = OBSTACLE.centre
    stood, last = False, np.inf
    for scan in registered(run):
        mapper.take(scan)
        t = float(run.seconds(scan.stamp)[0]) - run.removed_at
        high = bool((mapper.map.window(x, y, 0.5 * OBSTACLE.size[0]).layers["elevation"] > 0.1).any())
        if t <= 0.0:
            stood = high
        elif high:
            last = np.inf
        else:
            last = min(last, t)
    return float(last) if stood else float("nan")


def seen(name: str, seed: int) -> bool:
    """Whether a feature shows in the map while the robot rests 2 m before it."""
    run = feature_run(name, "xt16", seed=seed)
    mapper = Mapper(run)
    for scan in registered(run):
        mapper.take(scan)
    feature = FEATURES[name]
    x0, x1, y0, y1 = feature.rect
    half = 1.0
    patch = mapper.map.window(feature.face + 0.5, 0.0, half)
    height, trusted = patch.layers["elevation"], patch.layers["trusted"] > 0.5
    x = patch.origin[0] + patch.resolution * np.arange(patch.shape[1])[None, :]
    y = patch.origin[1] + patch.resolution * np.arange(patch.shape[0])[:, None]
    half_cell = 0.5 * patch.resolution
    before = trusted & (x > x0 - 0.4) & (x < x0 - 0.05) & (np.abs(y) < 0.4)
    if not (before.sum() > 100 and np.abs(height[before]).max() < 0.03):
        return False  # the ground before it must be there and level
    if name == "pole":
        on = (x > x0 - half_cell) & (x < x1 + half_cell) & (y > y0 - half_cell) & (y < y1 + half_cell)
        return bool((trusted & on & (height > 0.8)).any())
    lane = np.abs(y[:, 0]) < 0.4
    if name == "pit":
        hole = (x > x0 + 0.05) & (x < x1 - 0.05) & lane[:, None]
        level = trusted & hole & (height > 0.5 * feature.top)
        filled = patch.grid(filled=True).height
        return bool(level.sum() == 0 and np.median(filled[hole]) < -0.03)
    # every line of cells along x across the edge must rise by most of the step
    top = np.where(trusted & (x > x0 - half_cell) & (x < x0 + 0.12), height, -np.inf).max(axis=1)
    return bool((np.abs(top[lane] - feature.top) < 0.025).all())
