"""Parameters of the elevation map. The defaults fit a robot of 0.7 m with a 16-ring LiDAR; few of them ever need a
change."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from hal.robots import describe


class ElevationConfig(BaseModel):
    """Sources: noise model and gates after ANYbotics/elevation_mapping; own two-mode cells and bridging."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    resolution: float = Field(default=0.04, ge=0.01, le=0.2, description="cell size [m]")
    tile_cells: int = Field(default=64, description="cells per tile side, a power of two")
    # --- which points count
    min_range: float = Field(default=0.3, ge=0.0, description="nearer returns are dropped [m]")
    max_range: float = Field(default=10.0, gt=0.0, description="farther returns are dropped [m]")
    ceiling: float = Field(
        default=0.6, description="points higher than this above base_link are overhead [m] ..."
    )
    ceiling_slope: float = Field(
        default=0.5, description="... plus this times their distance, so that ramps stay [m/m]"
    )
    beside: tuple[float, float] = Field(
        default=(0.10, 0.085),
        description="nearer to the body, ahead or behind and aside, nothing is mapped: a LiDAR sees it too steeply [m]",
    )
    # --- noise of the pose
    attitude_sigma: float = Field(default=0.0035, gt=0.0, description="roll/pitch noise of the pose [rad]")
    height_sigma: float = Field(
        default=0.005, gt=0.0, description="height noise of the pose from scan to scan [m]"
    )
    # --- fusion
    gate: float = Field(default=2.5, description="a measurement this many sigmas off contradicts the cell")
    gate_min: float = Field(default=0.05, description="a difference below this never contradicts [m]")
    surface_band: float = Field(
        default=0.05, description="points this far under the highest of a cell are its surface [m]"
    )
    face: float = Field(
        default=0.08, description="vertical extent in one cell and scan that makes it a wall's face [m]"
    )
    clearance: float = Field(
        default=0.8, description="what hangs higher than this over the ground is passed under [m]"
    )
    up_after: int = Field(default=2, ge=1, description="scans until a higher surface replaces a lower one")
    down_after: int = Field(default=5, ge=1, description="scans until a lower surface replaces a higher one")
    conflict_memory: float = Field(
        default=1.0, description="contradictions further apart than this start over [s]"
    )
    min_sigma: float = Field(
        default=0.003, gt=0.0, description="a cell never gets more certain than this [m]"
    )
    drift_sigma: float = Field(
        default=0.003, ge=0.0, description="how uncertain an unseen cell grows per root second [m]"
    )
    # --- trust
    trust_sigma: float = Field(
        default=0.06, gt=0.0, description="cells less certain than this are not trusted [m]"
    )
    trust_count: int = Field(default=3, ge=1, description="points of an established cell")
    alone_count: int = Field(
        default=6, ge=1, description="points of an established cell that no neighbour reaches"
    )
    # --- ground under the wheels
    footprint: tuple[float, float] = Field(
        default=(0.38, 0.43), description="ground between the wheels: length and width [m]"
    )
    footprint_margin: float = Field(
        default=0.0, description="support plane of a driving robot reaches this far beyond the footprint [m]"
    )
    start_radius: float = Field(
        default=0.8, description="support plane of a starting robot reaches this far [m]"
    )
    contact_sigma: float = Field(
        default=0.03, description="height noise of the support plane at the wheels [m]"
    )
    # --- what was touched
    touched_fade: float = Field(
        default=120.0,
        ge=10.0,
        le=3600.0,
        description="time after which a touched wall that no ray shows is forgotten [s]",
    )
    body_size: tuple[float, float] = Field(
        default_factory=lambda: (describe().body.length, describe().body.width),
        exclude=True,
        description="the robot's own length and width [m]; set there, not here",
    )
    # --- clean-up
    clean_range: float = Field(default=6.0, description="rays are traced this far [m]")
    clean_margin: float = Field(
        default=0.04, description="a ray must pass this far below a surface to look through it [m]"
    )
    clean_passes: int = Field(default=2, ge=1, description="clean-ups that must look through a cell")
    clean_unseen: float = Field(default=0.5, description="cells confirmed within this time stay [s]")
    clean_skip: float = Field(
        default=0.3, description="the end of a ray proves nothing about walls it grazes [m]"
    )
    # --- grass and bushes
    plants: bool = Field(default=True, description="grass and bushes are ground at a price, not a step")
    plants_above: float = Field(
        default=0.10, gt=0.0, description="what is not higher above the ground around is not looked at [m]"
    )
    # --- bridging of the gaps between LiDAR rings
    bridge_gap: float = Field(default=0.64, description="widest gap filled between two trusted cells [m]")
    bridge_trust: float = Field(
        default=0.2,
        description="widest bridged gap that is trusted [m]; a wheel is 0.18 m wide",
    )
    bridge_step: float = Field(
        default=0.03, description="height difference across a bridged gap off the local slope [m]"
    )
    bridge_slope: float = Field(default=0.47, description="steepest bridged slope [m/m]")
    bridge_bound: float = Field(
        default=0.12, description="a ray must have passed this low over a bridged cell [m]"
    )
    blind_gap: float = Field(
        default=1.4, description="widest gap between the support plane and the nearest LiDAR ring [m]"
    )
    hole: float = Field(default=0.04, description="a ray this far below the bridge proves a hole [m]")
    # --- height drift of the odometry
    drift_gain: float = Field(
        default=0.1, ge=0.0, le=1.0, description="share of the mean height residual taken per scan"
    )
    drift_free: float = Field(default=0.003, ge=0.0, description="mean residuals below this are noise [m]")
    drift_min_cells: int = Field(default=200, description="agreeing cells needed for that")
    # --- deltas
    patch_step: float = Field(
        default=0.005, description="height change that makes a cell part of the next delta [m]"
    )
