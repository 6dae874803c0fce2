"""Inputs of the graph: its settings, a valid start, and the windows of the map that changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hal.envelope import FALL_COST
from mapping.grid import ElevationGrid
from planning.errors import NoRoute, NoRouteReason, PlanningError
from planning.graph.faces import FACE_NOISE

Window = tuple[int, int, int, int]
"""row0, col0, row1, col1 of a part of the grid, ends exclusive."""


class GraphSettings(BaseModel):
    """Settings of the graph but for the limits of the robot. The defaults are the dense setting of the published
    scenes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    expand_dist: float = Field(default=0.42, gt=0.0, description="ring on which new nodes are drawn (D) [m]")
    robot_size: float = Field(
        default=0.30,
        gt=0.0,
        description="radius of the terrain that an edge's risk is taken from, least node spacing (R) [m]",
    )
    sample_num: int = Field(
        default=32, ge=1, le=63, description="draws per expanded node, or candidates per lattice cell"
    )
    fall_cost: float = Field(
        default=FALL_COST,
        ge=0.0,
        description="what a failure costs: a probability of 1 % adds a hundredth of it [m]",
    )
    min_coverage: float = Field(
        default=0.70,
        ge=0.0,
        le=1.0,
        description="least seen share of every cross-section of an edge's corridor",
    )
    blind_radius: float = Field(
        default=2.0,
        ge=0.0,
        description="around the first start, ground the robot cannot see needs no coverage [m]",
    )
    length: float = Field(default=0.70, gt=0.0, description="footprint along travel [m]")
    width: float = Field(default=0.43, gt=0.0, description="footprint across travel [m]")
    axle: float = Field(
        default=0.21,
        gt=0.0,
        description="wheels touch ground so far before and behind base_link [m]",
    )
    tread: float = Field(
        default=0.1928, gt=0.0, description="middle of the body to the middle of a wheel [m]"
    )
    tread_width: float = Field(default=0.0518, gt=0.0, description="width of a wheel [m]")
    radius: float = Field(default=0.086, gt=0.0, description="of a wheel or foot [m]")


class GraphParams(GraphSettings):
    """Settings of the graph and the limits of the robot that drives on it; the defaults suit every controller of the
    robot of the paper."""

    max_step: float = Field(
        default=0.10,
        gt=0.0,
        description="highest vertical face driven over [m]",
    )
    max_slope: float = Field(default=0.436, gt=0.0, lt=1.5, description="steepest ground at body scale [rad]")
    max_gap: float = Field(default=0.10, ge=0.0, description="widest gap or unseen slit driven over [m]")
    max_posts: float | None = Field(
        default=None,
        gt=0.0,
        description="highest posts of a stepfield that is driven through [m]; None = any up to max_step",
    )
    keep_step: float = Field(
        default=0.0,
        ge=0.0,
        description="ground found drivable stays so up to this much above max_step [m]; 0 = a graph that "
        "depends on the map alone, not on how it came about",
    )

    controller: str | None = Field(
        default=None,
        description="whose measured envelope prices faces, slopes, turns, posts and gaps; None = they cost "
        "nothing",
    )

    @property
    def climbed(self) -> float:
        """A face that the map has higher than this [m] is a wall."""
        return self.max_step + FACE_NOISE


def checked_start(grid: ElevationGrid, start_xy: tuple[float, float]) -> tuple[float, float]:
    """The start as two floats, once grid and start make sense."""
    if not isinstance(grid, ElevationGrid):
        raise PlanningError(f"grid must be an ElevationGrid, got {type(grid).__name__}")
    if not grid.trusted.any():
        raise NoRoute(NoRouteReason.NO_TERRAIN, "the map holds no trusted cell: wait for the first scans")
    start = np.asarray(start_xy, dtype=np.float64)
    if start.shape != (2,) or not np.isfinite(start).all():
        raise NoRoute(NoRouteReason.BAD_INPUT, f"the start must be two finite metres x, y, got {start_xy}")
    x0, y0, x1, y1 = grid.extent
    half = 0.5 * grid.resolution
    if not (x0 - half <= start[0] <= x1 + half and y0 - half <= start[1] <= y1 + half):
        raise NoRoute(
            NoRouteReason.OUTSIDE_MAP,
            f"the start {start_xy} is outside the map ({x0}, {y0})..({x1}, {y1}): begin inside it",
        )
    return float(start[0]), float(start[1])


def changed_windows(grid: ElevationGrid, changed: Sequence[Window]) -> list[Window]:
    """The parts of `changed` inside the grid."""
    rows, cols = grid.shape
    out = []
    for window in changed:
        r0, c0, r1, c1 = (int(v) for v in window)
        clipped = (max(0, r0), max(0, c0), min(rows, r1), min(cols, c1))
        if clipped[0] < clipped[2] and clipped[1] < clipped[3]:
            out.append(clipped)
    return out


def merge_windows(windows: Sequence[Window], pad: int) -> list[Window]:
    """Join windows where one larger window is no more work than two, each padded by `pad` cells."""

    def work(w: Window) -> int:
        return (w[2] - w[0] + 2 * pad) * (w[3] - w[1] + 2 * pad)

    out: list[Window] = []
    for window in windows:
        w = window
        while True:
            for k, o in enumerate(out):
                both = (min(w[0], o[0]), min(w[1], o[1]), max(w[2], o[2]), max(w[3], o[3]))
                if work(both) <= work(w) + work(o):
                    w = both
                    del out[k]
                    break
            else:
                break
        out.append(w)
    return out
