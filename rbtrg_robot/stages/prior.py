"""The map that was there before the robot was: which it is, its blocks and its cloud, read when they are needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hal.types import NO_POINTS
from mapping.elevation.exchange import MapPatch
from mapping.elevation.map import ElevationMap
from mapping.relocalise.door import OwnFinder
from rbtrg_robot.stages.location import Location
from rbtrg_robot.wire.frames import Planar


@dataclass(slots=True)
class Prior:
    """A prior map, or none."""

    id: str = ""
    """Hash of its file; empty where there is none."""
    name: str = ""
    start: Planar = (0.0, 0.0, 0.0)
    """x, y [m], yaw [rad] of `odom` in it, as it is thought to be."""
    patches: tuple[MapPatch, ...] = ()
    cloud: NDArray[np.float32] = field(default_factory=lambda: NO_POINTS)
    """x, y, z [m], shape (n, 3)."""
    stamp: int = 0
    """Of the message that brought it [ns]; 0 for one from a file."""
    later: Callable[[], ElevationMap] | None = None
    """Reads it; None where that is done. It takes seconds for a large map."""
    finder: OwnFinder | None = None
    """Who finds the robot in it; None: the project's."""

    def read(self) -> None:
        """Now it is needed. Raises MapError."""
        if self.later is not None:
            read, self.later = self.later, None
            self.take(read())

    def take(self, elevation: ElevationMap) -> None:
        """It is what this map holds."""
        self.patches, self.cloud = tuple(map(elevation.read, elevation.boxes())), elevation.cloud.points

    def search(self) -> Location:
        """Where the robot is in it is looked for from now on."""
        return Location.begin(self.name, self.patches, self.cloud, self.start, self.finder)
