"""Settings of T-Hybrid: as released, and as the RB-TRG paper describes its use."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class THybridParams(BaseModel):
    """Defaults: the `paper` profile, on maps of a few metres."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cell: float = Field(default=0.10, gt=0.0, description="side of a planner cell [m]")
    max_slope: float = Field(default=0.42, gt=0.0, description="steepest plane of a traversable cell [rad]")
    max_pitch: float = Field(default=0.42, gt=0.0, description="largest |pitch| of a pose [rad]")
    max_roll: float = Field(default=0.42, gt=0.0, description="largest |roll| of a pose [rad]")
    ring: float = Field(
        default=0.0,
        ge=0.0,
        description="width of the border in which a window is a square of 1 m [m]",
    )
    length: float = Field(default=0.70, gt=0.0, description="footprint along travel [m]")
    width: float = Field(default=0.43, gt=0.0, description="footprint across travel [m]")
    risk_floor: float = Field(
        default=0.05,
        ge=0.0,
        description="least risk of a step; without one, level noiseless ground costs nothing and the search "
        "does not progress",
    )
    budget: int = Field(default=80_000, ge=1, description="pops of the open list; then it gives up")
    released_quirks: bool = Field(
        default=False,
        description="arcs that curve against their turn and a lookup half a cell off, as in the release",
    )


PROFILES = {
    "paper": THybridParams(),
    "released": THybridParams(
        cell=0.30,
        max_slope=0.30,
        max_pitch=0.30,
        max_roll=0.18,
        ring=1.0,
        length=0.5,
        width=0.5,
        risk_floor=0.0,
        released_quirks=True,
    ),
}
