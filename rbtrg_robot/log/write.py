"""Writing of MCAP logs.

Profile `ros2`, CDR payloads as they were on the wire, `ros2msg` schemas, zstd chunks of 1 MiB. `log_time` is when
the message was recorded, `publish_time` its source clock; both in ns. rosbag2, Foxglove and rosbags read these files.
"""

from __future__ import annotations

import errno
import fcntl
import io
import os
from collections.abc import Mapping
from functools import partial
from itertools import chain
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import TYPE_CHECKING, Self

import mcap.writer
import zstandard
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from rbtrg_robot import __version__, msg
from rbtrg_robot.log.packed import pack
from rbtrg_robot.log.read import METADATA, Entry, LogContents, LogError, log_files, read_log
from rbtrg_robot.topics import SWEEPS, Qos, Topic
from rbtrg_robot.wire.messages import definition, type_hash

if TYPE_CHECKING:
    from typing_extensions import Buffer

CHUNK_BYTES = 1024 * 1024
ZSTD_LEVEL = 6
"""A tenth smaller than level 3 for 2.5 times its CPU (44 instead of 18 ms per second of an XT16 and an L1); higher
levels gain 2 %."""
# mcap 1.6.0 compresses with zstd's default and has no setting; pyproject pins that version.
mcap.writer.zstandard = SimpleNamespace(compress=partial(zstandard.compress, level=ZSTD_LEVEL))  # type: ignore[assignment]
MOST_TOPICS = 65_535
"""Of one file: MCAP numbers them with 16 bits."""
PASSING = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EMFILE, errno.ENFILE)
"""Reasons of a failed write that may be gone at the next attempt: what fills a disk is often deleted again."""
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


def _cannot_write(path: Path, error: OSError) -> LogError:
    return LogError(
        f"cannot write {path}: {error.strerror}; make room or choose another --log-dir",
        retry=error.errno in PASSING,
    )


def private(path: str, flags: int) -> int:
    """An opener for `open`: for the user alone, as what tells where a robot was and what its camera saw."""
    return os.open(path, flags, 0o600)


class _LogFile(io.FileIO):
    """Unbuffered: what a flush wrote must survive the death of this process. A write that fails raises LogError."""

    def write(self, data: Buffer) -> int:
        try:
            return super().write(data)
        except OSError as error:
            raise _cannot_write(Path(str(self.name)), error) from error


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
            self._file = _LogFile(path, "wb", opener=private)
            fcntl.flock(self._file, fcntl.LOCK_EX)  # tells `is_being_written`; gone with this process
        except OSError as error:
            raise _cannot_write(path, error) from error
        self._stream = io.BufferedWriter(self._file)
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"rbtrg-robot {__version__}")
        self.add_metadata(METADATA, metadata)
        for name, data in (attachments or {}).items():
            self._writer.add_attachment(0, 0, name, "application/yaml", data)
        self._channels: dict[tuple[str, ...], int] = {}
        """By name and type, and of copied ones by whatever else makes them another: encoding, definition, metadata."""
        self._schemas: dict[tuple[str, str, bytes], int] = {}
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
        channel = self._channel(topic, msg.CompressedPointCloud2.__msgtype__ if packed else topic.type)
        self._add(channel, pack(data) if packed else data, log_time, publish_time, sequence)

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """One more record of facts."""
        self._writer.add_metadata(name, dict(metadata))

    def copy(self, entry: Entry, schema: Schema | None, channel: Channel) -> None:
        """Append a message of another file with its schema, bit for bit. Two channels of one topic stay two."""
        told = tuple(part for pair in sorted(channel.metadata.items()) for part in pair)
        schema_id = self._schema(schema.name, schema.encoding, schema.data) if schema else 0
        key = (entry.topic, entry.type, channel.message_encoding, str(schema_id), *told)
        if key not in self._channels:
            self._register(key, channel.message_encoding, schema_id, channel.metadata)
        self._add(self._channels[key], entry.data, entry.log_time, entry.publish_time, entry.sequence)

    def _schema(self, name: str, encoding: str, data: bytes) -> int:
        key = (name, encoding, data)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(name, encoding, data)
        return self._schemas[key]

    def _register(
        self, key: tuple[str, ...], encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> None:
        if len(self._channels) == MOST_TOPICS:
            raise LogError(f"more than {MOST_TOPICS} topics: {self.path} cannot hold them")
        self._channels[key] = self._writer.register_channel(key[0], encoding, schema, dict(metadata))

    def _add(self, channel: int, data: bytes, log_time: int, publish_time: int, sequence: int) -> None:
        self._since_flush += 1
        self.messages += 1
        # Whatever an attachment says: MCAP holds no time before 1970 and none after 2554.
        stamp = min(max(publish_time, 0), 2**64 - 1)
        self._writer.add_message(channel, log_time, data, stamp, sequence % 2**32)

    def _channel(self, topic: Topic, typename: str) -> int:
        key = (topic.name, typename)
        if key not in self._channels:
            metadata = {
                "offered_qos_profiles": _OFFERED_QOS.format(
                    reliability="best_effort" if topic.qos is Qos.SENSOR else "reliable",
                    durability="transient_local" if topic.qos is Qos.LATCHED else "volatile",
                ),
                "topic_type_hash": type_hash(typename),
            }
            schema = self._schema(typename, "ros2msg", definition(typename).encode())
            self._register(key, "cdr", schema, metadata)
        return self._channels[key]

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
        """Close without an index: flushed data can be read, and `recover` makes an index. For a disk that is full."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def recover(path: Path, out: Path) -> tuple[int, str]:
    """Write what can be read of `path` to a new, indexed file. (messages, damage found). Raises LogError."""
    if out.exists():
        raise LogError(f"{out} exists; name another file with --out")
    if path.is_dir():
        raise LogError(f"{path} is a folder: recover one of its files, as in {log_files(path)[-1]}")
    contents = LogContents()
    records = read_log(path, contents, raw=True)
    first = next(records, None)  # of our files, metadata and attachments stand before the first message
    if first is None and contents.damage:
        raise LogError(f"{path} ends within its first messages: nothing can be recovered ({contents.damage})")
    told = dict(contents.metadata)
    with LogWriter(out, told.get(METADATA, {}), contents.attachments) as writer:
        for record in chain([first] if first else [], records):
            writer.copy(*record)
        for name, metadata in contents.metadata.items():
            if name != METADATA:
                writer.add_metadata(name, metadata)
        return writer.messages, contents.damage
