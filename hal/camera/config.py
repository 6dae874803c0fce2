"""The camera that a robot carries, and where its frames come from."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from hal.camera.camera import MountedCamera
from hal.types import Extrinsics

FRONT_MOUNT = Extrinsics((0.327, 0.0, 0.043))
"""In the head of a trunk of 0.4 m, level and straight ahead, where the robot's description says no other place."""


class CameraConfig(BaseModel):
    """One camera."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    source: str = Field(
        "robot",
        pattern=r"^(off|robot|(rtsps?|https?|file|v4l2):.+)$",
        description="robot: the simulator's, or the one in the robot's head; off: none; rtsp://..., http://..., "
        "v4l2:/dev/videoN: another one (extra `camera`)",
    )
    name: Literal["front"] = Field("front", description="of the camera: in topics and frames")
    mount: Extrinsics = Field(FRONT_MOUNT, description="in base_link [m, rad], x along the view")
    width: int = Field(320, ge=64, le=1920, description="of a simulated picture [pixels]")
    height: int = Field(240, ge=48, le=1080, description="of a simulated picture [pixels]")
    fov: float = Field(
        math.radians(100.0),
        gt=0.2,
        lt=2.8,
        description="horizontal field of view [rad]",
    )
    rate: float = Field(5.0, gt=0.0, le=30.0, description="most frames a second [Hz]")
    always: bool | None = Field(
        None, description="frames also while nobody looks; null: where they cost less than a fifth of a core"
    )

    def mounted(self) -> MountedCamera | None:
        """The camera; None where there is none."""
        if self.source == "off":
            return None
        return MountedCamera(self.name, self.mount, self.width, self.height, self.fov, self.rate)
