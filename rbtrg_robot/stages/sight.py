"""The ground under the places that a controller wants to see, from the map window of another process."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hal.lowlevel import Ground
from hal.types import NS, Array
from mapping.elevation.exchange import MapPatch
from rbtrg_robot import msg
from rbtrg_robot.wire.convert import LayoutError, map_patch

OLDEST_WINDOW = 0.5
"""[s] of a window that still tells the ground; one comes after each sweep."""
MOST_UNKNOWN = 0.5
"""Share of the places that nobody saw, beyond which a controller is told that it sees no ground."""


class Sight:
    """Map windows in, heights at `places` out."""

    def __init__(self, places: Array) -> None:
        """`places` (m, 2) [m]: see `hal.lowlevel.Sighted`."""
        self._places = places
        self._window: MapPatch | None = None
        self._height: NDArray[np.float32] = np.empty((0, 0), np.float32)
        """(rows, cols) of the window [m], NaN where it is not trusted."""
        self._correction = 0.0

    def window(self, message: msg.GridMap) -> None:
        """The newest of `/elevation_map/window`. What is no map counts as none."""
        try:
            self._window = map_patch(message, 0)
        except LayoutError:
            return self.forget()
        layers = self._window.layers
        self._height = np.where(layers["trusted"] > 0.5, layers["elevation"], np.float32(np.nan))

    def forget(self) -> None:
        """The window lies elsewhere now."""
        self._window = None

    def status(self, message: msg.MapStatus) -> None:
        """How far the map lies above the odometry's heights."""
        if math.isfinite(message.height_correction):
            self._correction = message.height_correction

    def ground(self, now: int, place: tuple[NDArray[np.float64], float] | None) -> Ground:
        """At `now` [ns]. `place`: position (3,) [m] and yaw [rad] of base_link in `map`; None: not known."""
        window = self._window
        if window is None:
            return self._nothing("no map came yet")
        if place is None:
            return self._nothing("the pose is not known")
        if abs(now - window.stamp) > OLDEST_WINDOW * NS:
            return self._nothing(f"the map is older than {OLDEST_WINDOW} s")
        (x, y, z), yaw = place
        c, s = math.cos(yaw), math.sin(yaw)
        at = np.array([x, y]) + self._places @ np.array([[c, s], [-s, c]])
        column, row = np.rint((at - window.origin) / window.resolution).astype(np.int64).T
        rows, columns = self._height.shape
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        above = np.full(len(at), np.nan)
        above[inside] = z + self._correction - self._height[row[inside], column[inside]]
        unknown = np.isnan(above).mean() > MOST_UNKNOWN
        return Ground(above, "nobody saw most of it" if unknown else "")

    def _nothing(self, why: str) -> Ground:
        return Ground(np.full(len(self._places), np.nan), why)
