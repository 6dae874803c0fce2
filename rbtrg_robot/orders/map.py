"""The whole elevation map: asked for until it comes, and written to a file by who asked."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Any

from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import MapPatch
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import LayoutError, map_patch
from rbtrg_robot.wire.messages import header

AGAIN, LIMIT = 3.0, 15.0
"""[s] between two requests, and until it is given up."""


class FetchMap(Order):
    """The present map as a patch."""

    hears = (t.MAP_FULL,)
    sends = (t.MAP_REQUEST,)

    def __init__(self) -> None:
        super().__init__(AGAIN, LIMIT)
        self.patch: MapPatch | None = None

    def message(self) -> tuple[Topic, msg.Message]:
        """The request."""
        return t.MAP_REQUEST, msg.MapRequest(header=header(time.time_ns(), ""), action="full")

    def take(self, topic: Topic, message: Any) -> None:
        """A GridMap; one that is broken is none, and it is asked for again."""
        with contextlib.suppress(LayoutError):
            self.patch = map_patch(message, 0)
            self.outcome = Outcome(True, "")

    def silence(self) -> Outcome:
        """Elevation is gone."""
        return Outcome(False, "the elevation process sends no map; see `rbtrg-robot status`")


def save(patch: MapPatch, file: Path) -> int:
    """Write it as `up --map` reads it; returns the number of known cells."""
    from mapping.elevation.map import ElevationMap

    elevation = ElevationMap(ElevationConfig(resolution=patch.resolution))
    known = elevation.restore(patch)
    elevation.save(file)
    return known
