"""Settings of the simulated robot besides its scene, its controller and its LiDARs."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field
from pydantic.dataclasses import dataclass

_CHECKED = ConfigDict(extra="forbid")


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
    """A box that is not part of the terrain: solid, may come, move and go."""

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
    clear: bool = False
    """No ray comes back from it, as from glass, a thin post, or a bar between the beams."""


@dataclass(frozen=True, slots=True, config=_CHECKED)
class Part:
    """A box mounted on the robot, an antenna or a bag: LiDAR rays hit it. It has no mass and touches nothing."""

    centre: tuple[float, float, float]
    """[m], base_link."""
    size: tuple[float, float, float]
    """Full lengths [m]."""


class SimConfig(BaseModel):
    """The simulated robot. The defaults give a plain one with sensor noise and no faults."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    lidar_step: int = Field(1, ge=1, description="keep every n-th firing of the main LiDAR")
    timestep: float = Field(0.005, gt=0.0, le=0.01, description="physics step [s]")
    seated: bool = Field(
        False, description="start lying and wait for `posture stand`; else take the stance at the start"
    )
    friction: float | None = Field(
        None, gt=0.0, description="sliding friction of the wheels; null: the scene's"
    )
    friction_spread: float = Field(
        0.0, ge=0.0, description="the friction is drawn uniformly within +- this, once per seed"
    )
    payload: float = Field(0.0, ge=0.0, le=20.0, description="on top of the trunk [kg]")
    noise: bool = Field(True, description="sensor errors: IMU, joints, attitude, LiDAR")
    command_delay: float = Field(0.0, ge=0.0, le=1.0, description="from the controller to the motors [s]")
    imu_delay: float = Field(0.0, ge=0.0, le=1.0, description="from measurement to delivery [s]")
    joint_delay: float = Field(0.0, ge=0.0, le=1.0, description="from measurement to delivery [s]")
    lidar_delay: float = Field(0.0, ge=0.0, le=1.0, description="from the end of a sweep to delivery [s]")
    battery: float = Field(1.0, ge=0.0, le=1.0, description="state of charge at the start [0..1]")
    battery_life: float = Field(7200.0, gt=0.0, description="from a full battery to an empty one [s]")
    pushes: tuple[Push, ...] = Field((), description="shoves on the trunk")
    people: int = Field(
        0, ge=0, le=20, description="people who walk past the robot, and step aside for it; level ground"
    )
    obstacles: tuple[Obstacle, ...] = Field((), description="boxes that come, move and go")
    parts: tuple[Part, ...] = Field((), description="boxes mounted on the robot that the LiDARs see")
