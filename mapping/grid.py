"""The elevation grid: what planning sees of the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FARTHEST_PLACE = 100_000.0
"""[m] from the origin of `map`: single precision resolves 8 mm there, and half a metre at the 5000 km of UTM."""


class GridError(ValueError):
    """The grid's arrays do not fit together; the message names the array and what was expected."""


@dataclass(frozen=True, slots=True, eq=False)
class ElevationGrid:
    """A dense height grid in the `map` frame.

    Row grows with y, column with x; cell [r, c] is centred on `(origin[0] + c * resolution, origin[1] + r *
    resolution)`.
    """

    height: NDArray[np.float32]
    """(rows, cols) float32 [m]; NaN where never seen, unless filled for planning."""
    trusted: NDArray[np.bool_]
    """(rows, cols) bool; False where the height is unknown, filled or not certain."""
    origin: tuple[float, float]
    """x, y [m] of the CENTRE of cell [0, 0]."""
    resolution: float
    """Cell size [m]."""
    virtual: NDArray[np.bool_] | None = None
    """(rows, cols) bool; nobody measured the cell, but a ray passed so low over it that only ground can lie there:
    `height` is the best case, from where the ground may fall. None: no such cell."""

    plants: NDArray[np.bool_] | None = None
    """(rows, cols) bool; the cell is ground under leaves: nobody saw what stands in them. None: no such cell."""

    variance: NDArray[np.float32] | None = None
    """(rows, cols) float32 [m^2] of `height`; NaN where it was not measured. None: not known."""

    holes: NDArray[np.bool_] | None = None
    """(rows, cols) bool; the cell shows a hole wider than the robot crosses, whatever its height tells. None: no such
    cell."""

    def __post_init__(self) -> None:
        height = np.ascontiguousarray(self.height, dtype=np.float32)
        trusted = np.ascontiguousarray(self.trusted)
        if height.ndim != 2 or height.size == 0:
            raise GridError(f"height must be a non-empty 2-D array, got shape {height.shape}")
        if trusted.dtype != np.bool_:
            raise GridError(f"trusted must be bool, got {trusted.dtype}")
        if trusted.shape != height.shape:
            raise GridError(f"trusted has shape {trusted.shape}, height has {height.shape}")
        for name, mask in (("virtual", self.virtual), ("plants", self.plants), ("holes", self.holes)):
            if mask is not None and (mask.dtype, mask.shape) != (np.bool_, height.shape):
                raise GridError(f"{name} must be bool of shape {height.shape}")
        if self.variance is not None and self.variance.shape != height.shape:
            raise GridError(f"variance must have shape {height.shape}, got {self.variance.shape}")
        origin = (float(self.origin[0]), float(self.origin[1]))
        if not np.isfinite(origin).all():
            raise GridError(f"origin must be finite, got {origin}")
        if max(map(abs, origin)) > FARTHEST_PLACE:
            raise GridError(
                f"origin {origin} is more than {FARTHEST_PLACE / 1000:.0f} km away, where heights of single precision "
                "blur: subtract the coordinates of a place nearby (UTM does not fit)"
            )
        if not (np.isfinite(self.resolution) and self.resolution > 0.0):
            raise GridError(f"resolution must be a positive number of metres, got {self.resolution}")
        object.__setattr__(self, "height", height)
        # A height that is not finite is no ground, whatever the flag says.
        object.__setattr__(self, "trusted", trusted & np.isfinite(height))
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "resolution", float(self.resolution))

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.height.shape[0], self.height.shape[1]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of the outermost cell centres [m]."""
        rows, cols = self.shape
        x0, y0 = self.origin
        return x0, y0, x0 + (cols - 1) * self.resolution, y0 + (rows - 1) * self.resolution

    def around(self, xy: NDArray[np.float64], margin: float) -> ElevationGrid:
        """The part that holds every cell within `margin` [m] of the bounding box of the points (n, 2); at least one
        cell."""
        reach = np.array([margin, margin])
        low = (xy.min(axis=0) - reach - self.origin) / self.resolution
        high = (xy.max(axis=0) + reach - self.origin) / self.resolution
        rows, cols = self.shape
        c0, r0 = (int(v) for v in np.clip(np.floor(low), 0, (cols - 1, rows - 1)))
        c1, r1 = (int(v) for v in np.clip(np.ceil(high), 0, (cols - 1, rows - 1)))
        part = (slice(r0, r1 + 1), slice(c0, c1 + 1))
        corner = (self.origin[0] + c0 * self.resolution, self.origin[1] + r0 * self.resolution)
        virtual, plants, holes = (
            None if mask is None else mask[part] for mask in (self.virtual, self.plants, self.holes)
        )
        variance = None if self.variance is None else self.variance[part]
        height, trusted = self.height[part], self.trusted[part]
        return ElevationGrid(height, trusted, corner, self.resolution, virtual, plants, variance, holes)
