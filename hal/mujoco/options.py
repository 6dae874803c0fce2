"""What can be set about the simulated robot besides its scene."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from hal.types import Capabilities, Extrinsics

CAPABILITIES = {
    "vmc": Capabilities(
        "go2w-mujoco-vmc", max_vx=1.0, max_wz=1.0, max_step=0.10, max_slope=math.radians(25.0), max_gap=0.10
    ),
    "policy": Capabilities(
        "go2w-mujoco-policy",
        max_vx=1.0,
        max_vy=0.5,
        max_wz=1.0,
        max_step=0.25,
        max_slope=math.radians(30.0),
        max_gap=0.12,
        strafe=True,
    ),
}
"""What the simulated robot can do, per controller."""

_CHECKED = ConfigDict(extra="forbid")
Delay = Annotated[float, Field(ge=0.0, le=1.0)]
"""[s]"""


@dataclass(frozen=True, slots=True, config=_CHECKED)
class Push:
    """A shove on the trunk."""

    time: float
    """[s] after connect."""
    force: tuple[float, float, float]
    """[N], world axes."""
    duration: float = 0.2
    """[s]"""


@dataclass(frozen=True, slots=True, config=_CHECKED)
class Obstacle:
    """A box that is not part of the terrain: solid, seen by the LiDAR, may come, move and go."""

    centre: tuple[float, float, float]
    """[m], world, at `appear`."""
    size: tuple[float, float, float]
    """Full lengths [m]."""
    yaw: float = 0.0
    appear: float = 0.0
    """[s] after connect."""
    disappear: float = float("inf")
    """[s] after connect."""
    velocity: tuple[float, float] = (0.0, 0.0)
    """x, y [m/s], world."""


@dataclass(frozen=True, slots=True, config=_CHECKED)
class SimOptions:
    """Defaults give the plain robot with sensor noise and no faults. Raises pydantic's ValidationError on bad values."""

    controller: Literal["vmc", "policy"] = "vmc"
    policy_dir: str | None = None
    """Folder of a policy in rl_sar's layout; needed with `controller="policy"`."""
    lidar: str | None = "xt16"
    """A name in `hal.lidar.spec.LIDARS`, or None for no LiDAR (physics only, faster)."""
    lidar_mount: Extrinsics | None = None
    """None: the model's usual mount."""
    lidar_step: Annotated[int, Field(ge=1)] = 1
    """Keep every n-th firing."""
    caster: Literal["embree", "numba"] = "embree"
    """Ray caster; embree falls back to numba where open3d does not load."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of everything random here."""
    timestep: Annotated[float, Field(gt=0.0, le=0.01)] = 0.005
    """Physics step [s]."""
    start: tuple[float, float, float] | None = None
    """x, y [m], yaw [rad]; None: the scene's start."""
    seated: bool = False
    """Start lying on the ground and wait for STAND; else take the stance on connect."""
    start_time: int = 0
    """Source clock at connect [ns]."""
    friction: Annotated[float, Field(gt=0.0)] | None = None
    """Sliding friction of the wheels; None: the scene's."""
    friction_spread: Annotated[float, Field(ge=0.0)] = 0.0
    """The friction is drawn uniformly within +- this, once per seed."""
    payload: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    """[kg] on top of the trunk."""
    noise: bool = True
    """Sensor errors: IMU, joints, attitude, LiDAR."""
    command_delay: Delay = 0.0
    """[s] from the controller to the motors."""
    imu_delay: Delay = 0.0
    """[s] from measurement to delivery."""
    joint_delay: Delay = 0.0
    lidar_delay: Delay = 0.0
    """[s] from the end of a sweep to delivery."""
    battery: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    """State of charge at connect [0..1]; drains in two hours."""
    pushes: tuple[Push, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
