"""The recorder: every message on the bus into MCAP, wire bytes unchanged."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.log.file import CONFIG, LogWriter, is_intact
from rbtrg_robot.params import RecorderParams
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.clock import SourceClock
from rbtrg_robot.wire.heart import Heart

log = logging.getLogger(__name__)
INBOX_DEPTH = 2000
"""Messages per topic that may wait while a chunk is compressed."""


class Recorder:
    """Writes log_0.mcap, log_1.mcap, ... into one folder."""

    def __init__(
        self,
        folder: Path,
        params: RecorderParams,
        metadata: dict[str, str],
        attachments: dict[str, bytes],
        clock: SourceClock,
    ) -> None:
        """`clock` says when a message was recorded. Raises LogError when the folder cannot be written."""
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
        self._writer = self._open()
        self._opened = time.monotonic()
        self._flushed = self._opened

    def _open(self) -> LogWriter:
        return LogWriter(self._folder / f"log_{self._number}.mcap", self._metadata, self._attachments)

    def write(self, topic: t.Topic, payload: bytes, stamp: int, sequence: int) -> None:
        """One message; `stamp` is its source clock [ns]."""
        self._writer.write(topic, payload, self._clock(), stamp, sequence)

    def housekeep(self) -> None:
        """Flush and rotate when it is time."""
        now = time.monotonic()
        if now - self._flushed >= self._params.flush_period:
            self._flushed = now
            self._writer.flush()
        full = self._writer.size > self._params.rotate_megabytes * 1_000_000
        if full or now - self._opened > self._params.rotate_seconds:
            self._writer.close()
            self._number += 1
            self._opened = now
            self._writer = self._open()

    def close(self) -> None:
        """Write the index."""
        self._writer.close()


def main(
    config: StackConfig, bus: Bus, stopping: Callable[[], bool], _restored: dict[t.Topic, bytes] | None = None
) -> None:
    """The process: everything on the bus until told to stop."""
    attachments = {CONFIG: config.to_yaml().encode()}
    recorder = Recorder(Path(config.log_dir), config.recorder, config.metadata(), attachments, bus.clock)
    try:
        deep = {replace(topic, depth=INBOX_DEPTH): topic for topic in t.TOPICS if topic.recorded}
        bus.subscribe(deep)
        heart = Heart(bus, "recorder")
        while not stopping():
            heart.beat()
            for received in bus.take(0.2):
                recorder.write(deep[received.topic], received.payload, received.stamp, received.sequence)
            recorder.housekeep()
        for received in bus.take(0.0):
            recorder.write(deep[received.topic], received.payload, received.stamp, received.sequence)
    finally:
        recorder.close()
