"""MCAP log files: writing, reading, and what can be said about one.

Profile `ros2`, CDR payloads as they were on the wire, `ros2msg` schemas, zstd chunks of 1 MiB. `log_time` is when
the message was recorded, `publish_time` its source clock; both in ns. rosbag2, Foxglove and rosbags read these files. Sweeps that are
packed (`rbtrg_robot.log.packed`) are what they were on the wire to every reader here.
"""

from __future__ import annotations

import errno
import fcntl
import io
import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import TYPE_CHECKING, BinaryIO, Self

import mcap.writer
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from hal.errors import OperatorError
from hal.regular import open_regular
from rbtrg_robot import __version__, msg
from rbtrg_robot.log.packed import pack, unpack
from rbtrg_robot.topics import SWEEPS, Qos, Topic
from rbtrg_robot.wire.messages import definition, type_hash

if TYPE_CHECKING:
    from typing_extensions import Buffer

CHUNK_BYTES = 1024 * 1024
ZSTD_LEVEL = 6
"""A tenth smaller than level 3 for 2.5 times its CPU (44 instead of 18 ms per second of an XT16 and an L1); higher levels gain 2 %."""
# mcap 1.6.0 compresses with zstd's default and has no setting; pyproject pins that version.
mcap.writer.zstandard = SimpleNamespace(compress=partial(zstandard.compress, level=ZSTD_LEVEL))  # type: ignore[assignment]
METADATA = "run"
CONFIG = "config.yaml"

# What rosbag2 stores per channel; rosbags and `ros2 bag play` want it.
_OFFERED_QOS = """- history: keep_last
  depth: 10
  reliability: {reliability}
  durability: {durability}
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""


class LogError(OperatorError):
    """A log file cannot be read or written; the message tells what to do."""


PASSING = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE)
"""Reasons of a failed write that may be gone at the next attempt: what fills a disk is often deleted again."""

LARGEST_CHUNK = 256 * 1024 * 1024
"""Bytes of a chunk that is read. Writers make them of 1 to 4 MiB; a few bytes may claim to be any number of them."""
MOST_TOPICS = 65_535
"""Of one file: MCAP numbers them with 16 bits."""
BROKEN = (
    McapError, zstandard.ZstdError, ValueError, KeyError, EOFError, MemoryError, OverflowError, RuntimeError, struct.error,
)  # fmt: skip
"""What reading a damaged file can raise; OverflowError: a length beyond 2^63; RuntimeError: of lz4."""


def _cannot_write(path: Path, error: OSError) -> LogError:
    return LogError(
        f"cannot write {path}: {error.strerror}; make room or choose another --log-dir",
        retry=error.errno in PASSING,
    )


class _LogFile(io.FileIO):
    """Unbuffered: what a flush wrote must survive the death of this process. A write that fails raises LogError."""

    def write(self, data: Buffer) -> int:
        try:
            return super().write(data)
        except OSError as error:
            raise _cannot_write(Path(str(self.name)), error) from error


@dataclass(frozen=True, slots=True)
class Entry:
    """One recorded message."""

    topic: str
    type: str
    data: bytes
    log_time: int
    publish_time: int
    sequence: int


class LogWriter:
    """One MCAP file. Deterministic: the same messages and metadata give the same bytes."""

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes] | None = None,
        *,
        pack_sweeps: bool = False,
    ) -> None:
        """Create `path`. Raises LogError."""
        self.path = path
        self._pack_sweeps = pack_sweeps
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _LogFile(path, "wb")
            fcntl.flock(self._file, fcntl.LOCK_EX)  # tells `is_being_written`; gone with this process
        except OSError as error:
            raise _cannot_write(path, error) from error
        self._stream = io.BufferedWriter(self._file)
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"rbtrg-robot {__version__}")
        self._writer.add_metadata(METADATA, dict(metadata))
        for name, data in (attachments or {}).items():
            self._writer.add_attachment(0, 0, name, "application/yaml", data)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._since_flush = 0
        self.messages = 0
        try:
            self.flush()
        except LogError:  # a file with nothing in it is no log, and its readers say so
            self._file.close()
            if path.is_file():
                path.unlink()
            raise

    def write(self, topic: Topic, data: bytes, log_time: int, publish_time: int, sequence: int = 0) -> None:
        """Append a message; times in ns."""
        packed = self._pack_sweeps and topic in SWEEPS.values()
        self._channel(topic, msg.CompressedPointCloud2.__msgtype__ if packed else topic.type)
        self._add(topic.name, pack(data) if packed else data, log_time, publish_time, sequence)

    def copy(self, entry: Entry, schema: Schema | None, channel: Channel) -> None:
        """Append a message of another file with its schema, whatever it is."""
        if entry.topic not in self._channels:
            if len(self._channels) == MOST_TOPICS:
                raise LogError(f"more than {MOST_TOPICS} topics: {self.path} cannot hold them")
            if entry.type not in self._schemas:
                self._schemas[entry.type] = (
                    self._writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                )
            self._channels[entry.topic] = self._writer.register_channel(
                channel.topic, channel.message_encoding, self._schemas[entry.type], channel.metadata
            )
        self._add(entry.topic, entry.data, entry.log_time, entry.publish_time, entry.sequence)

    def _add(self, name: str, data: bytes, log_time: int, publish_time: int, sequence: int) -> None:
        self._since_flush += 1
        self.messages += 1
        # Whatever an attachment says: MCAP holds no time before 1970 and none after 2554.
        stamp = min(max(publish_time, 0), 2**64 - 1)
        self._writer.add_message(self._channels[name], log_time, data, stamp, sequence % 2**32)

    def _channel(self, topic: Topic, typename: str) -> None:
        if topic.name in self._channels:
            return
        if typename not in self._schemas:
            self._schemas[typename] = self._writer.register_schema(
                typename, "ros2msg", definition(typename).encode()
            )
        metadata = {
            "offered_qos_profiles": _OFFERED_QOS.format(
                reliability="best_effort" if topic.qos is Qos.SENSOR else "reliable",
                durability="transient_local" if topic.qos is Qos.LATCHED else "volatile",
            ),
            "topic_type_hash": type_hash(typename),
        }
        self._channels[topic.name] = self._writer.register_channel(
            topic.name, "cdr", self._schemas[typename], metadata
        )

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._file.tell()

    def flush(self) -> None:
        """Close the current chunk and hand everything to the system: a kill after this loses nothing before it."""
        if self._since_flush:
            # A slow stream that is never flushed loses everything. mcap 1.6.0 ends a chunk by size only and has no
            # public way to end one early, so pyproject pins that version; `test_file` flushes and reads back.
            self._writer._Writer__finalize_chunk()  # type: ignore[attr-defined]
            self._since_flush = 0
        self._stream.flush()

    def close(self) -> None:
        """Write the index and close."""
        if self._file.closed:
            return
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._file.fileno())
        self._stream.close()

    def abandon(self) -> None:
        """Close without an index: what was flushed can be read, and `recover` makes an index. For a disk that takes no more."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


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
    """Messages in file order, up to the first damage; `raw`: packed sweeps as they are, to be copied. Raises LogError when it is no MCAP
    file at all."""
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
                        kind, data = msg.PointCloud2.__msgtype__, unpack(data)
                    entry = Entry(
                        channel.topic, kind, data, record.log_time, record.publish_time, record.sequence
                    )
                    count += 1
                    yield entry, schema, channel
            found.indexed = True
        except BROKEN as error:
            if not found.channels and not found.metadata:
                raise LogError(f"{path} is not an MCAP file") from error
            found.damage = f"after {count} messages: {type(error).__name__}"


def _records(stream: BinaryIO) -> Iterator[McapRecord]:
    """All records, those in chunks too, whose checksums are compared. Raises what BROKEN lists."""
    for record in StreamReader(stream, emit_chunks=True, record_size_limit=2 * LARGEST_CHUNK).records:
        if isinstance(record, Chunk):
            data = _unpacked(record)
            yield from breakup_chunk(replace(record, compression="", data=data), validate_crc=True)
        else:
            yield record


def _unpacked(chunk: Chunk) -> bytes:
    """Never more bytes than a chunk says it has, whatever its compressed data says. Raises ValueError for another number."""
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
    """The files of a run: `path` itself, or all .mcap files of a folder in order, but for those of a recorder that was killed before it
    wrote. Raises LogError."""
    if path.is_dir():
        written = [file for file in path.glob("*.mcap") if file.stat().st_size]
        files = sorted(written, key=lambda p: (len(p.name), p.name))
        if not files:
            raise LogError(f"no .mcap file in {path}")
        return files
    if not path.exists():
        raise LogError(f"there is no {path}")
    return [path]


def read_run(path: Path, contents: LogContents | None = None) -> Iterator[Entry]:
    """Messages of a file or of all files of a run's folder, in order."""
    for file in log_files(path):
        found = contents if contents is not None else LogContents()
        found.schemas.clear()
        found.channels.clear()
        for entry, _schema, _channel in read_log(file, found):
            yield entry


def first_of(path: Path) -> LogContents:
    """Metadata and attachments of a run without reading its messages."""
    contents = LogContents()
    for _ in read_log(log_files(path)[0], contents):
        break
    return contents


def recover(path: Path, out: Path) -> tuple[int, str]:
    """Write what can be read of `path` to a new, indexed file. (messages, damage found). Raises LogError."""
    if out.exists():
        raise LogError(f"{out} exists; name another file with --out")
    contents = LogContents()
    records = read_log(path, contents, raw=True)
    first = next(records, None)  # metadata and attachments stand before the first message
    with LogWriter(out, contents.metadata.get(METADATA, {}), contents.attachments) as writer:
        if first is not None:
            writer.copy(*first)
            for record in records:
                writer.copy(*record)
        return writer.messages, contents.damage


def is_being_written(path: Path) -> bool:
    """A LogWriter has it open."""
    with open_regular(path) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def is_intact(path: Path) -> bool:
    """True when a file has its index, without reading the messages."""
    try:
        with open_regular(path) as stream:
            return make_reader(stream).get_summary() is not None
    except Exception:  # noqa: BLE001 - any failure to read the summary means the same thing
        return False
