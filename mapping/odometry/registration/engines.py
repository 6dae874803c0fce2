"""Registration engines behind one small interface: point to plane and small_gicp's VGICP, both scan to local map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from hal.rotation import rotation, turn
from hal.types import Array
from mapping.odometry.registration.observability import observed
from mapping.odometry.registration.planes import VoxelPlanes
from mapping.odometry.registration.voxels import voxel_down_sample

if TYPE_CHECKING:
    import small_gicp

EngineName = Literal["kiss_icp", "small_gicp"]
ENGINES: tuple[EngineName, ...] = get_args(EngineName)
MOST_STEPS = 12
"""Most point to plane steps of a scan."""
CONVERGED_STEP = 1e-4
"""Smallest step [m, rad] that is followed by another."""
VGICP_REACH = 0.6
"""Reach of correspondences of small_gicp [m]."""
MAP_VOXEL, PLANE_GATE, PLANE_SCALE = 0.4, 0.15, 0.05
"""Voxels of the planes that a scan is compared with, and how near to one a point is on it and counts fully [m]."""
FEW_PLANES = 50
"""Points on planes below which their statistics say nothing."""


@dataclass(frozen=True, slots=True)
class Match:
    """What registration says about one scan."""

    pose: Array
    """(4, 4) `odom` <- base_link."""
    points: int
    """Points registered."""
    overlap: float
    """Share of them that fall into seen parts of the local map [0..1]."""
    on_planes: int
    """Points in voxels of the map that have a plane."""
    inliers: float
    """Share of the points in voxels with a plane that lie on it (within the gate) [0..1]; 1 if the map has too few
    planes to tell."""
    residual: float
    """RMS distance of the inliers from the map's surfaces [m]."""
    information: Array
    """(6, 6) mean of J^T J over inliers: position in `odom` [-], rotation about base_link in `odom` axes [m^2].
    Singular where the scene does not constrain."""
    born: float = 0.0
    """Variance [m^2] of the place in the plane when the surfaces that constrain it were first seen."""


class Engine(Protocol):
    """Scan-to-map registration with a local map of its own. One thread, deterministic."""

    name: EngineName
    scans: int
    """Scans in the local map."""
    sigma: float
    """Systematic error of a registered surface [m]."""
    frame: Array
    """(n, 3) base_link: the cloud of the last `take`, thinned."""
    planes: VoxelPlanes
    """Of the local map."""

    def take(self, cloud: NDArray[np.float32], beside: Sequence[NDArray[np.float32]] = ()) -> None:
        """The deskewed cloud (n, 3) in base_link to register next, with the clouds of other LiDARs at the same time,
        each (m, 3). Only `cloud` enters the local map."""

    def align(self, guess: Array) -> Match:
        """Register the cloud near `guess` (4, 4)."""

    def insert(self, pose: Array, born: float = 0.0, settled: bool = False) -> None:
        """Add the cloud to the local map at `pose` (4, 4), see `VoxelPlanes.insert`."""


class PlanesConfig(BaseModel):
    """Point to plane registration, the tracker of the engine `kiss_icp`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    map_voxel: float = Field(
        default=0.15, gt=0.02, le=2.0, description="one point per voxel goes into the map [m]"
    )
    source_voxel: float = Field(
        default=0.5, gt=0.02, le=2.0, description="one point per voxel is registered [m]"
    )
    min_source: int = Field(default=1500, ge=0, description="with fewer points the source voxel is halved")
    surface_sigma: float = Field(
        default=0.008, gt=0, description="systematic error of a registered surface [m]"
    )


class GicpConfig(BaseModel):
    """small_gicp VGICP."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    voxel_size: float = Field(default=0.4, gt=0.05, le=2.0, description="Gaussian voxels of the map [m]")
    source_voxel: float = Field(
        default=0.15, gt=0.02, le=2.0, description="one point per voxel is registered [m]"
    )
    neighbours: int = Field(default=10, ge=5, description="points behind each covariance")
    surface_sigma: float = Field(
        default=0.004, gt=0, description="systematic error of a registered surface [m]"
    )
    max_iterations: int = Field(default=20, ge=1, description="least-squares steps per scan")
    horizon: int = Field(
        default=600, ge=10, description="scans after which an unseen voxel of the map is forgotten"
    )


class PlaneEngine:
    """Point to plane: Gauss-Newton steps from the prediction onto the planes of the map."""

    name: EngineName = "kiss_icp"

    def __init__(self, params: PlanesConfig, max_range: float) -> None:
        self._params = params
        self.sigma = params.surface_sigma
        self.planes = VoxelPlanes(MAP_VOXEL, max_range)
        self.frame = self._source = np.empty((0, 3))
        self.scans = 0

    def take(self, cloud: NDArray[np.float32], beside: Sequence[NDArray[np.float32]] = ()) -> None:
        """See Engine."""
        finest = self._params.map_voxel
        self.frame = voxel_down_sample(cloud, finest)
        seen = np.concatenate([self.frame, *(voxel_down_sample(other, finest) for other in beside)])
        size = self._params.source_voxel
        self._source = voxel_down_sample(seen, size)
        while len(self._source) < self._params.min_source and size > finest:
            size *= 0.5  # open terrain: few returns, all of them needed
            self._source = voxel_down_sample(seen, size)

    def align(self, guess: Array) -> Match:
        """See Engine."""
        pose = _refine(self.planes, self._source, guess) if self.scans else guess
        return quality(self.planes, self._source, np.ascontiguousarray(pose))

    def insert(self, pose: Array, born: float = 0.0, settled: bool = False) -> None:
        """See Engine."""
        self.planes.insert(self.frame, np.ascontiguousarray(pose), born, settled)
        self.scans += 1


class GicpEngine:
    """small_gicp: distribution to distribution, plane-aware by construction."""

    name: EngineName = "small_gicp"

    def __init__(self, params: GicpConfig, max_range: float) -> None:
        import small_gicp

        self._params = params
        self.sigma = params.surface_sigma
        self._max_range = max_range
        self.planes = VoxelPlanes(MAP_VOXEL, max_range)
        self._map = small_gicp.GaussianVoxelMap(params.voxel_size)
        self._map.set_lru(horizon=params.horizon, clear_cycle=10)
        self.frame = self._points = np.empty((0, 3))
        self.scans = 0

    def take(self, cloud: NDArray[np.float32], beside: Sequence[NDArray[np.float32]] = ()) -> None:
        """See Engine."""
        self._cloud = self._source = self._thinned(cloud)
        self.frame = self._points = np.ascontiguousarray(self._cloud.points()[:, :3])
        if len(beside):
            self._source = self._thinned(np.concatenate([cloud, *beside]))
            self._points = np.ascontiguousarray(self._source.points()[:, :3])

    def _thinned(self, cloud: NDArray[np.float32]) -> small_gicp.PointCloud:
        import small_gicp

        p = self._params
        return small_gicp.preprocess_points(
            cloud.astype(np.float64), p.source_voxel, num_neighbors=p.neighbours, num_threads=1
        )[0]

    def align(self, guess: Array) -> Match:
        """See Engine."""
        import small_gicp

        pose = guess
        if self.scans:
            result = small_gicp.align(
                self._map,
                self._source,
                guess,
                max_correspondence_distance=VGICP_REACH,
                num_threads=1,
                max_iterations=self._params.max_iterations,
            )
            pose = np.ascontiguousarray(result.T_target_source)
        return quality(self.planes, self._points, pose)

    def insert(self, pose: Array, born: float = 0.0, settled: bool = False) -> None:
        """See Engine."""
        self._map.insert(self._cloud, pose)
        self.planes.insert(self.frame, np.ascontiguousarray(pose), born, settled)
        self.scans += 1


def _refine(planes: VoxelPlanes, points: Array, pose: Array) -> Array:
    """Point to plane steps from `pose` (4, 4). Directions that are not observed stay as they are."""
    pose = np.ascontiguousarray(pose)
    for _ in range(MOST_STEPS):
        h, b, _, _, inliers, *_ = planes.fit(points, pose, gate=PLANE_GATE, scale=PLANE_SCALE)
        if inliers < FEW_PLANES:
            break
        step = observed(h / inliers).step(b / inliers)
        largest = np.abs(step).max()
        if not largest < 0.2:
            break
        moved = np.eye(4)
        turned = np.array([0.0, 0.0, 0.0, 1.0])
        turn(turned, *step[3:])
        moved[:3, :3] = rotation(turned) @ pose[:3, :3]
        moved[:3, 3] = pose[:3, 3] + step[:3]
        pose = moved
        if largest < CONVERGED_STEP:
            break
    return pose


def quality(planes: VoxelPlanes, points: Array, pose: Array) -> Match:
    """Fit of `points` (n, 3), body frame, at `pose` to the planes of the map."""
    h, _, seen, planar, inliers, total, born = planes.fit(points, pose, gate=PLANE_GATE, scale=PLANE_SCALE)
    return Match(
        pose=pose,
        points=len(points),
        overlap=seen / max(len(points), 1),
        on_planes=planar,
        inliers=inliers / planar if planar >= FEW_PLANES else 1.0,
        residual=float(np.sqrt(total / max(inliers, 1))),
        information=h / max(inliers, FEW_PLANES),
        born=born,
    )


def make_engine(name: EngineName, planes: PlanesConfig, gicp: GicpConfig, max_range: float) -> Engine:
    """The engine of that name; `max_range` of the points [m]."""
    return PlaneEngine(planes, max_range) if name == "kiss_icp" else GicpEngine(gicp, max_range)
