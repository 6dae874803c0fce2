"""Which LiDARs a robot carries: a name for what each is for, its model, its mount."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from hal.lidar.spec import LIDARS, LidarSpec
from hal.types import Extrinsics, LidarName, MountedLidar

Model = Literal["xt16", "vlp16", "mid360", "l1"]


class LidarConfig(BaseModel):
    """One LiDAR of the robot."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: LidarName = Field(
        default="main",
        description="main: registered by the odometry, maps all around; head: sees the ground in front of the feet",
    )
    model: Model = "xt16"
    mount: Extrinsics | None = Field(
        default=None,
        description="pose in base_link [m, rad]; None: where the robot usually carries this model",
    )
    topic: str = Field(
        default="", description="DDS topic of its PointCloud2 (unitree); empty takes the usual one"
    )
    trust_stamps: bool = Field(
        default=True,
        description="false: its clock is of no use, a sweep ended when its message came, whatever that took (unitree)",
    )
    time_offset: float = Field(
        default=0.0, ge=-0.1, le=0.1, description="[s] added to its stamps (unitree; one XT16: -0.005)"
    )

    @property
    def spec(self) -> LidarSpec:
        """Scan pattern and noise."""
        return LIDARS[self.model]

    def mounted(self) -> MountedLidar:
        """Name, model and the mount that holds."""
        return MountedLidar(self.name, self.model, self.mount or self.spec.mount)


def only(model: str, mount: Extrinsics | None = None) -> tuple[LidarConfig, ...]:
    """A robot with one LiDAR. Raises pydantic's ValidationError for a model that does not exist."""
    return (LidarConfig.model_validate({"model": model, "mount": mount}),)
