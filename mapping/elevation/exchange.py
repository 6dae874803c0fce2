"""The map on its way to its readers: rectangular patches, which `MapMirror` assembles again."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hal.errors import OperatorError
from mapping.elevation.virtual import virtual_ground
from mapping.filling import fill_unknown, slope_and_step
from mapping.grid import ElevationGrid

PATCH_LAYERS = ("elevation", "variance", "trusted", "upper_bound", "source")

LARGEST = 50_000_000
"""Cells of a mirror and of a map that is read as a whole: 280 m x 280 m of 4 cm, 1 GB. One patch that lies far off must not fill the memory."""


class MapError(OperatorError):
    """Input the map cannot take; the message names it and what was expected."""


@dataclass(frozen=True, slots=True)
class FuseReport:
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
    (NaN unknown), `trusted` 0/1, `upper_bound` [m] (the surface is not above this; NaN when no ray tells),
    `source` 0 unknown, 1 wheels, 2 LiDAR, 3 bridged between LiDAR rings, 4 assumed in a wider gap. That of `ElevationMap.complete`
    has `age`, too: seconds since something agreed with the height (NaN: never, as on a prior map and where it is bridged).
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
        """As an `ElevationGrid`; `filled`: unknown heights take the nearest known one and stay untrusted, and some are virtual ground."""
        height, trusted, virtual = self.layers["elevation"], self.layers["trusted"] > 0.5, None
        if filled:
            upper = self.layers["upper_bound"]
            height = fill_unknown(height, upper)
            virtual = virtual_ground(height, trusted, upper, self.resolution)
        return ElevationGrid(height, trusted, self.origin, self.resolution, virtual)


@dataclass(frozen=True, slots=True)
class CellWindow:
    """A rectangle of lattice cells."""

    row: int
    col: int
    rows: int
    cols: int


@dataclass(slots=True)
class MapMirror:
    """A reader's copy of the map, grown from patches. `grid()` is what planning works on."""

    resolution: float = 0.0
    """[m]; 0 until the first patch."""
    epoch: int = -1
    stamp: int = 0
    row: int = 0
    col: int = 0
    layers: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    _chunk: int = 64

    def apply(self, patch: MapPatch) -> CellWindow:
        """Take a patch in; returns the cells that it wrote. A new epoch or resolution starts over.

        A patch of an older epoch is ignored (empty window). Raises MapError for a patch off the lattice or too far off.
        """
        rows, cols = patch.shape
        row, col = patch.cell
        off = max(
            abs(patch.origin[1] - row * patch.resolution), abs(patch.origin[0] - col * patch.resolution)
        )
        if not off < 1e-3 * patch.resolution:
            raise MapError(
                f"patch origin {patch.origin} is not a multiple of its resolution {patch.resolution}"
            )
        if patch.epoch < self.epoch:
            return CellWindow(row, col, 0, 0)
        if patch.epoch > self.epoch or abs(patch.resolution - self.resolution) > 1e-9:
            self.epoch, self.resolution, self.layers = patch.epoch, patch.resolution, {}
        self._cover(row, col, rows, cols)
        where = (slice(row - self.row, row - self.row + rows), slice(col - self.col, col - self.col + cols))
        for name in PATCH_LAYERS:
            self.layers[name][where] = patch.layers[name]
        self.stamp = max(self.stamp, patch.stamp)
        return CellWindow(row, col, rows, cols)

    def overlaid(self, patch: MapPatch) -> MapMirror:
        """A copy with `patch` on it; this mirror stays as it is. Raises MapError like `apply`."""
        other = replace(self, layers={name: layer.copy() for name, layer in self.layers.items()})
        other.apply(patch)
        return other

    def _cover(self, row: int, col: int, rows: int, cols: int) -> None:
        c = self._chunk
        r0, c0 = row // c * c, col // c * c
        r1, c1 = -(-(row + rows) // c) * c, -(-(col + cols) // c) * c
        if self.layers:
            h, w = self.layers["elevation"].shape
            if r0 >= self.row and c0 >= self.col and r1 <= self.row + h and c1 <= self.col + w:
                return
            r0, c0 = min(r0, self.row), min(c0, self.col)
            r1, c1 = max(r1, self.row + h), max(c1, self.col + w)
        if (r1 - r0) * (c1 - c0) > LARGEST:
            raise MapError(
                f"a map of {(r1 - r0) * self.resolution:.0f} x {(c1 - c0) * self.resolution:.0f} m is too large: is a patch far off?"
            )
        for name in PATCH_LAYERS:
            fresh = 0.0 if name in ("trusted", "source") else np.nan
            grown = np.full((r1 - r0, c1 - c0), fresh, dtype=np.float32)
            if name in self.layers:
                old = self.layers[name]
                grown[
                    self.row - r0 : self.row - r0 + old.shape[0], self.col - c0 : self.col - c0 + old.shape[1]
                ] = old
            self.layers[name] = grown
        self.row, self.col = r0, c0

    def patch(self) -> MapPatch:
        """Everything received, as one patch. The arrays are copies."""
        if not self.layers:
            raise MapError("no map yet: no patch was received")
        origin = (self.col * self.resolution, self.row * self.resolution)
        layers = {name: layer.copy() for name, layer in self.layers.items()}
        return MapPatch(origin, self.resolution, self.stamp, self.epoch, layers)

    def grid(self, *, filled: bool = True) -> ElevationGrid:
        """The map for planning: unknown heights filled from the nearest known cell, untrusted; some are virtual ground."""
        return self.patch().grid(filled=filled)
