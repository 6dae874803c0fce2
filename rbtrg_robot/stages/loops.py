"""Loops of a run, found and closed while it goes on: poses and clouds in, its map with the loops closed out each time
that one closes. `rbtrg_robot.stages.closing` tells what becomes of it."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hal.types import NS
from mapping.closing import Closed, Closing, Recording, corrected, fusing
from mapping.closing.graph import after, between, levelled
from mapping.elevation.map import ElevationMap
from mapping.relocalise import warm_up
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.stages.reader import Reader
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import as_prior
from rbtrg_robot.wire.frames import closed_map

AT_ONCE = 5
"""Scans that are fused in a tick."""
SEND_AGAIN, SEND_LIMIT = 3 * NS, 15 * NS
"""A map is sent anew so long after, and given up when nobody has taken it for so long [ns]."""
SCAN_FILE, ORIGIN_FILE = "loops.scans", "loops.json"
"""In the run's folder while the process lives: what it recorded, and of which map."""
NEAR_ORIGIN = 1.0
"""Odometry that begins further from its origin [m] began before this process: the map holds what it never saw."""


class LoopStage:
    """In: what elevation maps. Out: the map of the run, made anew along the way that its loops correct.

    It works a fraction of a second a tick, and hears what comes between. What it recorded lies in the run's folder
    until it ends: one that is started anew goes on with it. In a map that somebody loaded it finds no loops: the robot
    finds itself there.
    """

    outputs = (t.MAP_CLOSED,)

    def __init__(self, config: StackConfig) -> None:
        self._config = config
        self._folder: Path | None = None
        self._frames = msg.TFMessage()
        self._status = msg.MapStatus()
        self._heard = self._anew = False
        """A status came; all of the map is in the recording."""
        self.recording = Recording()
        self._begin(0)
        self.inputs = (*self._reader.inputs, t.MAP_STATUS)

    def warm_up(self) -> None:
        """Nothing waits for this process."""

    def warm_up_rest(self) -> None:
        """The search."""
        warm_up()

    def put_on(self, folder: Path) -> None:
        """See `KeepsMap`."""
        self._folder = folder

    def close(self) -> None:
        """The recording goes."""
        self.recording.close()
        if self._folder is not None:
            (self._folder / ORIGIN_FILE).unlink(missing_ok=True)

    def _begin(self, epoch: int) -> None:
        """A map begins, or goes on that the process before this one recorded."""
        self.recording.close()
        origin = self._origin_of(epoch)
        path = None if self._folder is None else self._folder / SCAN_FILE
        if path is not None and origin is None:
            path.unlink(missing_ok=True)
        self.recording = Recording(path=path)
        self._reader = Reader(self.recording, 0, self._config, origin)
        self._reader.take(t.TF_STATIC, self._frames)
        self._anew |= origin is not None
        self._work = self._works(self.recording)
        self.closed: Closed | None = None
        """What was known when the stack took the newest map from here,"""
        self.taken = ""
        """and that map's id."""
        self._made: tuple[msg.MapPrior, Closed] | None = None
        """A map that the stack does not have yet, and what was known."""
        self._sent = self._since = 0
        """When it was, and since when nobody has taken it [ns]."""
        self._over = False
        """The disk is full."""

    def _origin_of(self, epoch: int) -> list[float] | None:
        """Where `odom` lay in `map` at the first scan of a recording of this map: x, y, z [m], yaw [rad]."""
        with contextlib.suppress(OSError, ValueError, KeyError):
            if self._folder is not None and not self._heard:
                kept = json.loads((self._folder / ORIGIN_FILE).read_text())
                return kept["origin"] if kept["epoch"] == epoch else None
        return None

    @property
    def _idle(self) -> bool:
        """Nothing is to be done: no map yet, the disk is full, or somebody loaded a map."""
        prior = self._status.prior
        return not self._heard or self._over or bool(prior and not prior.startswith(t.MAP_CLOSED.name))

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        try:
            if t.MAP_STATUS.carried(message, topic):
                if not self._heard or message.epoch != self._status.epoch:
                    self._anew |= self._heard
                    self._begin(message.epoch)
                self._status, self._heard = message, True
                return []
            if t.TF_STATIC.carried(message, topic):
                self._frames = message
            if not self._idle:
                first = not self.recording.scans
                self._reader.take(topic, message)
                if first and self.recording.scans and self._folder is not None:
                    kept = {"epoch": self._status.epoch, "origin": self._reader.origin.tolist()}
                    (self._folder / ORIGIN_FILE).write_text(json.dumps(kept))
        except OSError:
            self._over = True
        return []

    def tick(self, now: int) -> Outputs:
        """A piece of work, or a map that the stack is to have."""
        if self._idle:
            return []
        if self._made is None:
            try:
                next(self._work)
            except OSError:
                self._over = True
            if self._made is None:
                return []
            self._sent, self._since = 0, now
        prior, closed = self._made
        if self._status.prior == prior.id:
            self._made, self.closed, self.taken = None, closed, prior.id
        elif self._status.location == "closing":
            self._since = now
        elif now - self._since > SEND_LIMIT:
            self._made = None
        elif now - self._sent > SEND_AGAIN:
            self._sent = now
            return [(t.MAP_CLOSED, prior)]
        return []

    def _works(self, recording: Recording) -> Iterator[None]:
        """All there is to do, without end."""
        known = len(recording.scans)
        while not recording.scans:
            yield
        if not self._anew and math.hypot(*recording.scans[0].pose[:2, 3]) > NEAR_ORIGIN:
            while True:
                yield
        settings = self._config.loops
        closing = Closing(recording, self._config.elevation, self._reader.origin, settings.drift)
        for closed in closing.follow(known):
            if closed is None:
                yield
            elif self._moves(closed) >= settings.least:
                yield from self._make(recording, closed)

    def _moves(self, closed: Closed) -> float:
        """The farthest [m] that a keyframe is from where the stack's map has it; infinite where somebody else closed
        that map."""
        if self._status.prior != self.taken:
            return math.inf
        held = closed.driven[:1] if self.closed is None else self.closed.nodes
        places = np.array([frame.place for frame in closed.keyframes])
        last = len(held) - 1
        follow = after(held[last], between(places[last], places[last + 1 :]))
        off = np.vstack([held, follow]) - closed.nodes
        return float(np.linalg.norm(off[:, :3], axis=1).max())

    def _make(self, recording: Recording, closed: Closed) -> Iterator[None]:
        """The map along the way of so far."""
        made = ElevationMap(self._config.elevation)
        if self._folder is not None:
            made.put_on(self._folder)
        scans, higher = recording.scans[:], self._status.height_correction
        poses = corrected(scans, closed.keyframes, closed.nodes)
        for n, _ in enumerate(fusing(made, recording, poses, range(len(scans))), 1):
            if n % AT_ONCE == 0:
                yield
        last, pose = scans[-1], poses[-1]
        pose[2, 3] += made.alignment.height
        here = levelled(last.pose)
        prior = as_prior(made, last.stamp, f"{t.MAP_CLOSED.name}:{last.stamp}")
        self._made = closed_map(prior, levelled(pose), here, higher, last.stamp), closed


def build(config: StackConfig) -> LoopStage:
    """From the stack's configuration."""
    return LoopStage(config)
