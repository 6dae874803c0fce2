"""Body risk: what the robot's oriented body meets at a pose, along an edge and in a turn (paper eq. 2-4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from mapping.grid import ElevationGrid
from planning.errors import PlanningError
from planning.risk.cost import Weights
from planning.risk.footprint import poses_features
from planning.risk.pose_sets import moments_of_parts, turn_angle
from planning.risk.terrain import Terrain

FEATURES = ("d_fb", "a_lr", "p_int", "u")
"""Front-back support difference [m], side tilt [deg], interference [m], unknown share [-]."""


class BodyModel(BaseModel):
    """The body and how its risk is weighed. Defaults are those of the paper."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    length: float = Field(default=0.70, gt=0.0, description="body length L [m]")
    width: float = Field(default=0.43, gt=0.0, description="body width W [m]")
    scale_fb: float = Field(
        default=0.30, gt=0.0, description="s_fb: support difference counted as risk 1 [m]"
    )
    scale_lr: float = Field(default=30.0, gt=0.0, description="s_lr: side tilt counted as risk 1 [deg]")
    scale_int: float = Field(default=0.30, gt=0.0, description="s_int: interference counted as risk 1 [m]")
    clip: float = Field(default=3.0, gt=0.0, description="largest scaled feature [-]")
    weight_mean: float = Field(
        default=0.5, ge=0.0, description="w_mu: weight of the mean over a pose set [-]"
    )
    weight_tail: float = Field(
        default=0.5, ge=0.0, description="w_t: weight of the mean of its largest tenth [-]"
    )
    weight_native: float = Field(
        default=3.0, ge=0.0, description="sigma: weight of the graph's own edge risk [-]"
    )
    weight_body: float = Field(default=1.0, ge=0.0, description="lambda_b: weight of body risk B [-]")
    weight_unknown: float = Field(default=1.0, ge=0.0, description="lambda_u: weight of unknown ground U [-]")
    edge_step: float = Field(
        default=0.05, gt=0.0, description="largest distance between poses along an edge [m]"
    )
    sweep_step: float = Field(default=5.0, gt=0.0, description="largest turn between poses of a sweep [deg]")

    @property
    def circumradius(self) -> float:
        """Half the footprint's diagonal [m]."""
        return 0.5 * float(np.hypot(self.length, self.width))

    @property
    def scales(self) -> NDArray[np.float64]:
        """(4,) divisors of the features; the unknown share is its own scale."""
        return np.array([self.scale_fb, self.scale_lr, self.scale_int, 1.0])


def unseen_price(body: BodyModel) -> float:
    """Cost of a metre [m] of which nothing was seen, on an edge of the graph and beyond a frontier alike (paper eq. 5
    with U = 1)."""
    return 1.0 + body.weight_unknown


def weights_of(body: BodyModel) -> Weights:
    """`body` as plain numbers for the kernels."""
    return Weights(
        body.scales,
        body.clip,
        body.weight_mean,
        body.weight_tail,
        body.weight_native,
        body.weight_body,
        body.weight_unknown,
        body.edge_step,
        float(np.radians(body.sweep_step)),
    )


def terrain_of(grid: ElevationGrid, body: BodyModel) -> Terrain:
    """`grid` filled and padded by the footprint's circumradius."""
    return Terrain.from_grid(grid, body.circumradius)


def terrain_features(terrain: Terrain, poses: NDArray[np.float64], body: BodyModel) -> NDArray[np.float64]:
    """`pose_features` on a terrain that is already prepared."""
    return poses_features(
        terrain.sampler(body.length, body.width), np.ascontiguousarray(poses, dtype=np.float64)
    )


def pose_features(grid: ElevationGrid, poses: NDArray[np.float64], body: BodyModel) -> NDArray[np.float64]:
    """Features of poses x, y [m], yaw [rad] in `map`.

    `poses` is (n, 3); returns (n, 4): d_fb [m], a_lr [deg], p_int [m], u [-] (`FEATURES`). Raises
    PlanningError for another shape or a pose that is not finite.
    """
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise PlanningError(f"poses must have shape (n, 3) with columns x, y, yaw; got {poses.shape}")
    if not np.isfinite(poses).all():
        raise PlanningError("poses must be finite: remove the rows with NaN or infinity")
    return terrain_features(terrain_of(grid, body), poses, body)


def edge_poses(start: NDArray[np.float64], end: NDArray[np.float64], body: BodyModel) -> NDArray[np.float64]:
    """Poses (n, 3) along the straight edge start -> end, both ends in, heading of the edge."""
    dx, dy = float(end[0] - start[0]), float(end[1] - start[1])
    n = max(2, int(np.ceil(np.hypot(dx, dy) / body.edge_step - 1e-9)) + 1)
    t = np.linspace(0.0, 1.0, n)
    return np.column_stack([start[0] + t * dx, start[1] + t * dy, np.full(n, np.arctan2(dy, dx))])


def sweep_poses(x: float, y: float, yaw_in: float, yaw_out: float, body: BodyModel) -> NDArray[np.float64]:
    """Poses (n, 3) of a turn in place, both headings in; one pose when nothing turns."""
    d = turn_angle(yaw_in, yaw_out)
    n = int(np.ceil(abs(d) / np.radians(body.sweep_step) - 1e-9)) + 1
    t = np.linspace(0.0, 1.0, n) if n > 1 else np.zeros(1)
    return np.column_stack([np.full(n, x), np.full(n, y), yaw_in + t * d])


def moments_of(
    features: NDArray[np.float64], parts: NDArray[np.int64], body: BodyModel
) -> NDArray[np.float64]:
    """(k, 3, 4) moments (`aggregate`) of pose sets with features (n, 4): set k has the rows from `parts[k, 0]` to
    before `parts[k, 1]`.

    NaN for a set without rows (paper eq. 3).
    """
    return moments_of_parts(weights_of(body), np.ascontiguousarray(features), parts)
