"""The photos of a run: frames of its camera that a mission or a person wanted kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader

from hal.regular import open_regular
from rbtrg_robot import topics as t
from rbtrg_robot.log.read import BROKEN, log_files, read_log
from rbtrg_robot.log.summary import summary_of
from rbtrg_robot.wire.messages import MessageError, decode, stamp_of


@dataclass(frozen=True, slots=True)
class Photo:
    """One."""

    stamp: int
    """[ns] of the exposure."""
    jpeg: bytes

    @property
    def name(self) -> str:
        """Of its file, and of itself."""
        return f"{self.stamp}.jpg"


def photos(log: Path) -> Iterator[Photo]:
    """Of a file or a run's folder, in their order. Files without one are not read, where they have an index. Raises
    LogError."""
    for file in log_files(log):
        for data in _of(file):
            try:
                message = decode(data, t.PHOTO.kind)
            except MessageError:
                continue  # recorded broken
            yield Photo(stamp_of(message), message.data.tobytes())


def _of(file: Path) -> Iterator[bytes]:
    """Payloads of a file."""
    summary = summary_of(file)
    if summary is None or summary.statistics is None:
        for entry, *_ in read_log(file):
            if entry.topic == t.PHOTO.name:
                yield entry.data
        return
    counts = summary.statistics.channel_message_counts
    if not any(counts.get(k) for k, channel in summary.channels.items() if channel.topic == t.PHOTO.name):
        return
    try:
        with open_regular(file) as stream:
            for _, _, message in make_reader(stream).iter_messages(topics=[t.PHOTO.name]):
                yield message.data
    except BROKEN:
        return  # `log check` tells of it


def save(log: Path, folder: Path) -> list[Path]:
    """Write each photo of a run as a file into a folder. Raises LogError, OSError."""
    written = []
    for photo in photos(log):
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / photo.name
        path.write_bytes(photo.jpeg)
        written.append(path)
    return written
