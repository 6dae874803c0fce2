"""The recorder: every message on the bus into MCAP, wire bytes unchanged."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rbtrg_robot import topics as t
from rbtrg_robot.bus import Bus
from rbtrg_robot.logfile import CONFIG, LogError, LogWriter, is_intact, recover
from rbtrg_robot.node import Heart
from rbtrg_robot.params import RecorderParams

log = logging.getLogger(__name__)
INBOX_DEPTH = 2000
"""Messages per topic that may wait while a chunk is compressed."""


class Recorder:
    """Writes log_0.mcap, log_1.mcap, ... into one folder."""

    def __init__(
        self, folder: Path, params: RecorderParams, metadata: dict[str, str], attachments: dict[str, bytes]
    ) -> None:
        """Raises LogError when the folder cannot be written."""
        self._folder = folder
        self._params = params
        self._metadata = metadata
        self._attachments = attachments
        folder_files = list(folder.glob("log_*.mcap")) if folder.exists() else []
        for old in folder_files:  # a recorder that was killed left a file without an index
            if not is_intact(old):
                self._repair(old)
        self._number = len(folder_files)
        self._writer = self._open()
        self._opened = time.monotonic()
        self._flushed = self._opened

    @staticmethod
    def _repair(path: Path) -> None:
        fixed = path.with_suffix(".recovered")
        fixed.unlink(missing_ok=True)
        try:
            count, damage = recover(path, fixed)
        except LogError as error:
            log.warning("%s", error)
            return
        fixed.replace(path)
        log.warning("recovered %d messages of %s (%s)", count, path.name, damage or "no index")

    def _open(self) -> LogWriter:
        return LogWriter(self._folder / f"log_{self._number}.mcap", self._metadata, self._attachments)

    def write(self, topic: t.Topic, payload: bytes, stamp: int, sequence: int) -> None:
        """One message; `stamp` is its source clock [ns]."""
        self._writer.write(topic, payload, time.time_ns(), stamp, sequence)

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
    config: Any, bus: Bus, stopping: Callable[[], bool], _restored: dict[t.Topic, bytes] | None = None
) -> None:
    """The process: everything on the bus until told to stop."""
    attachments = {CONFIG: config.to_yaml().encode()}
    recorder = Recorder(Path(config.log_dir), config.recorder, config.metadata(), attachments)
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
