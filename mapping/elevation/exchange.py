"""The map on its way to its readers: rectangular patches, which `MapMirror` assembles again; what became of a scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hal.errors import OperatorError
from mapping.elevation.virtual import virtual_ground
from mapping.filling import fill_unknown, slope_and_step
from mapping.grid import ElevationGrid

PATCH_LAYERS = ("elevation", "variance", "trusted", "upper_bound", "source")

PLANTS = 5
"""`source` of ground under leaves."""
TOUCHED = 6
"""`source` of what the robot touched and no ray tells of; in read-outs only."""
HOLE = 7
"""`source` of holes wider than the robot crosses; in read-outs only."""
SOURCES = ("unknown", "wheels", "LiDAR", "bridged", "assumed", "ground under leaves", "touched", "a hole")
"""In words, by `source`."""
LARGEST_PATCH = 50_000_000
"""Cells of one patch: 280 m x 280 m of 4 cm, 1 GB."""


class MapError(OperatorError):
    """Input the map cannot take; the message names it and what was expected."""


class FuseReport(NamedTuple):
    """What became of one scan: points by reason, then cells by outcome."""

    points: int
    used: int
    invalid: int
    """NaN or infinite."""
    out_of_range: int
    body: int
    ceiling: int
    cells: int
    agreed: int
    new: int
    conflict: int
    replaced: int
    overhang: int
    z_correction: float
    """Height drift of the odometry taken out so far [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class MapPatch:
    """A rectangle of cells on the world lattice, frame `map`.

    Row grows with y, column with x. Layers are (rows, cols) float32: `elevation` [m] (NaN unknown), `variance` [m^2]
    (NaN unknown), `trusted` 0/1, `upper_bound` [m] (the surface is not above this; NaN when no ray tells), `source` 0
    unknown, 1 wheels, 2 LiDAR, 3 bridged between LiDAR rings, 4 assumed in a wider gap, 5 ground under leaves
    (`upper_bound`: their top), 6 touched by the robot, 7 a hole wider than the robot crosses
    (`mapping.elevation.holes`). That of `ElevationMap.complete` has `age`, too: seconds since something agreed with the
    height (NaN: never, as on a prior map and where it is bridged).
    """

    origin: tuple[float, float]
    """x, y [m] of the centre of cell [0, 0]; whole multiples of the resolution."""
    resolution: float
    stamp: int
    """Scan the patch is as new as [ns]."""
    epoch: int
    """Rises when the map was reset or replaced: readers start over."""
    layers: dict[str, NDArray[np.float32]]

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        rows, cols = self.layers["elevation"].shape
        return rows, cols

    @property
    def cell(self) -> tuple[int, int]:
        """Lattice row and column of cell [0, 0]."""
        return round(self.origin[1] / self.resolution), round(self.origin[0] / self.resolution)

    @property
    def middle(self) -> tuple[float, float]:
        """x, y [m] of the middle: of a window, the place of the robot."""
        rows, cols = self.shape
        return (
            self.origin[0] + 0.5 * (cols - 1) * self.resolution,
            self.origin[1] + 0.5 * (rows - 1) * self.resolution,
        )

    def with_terrain(self) -> MapPatch:
        """With three more layers for people and their tools: `filled` as in `grid`, `slope` [rad] and `step` [m] as in
        `slope_and_step`."""
        height = self.layers["elevation"]
        slope, step = slope_and_step(height, self.resolution)
        filled = fill_unknown(height, self.layers["upper_bound"])
        return replace(self, layers=self.layers | {"filled": filled, "slope": slope, "step": step})

    def grid(self, *, filled: bool = False) -> ElevationGrid:
        """As an `ElevationGrid`; `filled`: unknown heights take the nearest known one and stay untrusted, and some are
        virtual ground."""
        height, trusted, virtual = self.layers["elevation"], self.layers["trusted"] > 0.5, None
        if filled:
            upper = self.layers["upper_bound"]
            height = fill_unknown(height, upper)
            virtual = virtual_ground(height, trusted, upper, self.resolution)
        plants, holes = (
            mask if mask.any() else None for mask in (self.layers["source"] == x for x in (PLANTS, HOLE))
        )
        variance = self.layers.get("variance")
        return ElevationGrid(height, trusted, self.origin, self.resolution, virtual, plants, variance, holes)
