"""Reading of MCAP logs up to their first damage. Packed sweeps (`rbtrg_robot.log.packed`) are unpacked for every
reader here."""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from hal.errors import OperatorError
from hal.regular import open_regular
from rbtrg_robot import msg
from rbtrg_robot.log.packed import ForeignError, unpack

MCAP0_MAGIC = b"\x89MCAP0\r\n"
METADATA = "run"
CONFIG = "config.yaml"
LARGEST_CHUNK = 256 * 1024 * 1024
"""Bytes of a chunk that is read. Writers make them of 1 to 4 MiB; a few bytes may claim to be any number of them."""
BROKEN = (
    McapError, zstandard.ZstdError, ValueError, KeyError, EOFError, MemoryError, OverflowError, RuntimeError,
    struct.error,
)  # fmt: skip
"""What reading a damaged file can raise; OverflowError: a length beyond 2^63; RuntimeError: of lz4."""


class LogError(OperatorError):
    """A log file cannot be read or written; the message tells what to do."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One recorded message."""

    topic: str
    type: str
    data: bytes
    log_time: int
    publish_time: int
    sequence: int


@dataclass(slots=True)
class LogContents:
    """Findings of a pass over a file besides its messages; filled while `messages` runs."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    damage: str = ""
    """Where and why reading ended early; empty for an intact file."""
    indexed: bool = False
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)


def read_log(
    path: Path, contents: LogContents | None = None, *, raw: bool = False
) -> Iterator[tuple[Entry, Schema | None, Channel]]:
    """Messages in file order, up to the first damage; `raw`: packed sweeps stay packed, to be copied. Raises LogError
    for a file that is no MCAP."""
    found = contents if contents is not None else LogContents()
    try:
        stream = open_regular(path)
    except OSError as error:
        raise LogError(f"cannot read {path}: {error.strerror}") from error
    with stream:
        count = 0
        try:
            for record in _records(stream):
                if isinstance(record, Schema):
                    found.schemas[record.id] = record
                elif isinstance(record, Channel):
                    found.channels[record.id] = record
                elif isinstance(record, Metadata):
                    found.metadata[record.name] = dict(record.metadata)
                elif isinstance(record, Attachment):
                    found.attachments[record.name] = record.data
                elif isinstance(record, Message):
                    channel = found.channels[record.channel_id]
                    schema = found.schemas.get(channel.schema_id)
                    kind, data = schema.name if schema else "", record.data
                    if not raw and kind == msg.CompressedPointCloud2.__msgtype__:
                        with suppress(ForeignError):  # packed by another program: as it is
                            kind, data = msg.PointCloud2.__msgtype__, unpack(data)
                    entry = Entry(
                        channel.topic, kind, data, record.log_time, record.publish_time, record.sequence
                    )
                    count += 1
                    yield entry, schema, channel
            found.indexed = True
            stream.seek(-len(MCAP0_MAGIC), os.SEEK_END)
            if stream.read() != MCAP0_MAGIC:
                found.damage = (
                    f"after {count} messages: more bytes stand behind its end, and other programs refuse it"
                )
        except BROKEN as error:
            if not found.channels and not found.metadata:
                raise LogError(_refusal(path, stream)) from error
            found.damage = f"after {count} messages: {type(error).__name__}"


def _refusal(path: Path, stream: BinaryIO) -> str:
    stream.seek(0)
    if stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
        return f"{path} is an MCAP file that ends, or is damaged, before its first message"
    return f"{path} is not an MCAP file; `rbtrg-robot import` reads rosbag2 (.db3) and ROS 1 (.bag)"


def _records(stream: BinaryIO) -> Iterator[McapRecord]:
    """All records, those in chunks too, whose checksums are compared. Raises what BROKEN lists."""
    for record in StreamReader(stream, emit_chunks=True, record_size_limit=2 * LARGEST_CHUNK).records:
        if isinstance(record, Chunk):
            data = _unpacked(record)
            yield from breakup_chunk(replace(record, compression="", data=data), validate_crc=True)
        else:
            yield record


def _unpacked(chunk: Chunk) -> bytes:
    """Never more bytes than a chunk claims, whatever its compressed data says. Raises ValueError for another number."""
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r}")
    if len(data) != size:
        raise ValueError(f"a chunk of {size} bytes has {len(data)}")
    return data


def log_files(path: Path) -> list[Path]:
    """The files of a run: `path` itself, or all .mcap files of a folder in order, except those of a recorder that was
    killed before it wrote. Raises LogError."""
    if path.is_dir():
        written = [file for file in path.glob("*.mcap") if file.stat().st_size]
        files = sorted(written, key=lambda p: (len(p.name), p.name))
        if not files:
            others = [name for end in ("db3", "bag") for name in path.glob(f"*.{end}*")]
            foreign = "; `rbtrg-robot import` reads the bag that is there" if others else ""
            raise LogError(f"no .mcap file in {path}{foreign}")
        return files
    if not path.exists():
        raise LogError(f"there is no {path}")
    return [path]


def read_run(path: Path, contents: LogContents | None = None, *, raw: bool = False) -> Iterator[Entry]:
    """Messages of a file or of all files of a run's folder, in order; `raw`: see `read_log`."""
    for file in log_files(path):
        found = contents if contents is not None else LogContents()
        found.schemas.clear()
        found.channels.clear()
        for entry, _schema, _channel in read_log(file, found, raw=raw):
            yield entry


def first_of(path: Path) -> LogContents:
    """Metadata and attachments of a run without reading its messages."""
    contents = LogContents()
    for _ in read_log(log_files(path)[0], contents):
        break
    return contents


def is_being_written(path: Path) -> bool:
    """A LogWriter has it open."""
    with open_regular(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
