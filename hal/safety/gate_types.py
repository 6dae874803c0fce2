"""Inputs and outputs of the safety gate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field

from hal.types import RobotState

# Bounds: from below a few periods of what is watched, or it would trip on a healthy robot; from above what the robot
# may do meanwhile at 1 m/s: half a metre on a dead command, guard, IMU or joints, a body length beyond what it saw on
# a dead LiDAR, whose sweeps the guard dates itself.


class SensorTimeouts(BaseModel):
    """Oldest accepted sample [s] by sensor. Every sensor here must be alive: none can be left out, and every limit
    has an upper bound."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    state: float = Field(default=0.5, ge=0.1, le=1.0, description="[s] summary state of the robot")
    imu: float = Field(default=0.2, ge=0.05, le=0.5, description="[s]")
    joints: float = Field(default=0.3, ge=0.05, le=0.5, description="[s]")
    lidar: float = Field(default=1.0, ge=0.2, le=1.5, description="[s]")


class GateConfig(BaseModel):
    """Thresholds of the safety gate. The velocity and acceleration limits are the robot's `Capabilities`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    deadman: float = Field(
        default=0.2, ge=0.06, le=0.5, description="[s] age of a command at which velocity is zero"
    )
    deadman_ramp: float = Field(
        default=0.08, ge=0.0, le=0.5, description="[s] before that, the velocity ramps down"
    )
    future: float = Field(default=0.05, ge=0.0, le=0.2, description="[s] a stamp may lie ahead of the clock")
    max_tilt: float = Field(
        default=0.70, ge=0.35, le=1.2, description="[rad] between trunk and gravity; latches"
    )
    min_battery: float = Field(default=0.10, ge=0.05, le=0.9, description="state of charge [0..1]; latches")
    max_motor_temperature: float = Field(default=90.0, ge=50.0, le=120.0, description="[deg C]; latches")
    sensor_timeout: SensorTimeouts = SensorTimeouts()
    guard_timeout: float = Field(
        default=0.3, ge=0.1, le=0.5, description="[s] a guard silent for longer means zero velocity"
    )
    not_moving_warn: float = Field(
        default=1.0, ge=0.2, le=10.0, description="[s] commanded but not moving: flagged"
    )
    not_moving_stop: float = Field(
        default=12.0, ge=2.0, le=30.0, description="[s] the same, latches; longer than a recovery"
    )
    moving_stop: float = Field(
        default=0.5,
        ge=0.2,
        le=1.0,
        description="[s] over which motion that was not commanded is averaged; latches",
    )
    moving_speed: float = Field(
        default=0.05,
        ge=0.03,
        le=0.1,
        description="[m/s] the mean counts as moving; yaw rates double, in rad/s",
    )
    braking_time: float = Field(
        default=1.0, ge=0.3, le=2.0, description="[s] in which a moving robot comes to rest"
    )
    fence_margin: float = Field(
        default=0.5 * math.hypot(0.70, 0.43),
        ge=0.2,
        le=2.0,
        description="[m] from base_link to what must stay inside, along the motion",
    )
    fence_horizon: float = Field(
        default=0.8, ge=0.5, le=3.0, description="[s] of motion that must stay inside the geofence"
    )


class RefusalReason(StrEnum):
    """Why a command was not accepted."""

    NOT_FINITE = "not finite"
    WRONG_FRAME = "wrong frame"
    OVER_LIMIT = "over limit"
    FROM_FUTURE = "from the future"
    TOO_OLD = "too old"
    OUT_OF_ORDER = "out of order"
    LATCHED = "stopped until resume"
    NOT_STANDING = "not standing still"
    OLD_HANDS = "old hands"
    BLIND_HANDS = "blind hands"


class StopCause(StrEnum):
    """Causes that latch the gate."""

    OPERATOR = "emergency stop"
    TILT = "tilt"
    BATTERY = "battery low"
    MOTOR_TEMPERATURE = "motor too hot"
    ROBOT_FAULT = "robot fault"
    NOT_MOVING = "commanded but not moving"
    MOVING = "moving but not commanded"
    REMOTE = "the operator's remote drives"


@dataclass(frozen=True, slots=True)
class Refusal:
    """A command that was not accepted."""

    reason: RefusalReason
    detail: str


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Speeds from which the body still stops before an obstacle; from a guard that sees the ground around it."""

    stamp: int
    forward: float = 0.0
    backward: float = 0.0
    """[m/s], not negative."""
    left: float = 0.0
    right: float = 0.0
    """[rad/s], not negative."""
    reason: str = ""
    """The obstacle; empty without one."""
    uneven_ahead: float = 0.0
    uneven_behind: float = 0.0
    """[m] how far the map's ground lies off the plane that the robot stands on; see `hal.safety.touch`."""
    near_body: bool = False
    """The map's ground comes up to the trunk or to a shank: it may be what pushes at them."""

    def least(self, other: MotionLimits) -> MotionLimits:
        """What both allow, as old as the older one."""
        return MotionLimits(
            min(self.stamp, other.stamp),
            min(self.forward, other.forward),
            min(self.backward, other.backward),
            min(self.left, other.left),
            min(self.right, other.right),
            self.reason or other.reason,
            min(self.uneven_ahead, other.uneven_ahead),
            min(self.uneven_behind, other.uneven_behind),
            self.near_body and other.near_body,
        )


@dataclass(frozen=True, slots=True)
class GateInputs:
    """State of the robot at an instant, as the gate knows it. None: not known, which holds the robot where it
    matters."""

    state: RobotState | None = None
    tilt: float | None = None
    """Angle between the trunk's z axis and gravity [rad], see `hal.safety.tilt.TiltFilter`."""
    velocity: tuple[float, float, float] | None = None
    """Measured vx, vy [m/s], wz [rad/s] in base_link, by odometry; None: nobody sees whether a command is followed."""
    wheels: tuple[float, float] | None = None
    """Speed of the wheels [m/s] and yaw rate of the gyro [rad/s]: the second witness of uncommanded motion."""
    lean: tuple[float, float] = (0.0, 0.0)
    """x and y of the upward direction in base_link: (0.1, 0) has the nose up by 0.1 rad."""
    pose: tuple[float, float, float] | None = None
    """x, y [m], yaw [rad] in `map`; needed only with a geofence."""
    limits: MotionLimits | None = None
    """Newest of the guard."""
    stamps: Mapping[str, int] = field(default_factory=dict)
    """Newest stamp [ns] by sensor: "imu", "joints", "lidar". "state" is taken from `state`."""


@dataclass(frozen=True, slots=True)
class GateStatus:
    """Snapshot for `status`, the log and the operator."""

    latched: bool
    cause: str
    """Why the gate is latched, in plain words; empty when it is not."""
    hold: str
    """Why the velocity is held at zero although the gate is not latched; empty when it is not."""
    not_moving: bool
    """Commanded but not moving for longer than `not_moving_warn`."""
    motion_unchecked: bool
    """No measured velocity: "commanded but not moving" would not be noticed."""
    creeps: float
    """[m/s] at which it rolls down a slope without a command; 0 where it does not."""
    accepted: int
    refused: dict[str, int]
    """Count by RefusalReason, in the order of the enum; only reasons that occurred."""
    command_age: float | None
    """[s] at the last output; None without an accepted command."""
