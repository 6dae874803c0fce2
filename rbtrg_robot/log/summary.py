"""What a run holds, from the summaries at the end of its files: no message is read. A file without one is read whole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.summary import Summary

from hal.regular import open_regular
from rbtrg_robot.log.read import (
    BROKEN,
    METADATA,
    LogContents,
    first_of,
    is_being_written,
    log_files,
    read_log,
)


@dataclass(slots=True)
class Held:
    """One topic of a run."""

    type: str
    encoding: str
    """Of its messages: `cdr`, or another program's."""
    count: int = 0
    rate: float = 0.0
    """Mean over the run [Hz]."""


@dataclass(slots=True)
class Overview:
    """A run at a glance."""

    files: list[str]
    metadata: dict[str, str]
    topics: dict[str, Held] = field(default_factory=dict)
    begin: int = 0
    end: int = 0
    """First and last message [ns of the log]."""
    size: int = 0
    """Bytes of all files."""
    damage: list[str] = field(default_factory=list)
    unfinished: list[str] = field(default_factory=list)
    """Files that are being written: their end is no damage."""

    @property
    def seconds(self) -> float:
        """From the first message to the last."""
        return (self.end - self.begin) / 1e9


def summary_of(path: Path) -> Summary | None:
    """The summary of a file; None where it has none that can be read."""
    try:
        with open_regular(path) as stream:
            summary = make_reader(stream).get_summary()
    except (*BROKEN, OSError):
        return None
    return summary if summary is not None and summary.statistics is not None else None


def is_intact(path: Path) -> bool:
    """Whether a file has its index. No message is read."""
    return summary_of(path) is not None


def channels_of(path: Path) -> list[tuple[Schema | None, Channel, int]]:
    """Every channel of a file with its number of messages. Raises LogError."""
    return [(schema, channel, count) for schema, channel, count, *_ in _channels(path, LogContents())]


def overview(path: Path) -> Overview:
    """Of a file, or of all files of a run's folder. Raises LogError."""
    files = log_files(path)
    found = Overview([file.name for file in files], first_of(path).metadata.get(METADATA, {}))
    for file in files:
        contents = LogContents()
        found.size += file.stat().st_size
        for schema, channel, count, begin, end in _channels(file, contents):
            held = found.topics.setdefault(
                channel.topic, Held(schema.name if schema else "", channel.message_encoding)
            )
            held.count += count
            if count:
                found.begin = min(found.begin or begin, begin)
                found.end = max(found.end, end)
        if is_being_written(file):
            found.unfinished.append(file.name)
        elif contents.damage:
            found.damage.append(f"{file.name} ends {contents.damage}; `rbtrg-robot log recover` repairs it")
    for held in found.topics.values():
        held.rate = (held.count - 1) / found.seconds if found.seconds > 0 and held.count else 0.0
    return found


def _channels(path: Path, contents: LogContents) -> Iterator[tuple[Schema | None, Channel, int, int, int]]:
    """Schema, channel, messages, and first and last message of the file [ns]. `contents` tells damage where the file was read."""
    summary = summary_of(path)
    if summary is not None and summary.statistics is not None:
        told = summary.statistics
        for number, channel in summary.channels.items():
            count = told.channel_message_counts.get(number, 0)
            yield (
                summary.schemas.get(channel.schema_id),
                channel,
                count,
                told.message_start_time,
                told.message_end_time,
            )
        return
    counts: dict[int, int] = {}
    begin = end = 0
    for entry, _schema, channel in read_log(path, contents, raw=True):
        counts[channel.id] = counts.get(channel.id, 0) + 1
        begin = min(begin or entry.log_time, entry.log_time)
        end = max(end, entry.log_time)
    for number, channel in contents.channels.items():
        yield contents.schemas.get(channel.schema_id), channel, counts.get(number, 0), begin, end
