"""The whole elevation map: asked for until it comes, and written to a file by who asked."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import MapError, MapPatch
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import read_areas, to_text
from rbtrg_robot.orders.order import Order, Outcome
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import LayoutError, as_prior, cloud_points, map_patch
from rbtrg_robot.wire.messages import header, stamp_of

if TYPE_CHECKING:
    from mapping.elevation.export import Limits

ASK_AGAIN, TIME_LIMIT = 3.0, 15.0
"""[s] between two requests, and until it is given up."""


class FetchMap(Order):
    """The present map as patches, and its cloud, which comes before them."""

    hears = (t.AREAS, t.MAP_CLOUD, t.MAP_PARTS)
    sends = (t.MAP_REQUEST,)

    def __init__(self) -> None:
        super().__init__(ASK_AGAIN, TIME_LIMIT)
        self.patches: list[MapPatch] = []
        """All of it, once the outcome is there."""
        self._parts: dict[int, MapPatch] = {}
        self._sending = 0
        self._heard = -math.inf
        self.cloud = np.empty((0, 3), np.float32)
        self.areas: list[msg.GroundArea] = []
        """Drawn on it."""

    def message(self) -> tuple[Topic, msg.Message] | None:
        """The request, unless parts are coming."""
        if time.monotonic() - self._heard < ASK_AGAIN:
            return None
        return t.MAP_REQUEST, msg.MapRequest(header=header(time.time_ns(), ""), action="parts")

    def take(self, topic: Topic, message: Any) -> None:
        """A cloud or a MapPart; one that is broken is none, and all are asked for again."""
        with contextlib.suppress(LayoutError):
            if t.AREAS.carried(message, topic):
                self.areas = message.areas
                return
            if t.MAP_CLOUD.carried(message, topic):
                self.cloud = cloud_points(message)
                return
            stamp = stamp_of(message)
            if stamp != self._sending:
                self._sending, self._parts = stamp, {}
            self._parts[message.part] = map_patch(message.map, 0)
            self._heard = self.began = time.monotonic()
            if len(self._parts) == message.parts:
                self.patches = list(self._parts.values())
                self.outcome = Outcome(True, "")

    def silence(self) -> Outcome:
        """Elevation is gone."""
        return Outcome(False, "the elevation process sends no map; see `rbtrg-robot status`")


class ForgetTouched(Order):
    """What the robot touched is forgotten."""

    hears = (t.MAP_STATUS,)
    sends = (t.MAP_REQUEST,)

    def __init__(self) -> None:
        super().__init__(ASK_AGAIN, TIME_LIMIT)

    def message(self) -> tuple[Topic, msg.Message] | None:
        """The request."""
        return t.MAP_REQUEST, msg.MapRequest(header=header(time.time_ns(), ""), action="clear")

    def take(self, topic: Topic, message: Any) -> None:
        """A MapStatus."""
        if message.touched == 0 and not math.isinf(self._sent):
            self.outcome = Outcome(True, "nothing counts as touched")

    def silence(self) -> Outcome:
        """Elevation is gone."""
        return Outcome(False, "the elevation process does not answer; see `rbtrg-robot status`")


class LoadMap(Order):
    """A prior map, sent until the elevation process has begun anew with it. One of the running run, with its loops
    closed, is waited for while the robot glides to where it is in it."""

    hears = (t.MAP_STATUS,)
    sends = (t.MAP_PRIOR,)

    def __init__(self, prior: msg.MapPrior) -> None:
        super().__init__(ASK_AGAIN, TIME_LIMIT)
        self._prior = prior
        self._epoch: int | None = None
        self._said = ""

    def message(self) -> tuple[Topic, msg.Message] | None:
        """The map, once it is known which one is there now."""
        return None if self._epoch is None else (t.MAP_PRIOR, self._prior)

    def take(self, topic: Topic, message: Any) -> None:
        """A MapStatus."""
        self._said = message.detail
        closes = len(self._prior.odom_in_map) > 0
        if self._epoch is None:
            self._epoch = int(message.epoch)
        elif message.location == "closing":
            self.began = self._sent = time.monotonic()
        elif (message.epoch > self._epoch or closes) and message.prior == self._prior.id:
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
    return replace(as_prior(elevation, time.time_ns(), fingerprint(str(file))), areas=read_areas(file))


def save(
    patches: list[MapPatch],
    cloud: NDArray[np.float32],
    file: Path,
    limits: Limits | None = None,
    areas: Sequence[msg.GroundArea] = (),
) -> int:
    """Write it as `up --map` reads it, with `limits` as other programs do (see `mapping.elevation.export`); returns the
    number of known cells. `areas` stand in .npz alone. Raises OSError, MapError."""
    from mapping.elevation.export import write
    from mapping.elevation.map import ElevationMap

    try:
        config = ElevationConfig(resolution=patches[0].resolution)
    except ValidationError as error:
        raise MapError(f"a map with cells of {patches[0].resolution:g} m came: it is not kept") from error
    elevation = ElevationMap(config)
    known = sum(map(elevation.restore, patches))
    elevation.cloud.enter(cloud)
    if limits is not None:
        return write(elevation, file, limits)
    elevation.save(file, to_text(areas))
    return known
