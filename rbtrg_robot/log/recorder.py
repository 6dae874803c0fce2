"""The recorder: every message on the bus into MCAP, wire bytes unchanged but for sweeps of the profile `standard`,
which are packed."""

from __future__ import annotations

import logging
import math
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.log.bag import NAME as METADATA_YAML
from rbtrg_robot.log.bag import describe
from rbtrg_robot.log.keep import GIGABYTE, mark, prune
from rbtrg_robot.log.moments import HEARS, Moments, Thinned
from rbtrg_robot.log.read import CONFIG, LogError
from rbtrg_robot.log.summary import is_intact
from rbtrg_robot.log.write import LogWriter
from rbtrg_robot.msg import MissionState
from rbtrg_robot.stage_config import RecorderConfig
from rbtrg_robot.wire.bus import Bus, Received
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.heart import Heart

log = logging.getLogger(__name__)
INBOX_DEPTH = 2000
"""Messages per topic that may wait while a chunk is compressed."""


RETRY_AFTER = 5.0
"""[s] until a recorder that had to stop tries again."""
BULKY = frozenset({*t.SWEEPS.values(), *t.CLOUDS.values()})
"""Topics that go first when space is short."""
PICTURE_PERIOD = 1.0
"""[s] between two pictures in the log, in the profile `standard`."""
LEAST_SPARE = 0.1
"""Share of the spare space below which nothing is recorded."""


class Recorder:
    """Writes log_0.mcap, log_1.mcap, ... into one folder. A full disk stops the recording, never the process."""

    def __init__(
        self,
        folder: Path,
        params: RecorderConfig,
        metadata: dict[str, str],
        attachments: dict[str, bytes],
        clock: SourceClock,
    ) -> None:
        """`clock` says when a message was recorded. Raises LogError when the folder cannot be written; a disk that is
        full now is waited for."""
        self._clock = clock
        self._folder = folder
        self._params = params
        self._metadata = metadata
        self._attachments = attachments
        older = [path for path in folder.glob("log_*.mcap") if path.stem[4:].isdigit()]
        for path in older:  # of a recorder that was killed; recording goes on at once, mending can wait
            if not is_intact(path):
                log.warning("%s has no index: `rbtrg-robot log recover` makes one", path.name)
        self._number = 1 + max((int(path.stem[4:]) for path in older), default=-1)
        self._opened = self._flushed = time.monotonic()
        self._retry = 0.0
        self._free_due = 0.0
        self._free = math.inf
        self._closing: list[threading.Thread] = []
        self._describing = threading.Lock()
        self.trouble = ""
        """What an operator should know, in plain words; empty when everything is recorded."""
        self.left_out = 0
        """Messages that were not recorded for want of space."""
        self._moments, self._pictures = Moments(), Thinned(PICTURE_PERIOD)
        self._latched: dict[t.Topic, tuple[bytes, int, int]] = {}
        """Newest of each latched topic: who begins with a later file needs the frames and the robot's description, too.
        """
        self._writer: LogWriter | None = None
        try:
            self._writer = self._open()
        except LogError as error:
            if not error.retry:
                raise
            self._give_up(str(error))

    def _open(self) -> LogWriter:
        writer = LogWriter(
            self._folder / f"log_{self._number}.mcap",
            self._metadata,
            self._attachments,
            pack_sweeps=self._params.profile == "standard",
        )
        try:
            for topic, (payload, stamp, sequence) in self._latched.items():
                writer.write(topic, payload, self._clock(), stamp, sequence)
        except LogError:
            writer.abandon()
            raise
        return writer

    def take(self, received: Received[Any], decode: Callable[[Received[Any]], Any]) -> None:
        """One message as it came. Pictures are thinned, but for those around a moment that somebody will look at."""
        now = time.monotonic()
        if received.topic in HEARS and self._moments.begins(received.topic, decode(received)):
            for kept in self._pictures.moment(now):
                self.write(kept.topic, kept.payload, kept.stamp, kept.sequence)
        thin = received.topic.thinned and self._params.profile != "full"
        for kept in self._pictures.take(received, now) if thin else (received,):
            self.write(kept.topic, kept.payload, kept.stamp, kept.sequence)

    def write(self, topic: t.Topic, payload: bytes, stamp: int, sequence: int) -> None:
        """One message; `stamp` is its source clock [ns]."""
        if topic.qos is t.Qos.LATCHED:
            self._latched[topic] = payload, stamp, sequence
        if self._writer is None or (topic in BULKY and self._free < self._params.spare_gb * GIGABYTE):
            self.left_out += 1
            return
        try:
            self._writer.write(topic, payload, self._clock(), stamp, sequence)
        except LogError as error:
            self.left_out += 1
            self._give_up(str(error))

    def housekeep(self) -> None:
        """Look at the disk, flush and rotate when it is time."""
        now = time.monotonic()
        if now >= self._free_due:
            self._free_due = now + 1.0
            self._look()
        if self._writer is None:
            if now >= self._retry and not self._full:
                self._begin(now)
            return
        try:
            if now - self._flushed >= self._params.flush_period:
                self._flushed = now
                self._writer.flush()
        except LogError as error:
            self._give_up(str(error))
            return
        big = self._writer.size > self._params.rotate_megabytes * 1_000_000
        if big or now - self._opened > self._params.rotate_seconds:
            self._retire(self._writer, tidy=True)
            self._begin(now)

    @property
    def _full(self) -> bool:
        return self._free < LEAST_SPARE * self._params.spare_gb * GIGABYTE

    def _look(self) -> None:
        """Free space, and what it means."""
        try:
            self._free = shutil.disk_usage(self._folder).free
        except OSError as error:
            self._give_up(f"cannot read {self._folder}: {error.strerror}")
            return
        if self._writer is None and not self._full:
            return  # why it stopped stays told until it records again
        self.trouble = ""
        left = f"{self._free / GIGABYTE:.1f} GB are left on the disk of the log"
        if self._full:
            self._give_up(f"nothing is recorded: {left}; make room")
        elif self._free < self._params.spare_gb * GIGABYTE:
            self.trouble = f"clouds are not recorded: {left}; make room"

    def _begin(self, now: float) -> None:
        """A new file."""
        self._number += 1
        self._opened = now
        try:
            self._writer = self._open()
        except LogError as error:
            self._writer = None
            self._give_up(str(error))

    def _give_up(self, why: str) -> None:
        """Stop for now: the process lives on, tells why, and tries again."""
        if self.trouble != why:
            log.warning("%s", why)
        self.trouble = why
        self._retry = time.monotonic() + RETRY_AFTER
        if self._writer is not None:
            self._writer.abandon()
            self._writer = None

    def _retire(self, writer: LogWriter, *, tidy: bool = False) -> None:
        """Index a full file, wait for the disk and remove old runs beside the recording: each can take longer than a
        heartbeat may."""

        def close() -> None:
            try:
                writer.close()
            except (LogError, OSError) as error:
                log.warning("%s", error)
                writer.abandon()
            try:
                with self._describing:  # the last one finds all files closed
                    describe(self._folder)
            except (LogError, OSError) as error:
                log.warning("no %s: %s", METADATA_YAML, error)
            if tidy:
                prune(self._folder.parent, self._params.keep_gb, spare=self._folder)

        self._closing = [thread for thread in self._closing if thread.is_alive()]
        self._closing.append(threading.Thread(target=close, name="close log"))
        self._closing[-1].start()

    def close(self) -> None:
        """Write the index."""
        if self._writer is not None:
            self._retire(self._writer)
        for thread in self._closing:
            thread.join()


def main(
    config: StackConfig, bus: Bus, stopping: Callable[[], bool], _restored: dict[t.Topic, bytes] | None = None
) -> None:
    """The process: everything on the bus until told to stop."""
    attachments = {CONFIG: config.to_yaml().encode()}
    recorder = Recorder(Path(config.log_dir), config.recorder, config.metadata(), attachments, bus.clock)
    try:
        deep = {
            replace(topic, depth=INBOX_DEPTH): topic
            for topic in t.TOPICS
            if config.recorder.profile in topic.recorded.split()
        }
        bus.subscribe(deep)
        heart = Heart(bus, "recorder")
        while not stopping():
            heart.beat(detail=recorder.trouble)
            for received in bus.take(0.2):
                recorder.take(replace(received, topic=deep[received.topic]), bus.open)
                if deep[received.topic] is t.MISSION_STATE:
                    keep_recorded(Path(config.log_dir), bus.open(received))
            recorder.housekeep()
        for received in bus.take(0.0):
            recorder.take(replace(received, topic=deep[received.topic]), bus.open)
    finally:
        recorder.close()


def keep_recorded(folder: Path, state: MissionState | None) -> None:
    """Mark the run in which a mission recorded something: its step `record` is why somebody wants it."""
    steps = zip(state.action_type, state.action_status, strict=True) if state else ()
    if any(kind == "record" and status in ("RUNNING", "FINISHED") for kind, status in steps):
        mark(folder)
