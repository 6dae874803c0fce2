"""Settings of the Unitree backend."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from hal.lidar.spec import LIDARS
from hal.rotation import rotation_rpy, rpy_of
from hal.types import Capabilities, Extrinsics

_TOPICS = {"l1": "rt/utlidar/cloud", "xt16": "rt/lidar_points", "mid360": "rt/livox/lidar"}


class UnitreeSettings(BaseModel):
    """How to reach and treat a real Go2-W; which LiDAR it carries stands elsewhere. Times in seconds."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    domain: int | None = Field(
        default=None, ge=0, le=232, description="DDS domain; null: 0 on the robot's network, 1 on loopback"
    )
    lidar_topic: str = Field(
        default="", description="DDS topic of the LiDAR's PointCloud2; empty takes the usual one"
    )
    imu: Literal["lowstate", "l1"] = Field(default="lowstate", description="which IMU feeds odometry")
    imu_yaw: float = Field(
        default=0.0, description="[rad] yaw of the LowState IMU in base_link (some units: pi/2)"
    )
    check_crc: bool = Field(
        default=True, description="LowState whose checksum is wrong is not believed; one without (0) is"
    )
    lidar_time_offset: float = Field(
        default=0.0, ge=-0.1, le=0.1, description="[s] added to the LiDAR's stamps (one XT16: -0.005)"
    )
    l1_yaw: float = Field(
        default=0.0, description="[rad] of the L1 about its own z axis, which gravity cannot see"
    )
    l1_gyro_leak: tuple[float, float] = Field(
        default=(0.0, 0.0), description="share of its z rate that the L1's gyro shows in x and in y"
    )
    l1_imu_wxyz: bool = Field(default=True, description="the L1 stores its quaternion w, x, y, z")
    max_vx: float = Field(default=0.8, gt=0, le=3.0, description="[m/s]")
    max_wz: float = Field(default=1.0, gt=0, le=3.0, description="[rad/s]")
    move_rate: float = Field(default=50.0, ge=20, le=50, description="[Hz] Move is repeated at")
    watchdog: float = Field(
        default=0.2, gt=0, le=0.5, description="without a drive call for this long the robot stops"
    )
    state_timeout: float = Field(
        default=0.2, gt=0, description="without LowState for this long: disconnected"
    )
    sport_timeout: float = Field(default=1.0, gt=0, description="without sportmodestate for this long: fault")
    connect_timeout: float = Field(default=10.0, gt=0, description="for discovery")
    rpc_timeout: float = Field(default=1.0, gt=0, description="per request, then it is repeated")
    rpc_tries: int = Field(default=3, ge=1, description="requests before a service counts as silent")
    busy_timeout: float = Field(default=15.0, gt=0, description="for a mode switcher that answers busy")
    stand_timeout: float = Field(default=8.0, gt=0, description="for standing up or lying down")
    ignored_timeout: float = Field(
        default=12.0, gt=0, description="for Move without motion: fault; 4-10 s are normal"
    )
    motion_mode: str = Field(default="ai-w", description="motion service selected when none is active")
    avoid_obstacles: bool = Field(
        default=False, description="drive through the robot's obstacle avoidance service"
    )
    sit_on_close: bool = Field(default=True, description="lie down when the backend closes")


class UnitreeOptions(UnitreeSettings):
    """All of it."""

    lidar: Literal["l1", "xt16", "mid360", "none"] = Field(
        default="xt16", description="which LiDAR is mounted"
    )
    lidar_mount: tuple[float, float, float, float, float, float] | None = Field(
        default=None,
        description="x, y, z [m], roll, pitch, yaw [rad] of the LiDAR in base_link; null: the usual mount",
    )

    def topic(self) -> str | None:
        """DDS topic of the LiDAR, or None without one."""
        return None if self.lidar == "none" else self.lidar_topic or _TOPICS[self.lidar]

    def mount(self) -> Extrinsics:
        """LiDAR in base_link."""
        mount = LIDARS[self.lidar].mount if self.lidar in LIDARS else Extrinsics((0.0, 0.0, 0.0))
        if self.lidar_mount is not None:
            x, y, z, roll, pitch, yaw = self.lidar_mount
            mount = Extrinsics((x, y, z), (roll, pitch, yaw))
        if self.lidar == "l1" and self.l1_yaw != 0.0:
            mount = Extrinsics(
                mount.translation, rpy_of(rotation_rpy(*mount.rpy) @ rotation_rpy(0.0, 0.0, self.l1_yaw))
            )
        return mount

    def capabilities(self) -> Capabilities:
        """What the robot may be asked for with these settings: the vendor's own gaits, held well below their limits."""
        return Capabilities(
            "unitree-go2w",
            max_vx=self.max_vx,
            max_wz=self.max_wz,
            max_accel=0.8,
            max_alpha=2.5,
            max_step=0.15,
            max_slope=math.radians(25.0),
            max_gap=0.10,
            lidar=self.lidar,
            lidar_mount=self.mount(),
        )
