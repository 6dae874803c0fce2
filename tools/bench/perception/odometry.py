"""Odometry engines side by side on one synthetic run: errors against the truth, CPU per scan."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hal.rotation import quaternion, rotation, rotation_vector
from hal.types import Array, Extrinsics, GroundTruth, ImuSample, JointSample, LidarScan, Sample
from mapping.odometry.deskew import mount_matrix
from mapping.odometry.health import Health
from mapping.odometry.pipeline import LidarInertialOdometry, OdometryConfig
from mapping.odometry.registration.engines import ENGINES
from mapping.odometry.types import ScanOdometry


class Run(Protocol):
    """A drive with its truth: synthetic, or recorded in simulated physics."""

    @property
    def extrinsics(self) -> Extrinsics:
        """LiDAR in base_link."""

    def samples(self) -> Iterator[Sample]:
        """In order of arrival."""

    def truth(self, stamps: NDArray[np.integer] | int) -> tuple[Array, Array]:
        """Position (n, 3) [m] and orientation (n, 4) x, y, z, w at stamps [ns]."""

    def path_length(self) -> float:
        """Planar distance [m]."""


OnScan = Callable[[str, ScanOdometry], None]
"""Called with the engine's name and each of its results, while the run streams."""


@dataclass(slots=True)
class Track:
    """What one engine made of a run."""

    stamps: list[int] = field(default_factory=list)
    """End of each scan [ns]."""
    poses: list[Array] = field(default_factory=list)
    """(4, 4) each."""
    cpu: list[float] = field(default_factory=list)
    """Thread time per scan [s]."""
    health: list[str] = field(default_factory=list)


class StockKissIcp:
    """KISS-ICP as it comes, constant-velocity deskew and adaptive threshold, no IMU, no joints, one thread.

    Range 20 m and voxels of 0.25 m, which serve it best in small scenes: its defaults (100 m, 1 m) triple the error and
    cost a
    tenth of the time.
    """

    def __init__(self, run: Run) -> None:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        config = KISSConfig()
        config.data.max_range, config.mapping.voxel_size = 20.0, 0.25
        config.registration.max_num_threads = 1
        self._kiss = KissICP(config)
        self._mount = mount_matrix(run.extrinsics)

    def add_scan(self, scan: LidarScan) -> ScanOdometry | None:
        """Pose and cloud at the end of the scan; None where the library would abort."""
        p = scan.points
        if len(p) < 2 or p["time"].min() == p["time"].max():
            return None
        xyz = np.stack([p["x"], p["y"], p["z"]], axis=1).astype(np.float64)
        xyz = xyz @ self._mount[:3, :3].T + self._mount[:3, 3]
        cloud, _ = self._kiss.register_frame(xyz, p["time"].astype(np.float64))
        pose = self._kiss.last_pose
        none = np.zeros(3)
        return ScanOdometry(
            stamp=scan.stamp + round(float(p["time"].max()) * 1e9),
            position=pose[:3, 3].copy(),
            orientation=quaternion(pose[:3, :3]),
            linear=none,
            angular=none,
            covariance=np.zeros((6, 6)),
            health=Health.GOOD,
            reason="",
            overlap=np.nan,
            inliers=np.nan,
            residual=np.nan,
            degenerate=none,
            degeneracy=np.nan,
            correction=np.nan,
            clouds={"main": np.asarray(cloud, np.float32)},
            place_sigma=np.nan,
        )


def take(odometry: LidarInertialOdometry, sample: Sample) -> list[ScanOdometry]:
    """One sample; the scans that it ended. What odometry takes no notice of, such as the truth, is passed over."""
    if isinstance(sample, ImuSample):
        odometry.add_imu(sample)
    elif isinstance(sample, JointSample):
        odometry.add_joints(sample)
    elif isinstance(sample, LidarScan):
        odometry.add_scan(sample)
    return odometry.poll()


def drive(
    run: Run,
    engines: Iterable[str],
    params: OdometryConfig | None = None,
    on_scan: OnScan | None = None,
) -> dict[str, Track]:
    """Stream `run` once through all `engines` (`kiss_icp`, `small_gicp`, `stock`)."""
    params = params or OdometryConfig()
    ours = {
        name: LidarInertialOdometry(params.model_copy(update={"engine": name}), {"main": run.extrinsics})
        for name in engines
        if name in ENGINES
    }
    for odometry in ours.values():
        odometry.warm_up()
    stock = StockKissIcp(run) if "stock" in engines else None
    tracks = {name: Track() for name in engines}

    def finish(name: str, results: list[ScanOdometry], cpu: float) -> None:
        for result in results:
            track = tracks[name]
            track.stamps.append(result.stamp)
            track.poses.append(matrix(result.position, result.orientation))
            track.cpu.append(cpu / len(results))
            track.health.append(str(result.health))
            if on_scan:
                on_scan(name, result)

    spent = dict.fromkeys(engines, 0.0)
    for sample in run.samples():
        if isinstance(sample, GroundTruth) or (isinstance(sample, JointSample) and not params.use_joints):
            continue
        for name, odometry in ours.items():
            start = time.thread_time()
            results = take(odometry, sample)
            if results or isinstance(sample, LidarScan):  # the 200 Hz pose is no part of a scan's cost
                spent[name] += time.thread_time() - start
            if results:
                finish(name, results, spent[name])
                spent[name] = 0.0
        if stock and isinstance(sample, LidarScan):
            start = time.thread_time()
            result = stock.add_scan(sample)
            if result:
                finish("stock", [result], time.thread_time() - start)
    return tracks


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of one track."""

    rpe_mm: float
    """RMS translation error of the motion over 1 s."""
    rpe_deg: float
    drift_pct: float
    """Largest position error of the run, z included, with the first poses aligned: share of the path [%]."""
    cpu_ms: float
    """Median per scan."""


def errors(run: Run, track: Track, window: float = 1.0) -> Errors:
    """Compare a track with the truth of its run."""
    stamps = np.array(track.stamps)
    got = np.array(track.poses)
    position, orientation = run.truth(stamps)
    wanted = np.array([matrix(p, q) for p, q in zip(position, orientation, strict=True)])
    later = np.searchsorted(stamps, stamps + int(window * 1e9) - 1_000_000)
    pairs = [(i, j) for i, j in enumerate(later) if j < len(stamps)]
    moved, turned = [], []
    for i, j in pairs:
        d = np.linalg.inv(np.linalg.inv(wanted[i]) @ wanted[j]) @ np.linalg.inv(got[i]) @ got[j]
        moved.append(np.linalg.norm(d[:3, 3]))
        turned.append(np.linalg.norm(rotation_vector(d[:3, :3])))
    aligned = wanted[0] @ np.linalg.inv(got[0]) @ got
    off = np.linalg.norm(aligned[:, :3, 3] - position, axis=1)
    return Errors(
        rpe_mm=1e3 * float(np.sqrt(np.mean(np.square(moved)))),
        rpe_deg=float(np.degrees(np.sqrt(np.mean(np.square(turned))))),
        drift_pct=100.0 * float(off.max()) / run.path_length(),
        cpu_ms=1e3 * float(np.median(track.cpu)),
    )


def matrix(position: Array, orientation: Array) -> Array:
    """(4, 4) of a position (3,) and an orientation (4,) x, y, z, w."""
    out = np.eye(4)
    out[:3, :3] = rotation(np.ascontiguousarray(orientation))
    out[:3, 3] = position
    return out
