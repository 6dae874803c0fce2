"""Settings of the Unitree backend."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from hal.lidar.config import LidarConfig
from hal.robots import DEFAULT, Robot, describe
from hal.rotation import rotation_rpy, rpy_of
from hal.types import Capabilities, Extrinsics, MountedLidar
from hal.unitree.motion import Wheels

_TOPICS = {"l1": "rt/utlidar/cloud", "xt16": "rt/lidar_points", "mid360": "rt/livox/lidar"}


class UnitreeConfig(BaseModel):
    """Settings to reach and drive a real Go2-W or Go2 and the LiDARs it carries. Times in seconds."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    domain: int | None = Field(
        default=None, ge=0, le=232, description="DDS domain; null: 0 on the robot's network, 1 on loopback"
    )
    level: Literal["sport", "low"] = Field(
        default="sport",
        description="who balances: the robot's own sport service, or the stack's `controller` at the motors",
    )
    tried: tuple[str, ...] = Field(
        default=(),
        description="level low: controllers that were tried on this robot with its wheels off the ground; "
        "any other one gets "
        "a third of the torque and 0.2 m/s",
    )
    law_age: float = Field(
        default=0.001,
        ge=0.0005,
        le=0.02,
        description="[s] level low: age of the speed by which a motor damps, which bounds its damping; in the vendor's "
        "simulator two steps and a command's way, 0.012",
    )
    imu: Literal["lowstate", "l1"] = Field(default="lowstate", description="which IMU feeds odometry")
    imu_yaw: float = Field(
        default=0.0,
        ge=-3.15,
        le=3.15,
        description="[rad] yaw of the LowState IMU in base_link (some units: pi/2)",
    )
    check_crc: bool = Field(
        default=True, description="LowState whose checksum is wrong is not believed; one without (0) is"
    )
    l1_yaw: float = Field(
        default=0.0,
        ge=-3.15,
        le=3.15,
        description="[rad] of the L1 about its own z axis, which gravity cannot see",
    )
    l1_gyro_leak: tuple[float, float] = Field(
        default=(0.0, 0.0), description="share of its z rate that the L1's gyro shows in x and in y"
    )
    l1_imu_wxyz: bool = Field(default=True, description="the L1 stores its quaternion w, x, y, z")
    max_vx: float = Field(default=0.8, ge=0.1, le=1.5, description="[m/s]")
    max_wz: float = Field(default=1.0, ge=0.2, le=2.0, description="[rad/s]")
    move_rate: float = Field(default=50.0, ge=20, le=50, description="[Hz] Move is repeated at")
    watchdog: float = Field(
        default=0.2, ge=0.05, le=0.5, description="without a drive call for this long the robot stops"
    )
    state_timeout: float = Field(
        default=0.2, ge=0.05, le=0.5, description="without LowState for this long: disconnected"
    )
    sport_timeout: float = Field(
        default=1.0, ge=0.1, le=2.0, description="without sportmodestate for this long: fault"
    )
    connect_timeout: float = Field(default=10.0, ge=0.5, le=120.0, description="for discovery")
    rpc_timeout: float = Field(default=1.0, ge=0.1, le=3.0, description="per request, then it is repeated")
    rpc_tries: int = Field(default=3, ge=1, le=10, description="requests before a service counts as silent")
    busy_timeout: float = Field(
        default=15.0, ge=1.0, le=60.0, description="for a mode switcher that answers busy"
    )
    stand_timeout: float = Field(default=8.0, ge=1.0, le=30.0, description="for standing up or lying down")
    ignored_timeout: float = Field(
        default=12.0, ge=5.0, le=20.0, description="for Move without motion: fault; 4-10 s are normal"
    )
    state_codes: dict[int, Literal["damped", "sitting", "standing", "ready"]] = Field(
        default={1001: "damped", 1002: "standing"},
        description="sportmodestate's error_code -> posture, on firmware that tells it there; other codes "
        "leave it to mode and body_height",
    )
    motion_mode: str = Field(default="ai-w", description="motion service selected when none is active")
    avoid_obstacles: bool = Field(
        default=False, description="drive through the robot's obstacle avoidance service"
    )
    sit_on_close: bool = Field(default=True, description="lie down when the backend closes")
    lidars: tuple[LidarConfig, ...] = Field(
        default_factory=lambda: describe().lidars,
        exclude=True,
        description="the stack's own `lidars`; set there, not here",
    )

    robot_model: str = Field(
        default=DEFAULT, exclude=True, description="the stack's own `robot_model`; set there, not here"
    )

    @property
    def robot(self) -> Robot:
        """What it drives."""
        return describe(self.robot_model)

    @property
    def wheels(self) -> Wheels | None:
        """What it rolls on; None on feet."""
        limbs = self.robot.limbs
        return Wheels(limbs.radius, limbs.tread) if self.robot.wheeled else None

    def dds_domain(self, interface: str) -> int:
        """DDS domain of the robot behind a network interface."""
        return self.domain if self.domain is not None else 1 if interface == "lo" else 0

    def topic(self, lidar: LidarConfig) -> str:
        """DDS topic of its clouds."""
        return lidar.topic or _TOPICS[lidar.model]

    @property
    def carries_l1(self) -> bool:
        """Whether an L1, which has an IMU of its own, is among the LiDARs."""
        return any(lidar.model == "l1" for lidar in self.lidars)

    def mounted(self) -> tuple[MountedLidar, ...]:
        """The LiDARs in base_link."""
        return tuple(self._mounted(lidar) for lidar in self.lidars)

    def _mounted(self, lidar: LidarConfig) -> MountedLidar:
        (lidar,) = self.robot.mounted((lidar,))
        mounted = lidar.mounted()
        if lidar.model != "l1" or self.l1_yaw == 0.0:
            return mounted
        turned = rotation_rpy(*mounted.mount.rpy) @ rotation_rpy(0.0, 0.0, self.l1_yaw)
        return replace(mounted, mount=Extrinsics(mounted.mount.translation, rpy_of(turned)))

    def capabilities(self, controller: str = "") -> Capabilities:
        """The robot's limits with these settings: at level low those of the stack's `controller` in simulation, else
        those of the vendor's gaits, which nobody measured.
        """
        controller = (controller or self.robot.usual) if self.level == "low" else "sport"
        return replace(
            self.robot.capabilities(controller),
            name=f"unitree-{self.robot.name}" + (f"-{controller}" if self.level == "low" else ""),
            max_vx=self.max_vx,
            max_vy=0.0,
            strafe=False,
            max_wz=self.max_wz,
            max_accel=0.8,
            max_alpha=2.5,
            lidars=self.mounted(),
        )
