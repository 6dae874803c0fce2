"""Settings, inputs and outputs of the odometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from hal.types import Array, LidarName
from mapping.odometry.calibration import LidarFit
from mapping.odometry.health import Health, HealthConfig
from mapping.odometry.inertial import InertialConfig
from mapping.odometry.registration.engines import EngineName, GicpConfig, PlanesConfig
from mapping.odometry.registration.witness import KissConfig


class OdometryConfig(BaseModel):
    """The whole odometry."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    engine: EngineName = Field(
        default="kiss_icp",
        description="registration: kiss_icp (point to plane, KISS-ICP as witness) or small_gicp (VGICP)",
    )
    planes: PlanesConfig = PlanesConfig()
    kiss_icp: KissConfig = KissConfig()
    small_gicp: GicpConfig = GicpConfig()
    inertial: InertialConfig = InertialConfig()
    health: HealthConfig = HealthConfig()
    min_range: float = Field(default=0.4, ge=0, description="nearer points are dropped [m]")
    max_range: float = Field(
        default=20.0, gt=1, description="farther points are dropped; radius of the local map [m]"
    )
    max_points: int = Field(default=60_000, ge=1000, description="a larger scan is thinned")
    tilt_sigma: float = Field(
        default=1.0, ge=0, description="standard deviation of the local map's roll and pitch, per scan [deg]"
    )
    patience: float = Field(
        default=0.15, gt=0, description="longest wait for a topic that is behind the others [s]"
    )
    max_time_offset: float = Field(
        default=0.05,
        ge=0.0,
        le=0.1,
        description="largest offset LiDAR - IMU that is corrected [s]; beyond it is a fault",
    )
    use_joints: bool = Field(default=True, description="wait for and use joint samples")
    without: Literal["", "imu", "lidar"] = Field(
        default="",
        description="sensor that a log lacks: imu (KISS-ICP alone) or lidar (wheels and IMU alone)",
    )
    smoothing: float = Field(
        default=0.15, gt=0, description="time constant that hides scan corrections from control [s]"
    )


@dataclass(frozen=True, slots=True, eq=False)
class ScanOdometry:
    """The pose at the end of one scan."""

    stamp: int
    """END of the scan [ns]."""
    position: Array
    """(3,) base_link in `odom` [m]."""
    orientation: Array
    """(4,) x, y, z, w: `odom` <- base_link."""
    linear: Array
    """(3,) [m/s], base_link."""
    angular: Array
    """(3,) [rad/s], base_link."""
    covariance: Array
    """(6, 6) of the pose relative to the local map: position [m], rotation [rad], axes of `odom`."""
    health: Health
    reason: str
    """Plain words; empty when good."""
    overlap: float
    """Share of the scan in seen parts of the local map [0..1]."""
    inliers: float
    """Share of the scan on the map's surfaces [0..1]."""
    residual: float
    """RMS distance of the inliers from the map's surfaces [m]."""
    degenerate: Array
    """(3,) least constrained direction, `odom`."""
    degeneracy: float
    """Share of surface that faces it [0..1/3]."""
    correction: float
    """Distance by which registration moved the prediction [m]."""
    clouds: Mapping[LidarName, NDArray[np.float32]]
    """(n, 3) [m] of each LiDAR that gave one, deskewed to `stamp`, base_link; none if the registration was refused."""
    place_sigma: float
    """Standard deviation of x and y in `odom` [m] since the start, not relative to the local map."""
    lidars: tuple[LidarFit, ...] = ()
    """Clock of each LiDAR, as found."""
    fault: str = ""
    """What the operator must mend of them, in plain words; empty when all is well."""

    @property
    def cloud(self) -> NDArray[np.float32]:
        """That of the main LiDAR; empty where its scan was not usable."""
        return self.clouds.get("main", np.empty((0, 3), np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class FastPose:
    """IMU-propagated pose for control: continuous, scan corrections are faded in."""

    stamp: int
    position: Array
    """(3,) base_link in `odom` [m]."""
    orientation: Array
    """(4,) x, y, z, w."""
    linear: Array
    """(3,) [m/s], base_link."""
    angular: Array
    """(3,) [rad/s], base_link."""
    covariance: Array
    """(6, 6) position [m], rotation [rad], axes of `odom`."""
    health: Health
    """Of the newest scan, or worse when it is old."""
    reason: str
