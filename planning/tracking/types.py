"""Inputs and outputs of the path tracker."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field

from hal.named import PATTERN

OURS = "line_of_sight"
"""The controller of `PathTracker`."""


class TrackerConfig(BaseModel):
    """Limits and gains of the tracker. Keep the limits below the robot's `Capabilities`: the gate clips silently."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: str = Field(
        default=OURS,
        pattern=PATTERN,
        description="line_of_sight: the project's; an installed controller (entry point of rbtrg.trackers) or "
        "package.module:function (docs/extend.md)",
    )
    max_speed: float = Field(
        default=0.8, gt=0, description="largest speed of base_link, even if the path allows more [m/s]"
    )
    min_speed: float = Field(default=0.12, gt=0, description="[m/s] slowest speed the drive follows reliably")
    step_speed: float = Field(
        default=0.0,
        ge=0,
        description="[m/s] that comes over faces: a base that stalls is driven so fast; 0: any does",
    )
    max_yaw_rate: float = Field(default=0.8, gt=0, description="[rad/s]")
    min_yaw_rate: float = Field(
        default=0.15, gt=0, description="[rad/s] slowest turn on the spot the drive follows reliably"
    )
    max_accel: float = Field(default=0.8, gt=0, description="[m/s^2] slew of the forward speed")
    max_decel: float = Field(
        default=0.8, gt=0, description="[m/s^2] planned braking for goal, bends and slow stretches"
    )
    max_yaw_accel: float = Field(default=2.5, gt=0, description="[rad/s^2] slew of the yaw rate")
    lateral_accel: float = Field(default=0.4, gt=0, description="[m/s^2] in bends")
    lag: float = Field(
        default=0.25, ge=0, description="[s] from command to motion; the pose is predicted this far"
    )
    lookahead: float = Field(
        default=0.35, gt=0, description="[m] line-of-sight distance: smaller returns to the path harder"
    )
    heading_gain: float = Field(
        default=2.0, gt=0, description="[1/s] yaw rate per heading error while it drives"
    )
    drift_gain: float = Field(
        default=0.3, ge=0, description="[1/s] learns a constant sideways drift (cross-slope, bends)"
    )
    turn_threshold: float = Field(
        default=0.70, gt=0, lt=3.2, description="[rad] heading error that stops and turns first"
    )
    turn_release: float = Field(
        default=0.14, gt=0, description="[rad] heading error at which driving starts again"
    )
    goal_tolerance: float = Field(default=0.10, gt=0, description="[m] position error accepted as reached")
    yaw_tolerance: float = Field(default=0.087, gt=0, description="[rad] yaw error accepted at the goal")
    goal_retries: int = Field(
        default=3, ge=0, description="corrections of a missed goal before it is accepted as it is"
    )
    slope_free: float = Field(default=0.17, ge=0, description="[rad] full speed up to this inclination")
    slope_slow: float = Field(
        default=0.44, gt=0, description="[rad] `slope_factor` of the speed from this inclination on"
    )
    slope_factor: float = Field(
        default=0.5, gt=0, le=1, description="share of the speed left on the steepest ground"
    )
    max_cross_track: float = Field(
        default=0.6, gt=0, description="[m] stop when further from the path than this"
    )

    def profile(self) -> dict[str, float]:
        """Limits of a path's speed profile, see `planning.tracking.path.track_path`."""
        return {
            "min_speed": self.min_speed,
            "max_speed": self.max_speed,
            "max_decel": self.max_decel,
            "lateral_accel": self.lateral_accel,
            "max_yaw_rate": 0.8 * self.max_yaw_rate,  # the rest is for corrections
        }


class TrackPhase(StrEnum):
    """Phase of the tracker."""

    IDLE = "idle"
    ALIGNING = "aligning"
    """Turning in place towards the path."""
    FOLLOWING = "following"
    FINAL_TURN = "final_turn"
    """At the goal: coming to rest, then turning to the goal yaw."""
    DONE = "done"


@dataclass(frozen=True, slots=True)
class TrackOutput:
    """One control step."""

    vx: float = 0.0
    """Forward [m/s], base_link; negative while backing."""
    wz: float = 0.0
    """[rad/s], counter-clockwise positive."""
    phase: TrackPhase = TrackPhase.IDLE
    distance_left: float = 0.0
    """Along the path [m]."""
    cross_track: float = 0.0
    """[m]; positive when the robot is left of the path, in the direction of travel."""
    heading_error: float = 0.0
    """Path heading minus direction of the body's travel [rad]; at the goal, goal yaw minus yaw."""
    progress: float = 0.0
    """Arc length reached [m]; never decreases on one path."""
    goal_distance: float = 0.0
    """Straight to the goal [m]."""
    path_id: int = 0
    fault: str = ""
    """Not empty: the velocity is zero because of this (bad input, off the path)."""
    slow: str = ""
    """What it drives slower than its limit for; empty at its limit, and while it does not follow a path."""
    missed: bool = False
    """Done, but further than twice `goal_tolerance` from the goal: what turning there may cost."""
