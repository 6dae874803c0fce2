"""The whole elevation map: asked for until it comes, and written to a file by who asked."""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import MapPatch
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP, LayoutError, cloud_msg, cloud_points, map_patch, patch_msg
from rbtrg_robot.wire.messages import header

AGAIN, LIMIT = 3.0, 15.0
"""[s] between two requests, and until it is given up."""


class FetchMap(Order):
    """The present map as a patch, and its cloud, which comes before it."""

    hears = (t.MAP_CLOUD, t.MAP_FULL)
    sends = (t.MAP_REQUEST,)

    def __init__(self) -> None:
        super().__init__(AGAIN, LIMIT)
        self.patch: MapPatch | None = None
        self.cloud = np.empty((0, 3), np.float32)

    def message(self) -> tuple[Topic, msg.Message]:
        """The request."""
        return t.MAP_REQUEST, msg.MapRequest(header=header(time.time_ns(), ""), action="full")

    def take(self, topic: Topic, message: Any) -> None:
        """A cloud or a GridMap; one that is broken is none, and it is asked for again."""
        with contextlib.suppress(LayoutError):
            if t.MAP_CLOUD.carried(message, topic):
                self.cloud = cloud_points(message)
                return
            self.patch = map_patch(message, 0)
            self.outcome = Outcome(True, "")

    def silence(self) -> Outcome:
        """Elevation is gone."""
        return Outcome(False, "the elevation process sends no map; see `rbtrg-robot status`")


class LoadMap(Order):
    """A prior map, sent until the elevation process has begun anew with it."""

    hears = (t.MAP_STATUS,)
    sends = (t.MAP_PRIOR,)

    def __init__(self, prior: msg.MapPrior) -> None:
        super().__init__(AGAIN, LIMIT)
        self._prior = prior
        self._epoch: int | None = None
        self._said = ""

    def message(self) -> tuple[Topic, msg.Message] | None:
        """The map, once it is known which one is there now."""
        return None if self._epoch is None else (t.MAP_PRIOR, self._prior)

    def take(self, topic: Topic, message: Any) -> None:
        """A MapStatus."""
        self._said = message.detail
        if self._epoch is None:
            self._epoch = int(message.epoch)
        elif message.epoch > self._epoch and message.prior == self._prior.id:
            self.outcome = Outcome(True, message.detail)
        elif "not loaded" in message.detail and not math.isinf(self._sent):
            self.outcome = Outcome(False, message.detail)

    def silence(self) -> Outcome:
        """Elevation does not take it."""
        return Outcome(False, self._said or "the elevation process does not answer; see `rbtrg-robot status`")


def read(file: Path, config: ElevationConfig) -> msg.MapPrior:
    """A map file as it is sent. Raises MapError."""
    from mapping.elevation.map import ElevationMap

    elevation = ElevationMap(config)
    elevation.load_prior(file)
    patch = replace(elevation.full(), stamp=time.time_ns())
    stamp = header(patch.stamp, MAP)
    cloud = cloud_msg(patch.stamp, MAP, elevation.cloud.points)
    return msg.MapPrior(header=stamp, id=fingerprint(str(file)), map=patch_msg(patch), cloud=cloud)


def save(patch: MapPatch, cloud: NDArray[np.float32], file: Path) -> int:
    """Write it as `up --map` reads it; returns the number of known cells."""
    from mapping.elevation.map import ElevationMap

    elevation = ElevationMap(ElevationConfig(resolution=patch.resolution))
    known = elevation.restore(patch)
    elevation.cloud.enter(cloud)
    elevation.save(file)
    return known
