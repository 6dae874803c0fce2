"""Settings of ART, with the geometry of the paper's robot in place of ANYmal's."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

Triple = tuple[float, float, float]


class ArtParams(BaseModel):
    """Lengths [m], angles [rad]."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    torso: Triple = Field(default=(0.70, 0.43, 0.19), description="length, width, height of the torso's box")
    torso_z: float = Field(default=0.40, description="the box's middle above the plane of the feet")
    feet: tuple[float, float] = Field(default=(0.22, 0.193), description="x and y of the foot boxes' middles")
    reach: Triple = Field(default=(0.15, 0.15, 0.15), description="a foot box: where the foot can reach")
    roll_spread: float = Field(default=math.radians(6.66), description="largest roll off the ground's plane")
    pitch_spread: float = Field(
        default=math.radians(20.0), description="largest pitch off the ground's plane"
    )
    speed: Triple = Field(
        default=(0.5, 0.1, 0.5), description="largest speeds along, across [m/s] and in yaw [rad/s]"
    )
    milestones: int = Field(default=2_000, ge=10, description="in place of the release's time budget")
    batch: int = Field(default=500, ge=1, description="draws between two updates of the sampling density")
    start_radius: float = Field(default=0.2, description="around the start in which a pose is looked for")
    goal_radius: float = Field(default=0.5, description="around the goal in which a pose is looked for")
    tries: int = Field(default=1_000, description="to find a pose there")
    masks: bool = Field(
        default=True, description="feet keep off unseen ground; without, they stand on filled ground too"
    )
    margin: float = Field(default=0.30, description="safety margin around unseen ground")
    hole: float = Field(default=0.30, description="unseen ground narrower than this counts as seen")
    drop: float = Field(default=0.30, description="a rise or drop beside which no hole is closed")
    drop_radius: float = Field(default=0.16, description="in which a drop is looked for")
    foothold: float = Field(default=0.10, description="narrowest ground that can be stood on")
    unknown_mass: float = Field(default=0.10, description="share of the draws on unseen ground")

    @property
    def boxes(self) -> NDArray[np.float64]:
        """(5, 6) middle and half lengths of the torso and the four foot boxes, in the frame of the feet's plane."""
        half = [0.5 * v for v in self.reach]
        feet = [[sx * self.feet[0], sy * self.feet[1], 0.0, *half] for sx in (1, -1) for sy in (1, -1)]
        return np.array([[0.0, 0.0, self.torso_z, *(0.5 * v for v in self.torso)], *feet])
