"""What a run holds, from the summaries at the end of its files: no message is read. A file without one is read
whole."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Schema, Statistics
from mcap.summary import Summary

from hal.regular import open_regular
from rbtrg_robot.log.read import (
    BROKEN,
    MCAP0_MAGIC,
    METADATA,
    LogContents,
    first_of,
    is_being_written,
    log_files,
    read_log,
)

TAIL_BYTES = 9 + 20 + len(MCAP0_MAGIC)
"""Bytes of the footer and what follows."""


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
    """Schemas, channels and statistics of a file; None where it has no summary that can be read. What tells where its
    chunks lie is left out: there are thousands of them, and each lists all channels."""
    found = Summary()
    try:
        with open_regular(path) as stream:
            stream.seek(-TAIL_BYTES, os.SEEK_END)
            tail = stream.read()
            start = Footer.read(_content(tail, 9)).summary_start
            if tail[0] != Opcode.FOOTER or tail[-len(MCAP0_MAGIC) :] != MCAP0_MAGIC or not start:
                return None
            stream.seek(start)
            section = stream.read()
        at = 0
        while at + TAIL_BYTES < len(section):
            opcode, length = struct.unpack_from("<BQ", section, at)
            at += 9
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(_content(section, at))
                found.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(_content(section, at))
                found.channels[channel.id] = channel
            elif opcode == Opcode.STATISTICS:
                found.statistics = Statistics.read(_content(section, at))
            at += length
    except (*BROKEN, OSError):
        return None
    return found if found.statistics is not None else None


def _content(section: bytes, at: int) -> ReadDataStream:
    stream = BytesIO(section)
    stream.seek(at)
    return ReadDataStream(stream)


def is_intact(path: Path) -> bool:
    """Whether a file has its index. No message is read."""
    return summary_of(path) is not None


def channels_of(path: Path) -> list[tuple[Schema | None, Channel, int]]:
    """Every channel of a file with its number of messages. Raises LogError."""
    return [(schema, channel, count) for schema, channel, count, *_ in _channels(path, LogContents())]


def overview(path: Path, *, quick: bool = False) -> Overview:
    """Of a file, or of all files of a run's folder. `quick`: files without a summary are named and not read, but for
    the beginning of the first. Raises LogError."""
    files = log_files(path)
    found = Overview([file.name for file in files], first_of(path).metadata.get(METADATA, {}))
    for file in files:
        contents = LogContents()
        found.size += file.stat().st_size
        if quick and not is_intact(file):
            if file is files[0]:
                found.begin = next((entry.log_time for entry, *_ in read_log(file, raw=True)), 0)
            if is_being_written(file):
                found.unfinished.append(file.name)
            else:
                found.damage.append(f"{file.name} has no index; `rbtrg-robot log recover` makes one")
            continue
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
    """Schema, channel, messages, and first and last message of the file [ns]. `contents` tells damage where the file
    was read."""
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
