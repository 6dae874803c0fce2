"""One way to read a recording, whatever wrote it: MCAP (ROS 2 or ROS 1 in it), rosbag2 (.db3, split, zstd), a ROS 1
.bag.

Messages come out as CDR. MCAP is read by our own reader, which reads a damaged file as far as it goes; the rest by
rosbags.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from mcap.records import Channel, Schema
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hal.regular import open_regular
from rbtrg_robot import msg, yaml_file
from rbtrg_robot.log.packed import ForeignError, unpack
from rbtrg_robot.log.read import MCAP0_MAGIC, Entry, LogContents, LogError, log_files, read_log
from rbtrg_robot.log.summary import channels_of
from rbtrg_robot.wire.messages import STORE, definition
from rbtrg_robot.yaml_file import YamlError

MAGIC = ((MCAP0_MAGIC, "mcap"), (b"SQLite format 3\0", "db3"), (b"#ROSBAG V2.0", "bag"))
"""How a file begins, and what it is."""
METADATA_YAML = "metadata.yaml"
HEADER, TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
"""Those of ROS 2: the header of ROS 1 has one field more, which the conversion drops."""
LATCHED = ("durability: transient_local", "durability: 1\n")
"""What the QoS of a latched topic holds, in the words of the versions of rosbag2."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One topic of a bag."""

    topic: str
    type: str
    """`package/msg/Name`; empty where the bag does not say."""
    count: int
    """Messages; 0 where only a pass over the bag could tell."""
    encoding: str
    """Of what `Bag.messages` yields: `cdr`, or what is handed on as it is."""
    schema: Schema | None
    channel: Channel

    @property
    def latched(self) -> bool:
        """Who comes late gets the newest."""
        return any(words in self.channel.metadata.get("offered_qos_profiles", "") for words in LATCHED)


class Bag:
    """A recording: its topics, and its messages in the order of the recording."""

    def __init__(self, path: Path) -> None:
        """Raises LogError for what is no bag; the message tells what it is instead."""
        self.path = path
        self.damage: list[str] = []
        """Where and why reading ended early; filled by `messages`."""
        self._parts: list[_Part] = [_open(part) for part in _parts(path)]
        self.sources = [source for part in self._parts for source in part.sources]

    @property
    def count(self) -> int:
        """Messages, as far as the bag says."""
        return sum(source.count for source in self.sources)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[Source, int, int, bytes]]:
        """Topic, when it was recorded and when it was published [ns], bytes. `topics`: only these."""
        for part in self._parts:
            yield from part.messages(topics)
            self.damage += part.damage


class _Part(Protocol):
    """One file, or what rosbags reads as one."""

    sources: list[Source]
    damage: list[str]
    """Of the last pass over its messages."""

    def messages(self, topics: Collection[str] | None) -> Iterator[tuple[Source, int, int, bytes]]:
        """See Bag."""


class _FromRos1:
    """Messages of ROS 1 as CDR, by the number of their connection. One that is not what its definition says is left out
    and counted."""

    def __init__(self) -> None:
        self._convert: dict[int, Callable[[bytes], bytes]] = {}
        self.broken: Counter[str] = Counter()
        """By topic, of this pass."""

    def add(self, number: int, kind: str, text: str) -> str | None:
        """A connection with its definition. Returns that of ROS 2, None where it cannot be read."""
        try:
            store = get_typestore(Stores.EMPTY)
            store.register(
                get_types_from_msg(text, kind) | {name: STORE.fielddefs[name] for name in (HEADER, TIME)}
            )
            told = store.generate_msgdef(kind, ros_version=2)[0]
        except Exception:  # noqa: BLE001  a definition may hold anything
            return None
        self._convert[number] = lambda raw: bytes(store.ros1_to_cdr(raw, kind))
        return told

    def take(self, number: int, topic: str, data: bytes) -> bytes | None:
        """A message; None where it is broken. As it is where its connection is not of ROS 1, or its definition cannot
        be read."""
        convert = self._convert.get(number)
        try:
            return data if convert is None else convert(data)
        except Exception:  # noqa: BLE001  whatever the broken bytes trip over
            self.broken[topic] += 1
            return None

    def damage(self) -> list[str]:
        """What was left out, in words."""
        return [f"{n} messages of {topic} are broken, and left out" for topic, n in self.broken.items()]


class _Mcap:
    def __init__(self, path: Path) -> None:
        self._path = path
        self.damage: list[str] = []
        self._ros1 = _FromRos1()
        self._known: dict[int, Source] = {}
        for schema, channel, count in channels_of(path):
            self._known[channel.id] = self._source(schema, channel, count)
        self.sources = list(self._known.values())

    def _source(self, schema: Schema | None, channel: Channel, count: int) -> Source:
        kind = ros2_name(schema.name) if schema else ""
        if channel.message_encoding != "ros1" or schema is None:
            return Source(channel.topic, kind, count, channel.message_encoding, schema, channel)
        text = self._ros1.add(channel.id, kind, schema.data.decode(errors="replace"))
        if text is None:
            return Source(channel.topic, kind, count, "ros1", schema, channel)
        return _source(channel.topic, kind, count, text, {})

    def messages(self, topics: Collection[str] | None) -> Iterator[tuple[Source, int, int, bytes]]:
        contents = LogContents()
        self._ros1.broken.clear()
        for entry, schema, channel in read_log(self._path, contents, raw=True):
            if topics is not None and entry.topic not in topics:
                continue
            source = self._known.get(channel.id)
            if source is None:
                source = self._known[channel.id] = self._source(schema, channel, 0)
            data = self._ros1.take(channel.id, entry.topic, entry.data)
            if data is not None:
                yield source, entry.log_time, entry.publish_time, data
        self.damage = self._ros1.damage()
        if contents.damage:
            self.damage.append(f"{self._path.name} ends {contents.damage}")


class _Rosbag:
    def __init__(self, path: Path, reader: Any) -> None:
        self._path, self._reader = path, reader
        self.damage: list[str] = []
        self._sources: dict[int, Source] = {}
        self._ros1 = _FromRos1()
        with ExitStack() as stack:
            for connection in self._opened(stack).connections:
                self._add(connection)
        self.sources = list(self._sources.values())

    def _opened(self, stack: ExitStack) -> Any:
        """The open reader, until `stack` ends. Raises LogError."""
        try:
            return stack.enter_context(self._reader(self._path))
        except Exception as error:  # rosbags opens it with libraries of its own, each with errors of its own
            raise LogError(f"{self._path} cannot be read: {error}") from error

    def _add(self, connection: Connection) -> None:
        kind = ros2_name(connection.msgtype)
        text, encoding = str(connection.msgdef.data or ""), "cdr"
        if self._reader is Reader1 and (told := self._ros1.add(connection.id, kind, text)) is not None:
            text = told
        elif self._reader is Reader1:
            encoding = "ros1"
        profiles = getattr(connection.ext, "offered_qos_profiles", ())
        metadata = {"offered_qos_profiles": dump_qos_v8(profiles)} if profiles else {}
        self._sources[connection.id] = _source(
            connection.topic, kind, connection.msgcount, text, metadata, encoding
        )

    def messages(self, topics: Collection[str] | None) -> Iterator[tuple[Source, int, int, bytes]]:
        self.damage = []
        self._ros1.broken.clear()
        with ExitStack() as stack:
            bag = self._opened(stack)
            wanted = [c for c in bag.connections if topics is None or c.topic in topics]
            if not wanted:
                return
            try:
                for connection, stamp, raw in bag.messages(connections=wanted):
                    data = self._ros1.take(connection.id, connection.topic, bytes(raw))
                    if data is not None:
                        yield self._sources[connection.id], stamp, stamp, data
                self.damage = self._ros1.damage()
            except Exception as error:  # noqa: BLE001  whatever a damaged file trips rosbags over
                self.damage = [
                    *self._ros1.damage(),
                    f"{self._path.name} ends early: {type(error).__name__}: {error}",
                ]


class Decoder:
    """Messages of any type whose definition the bag brings, or that we know."""

    def __init__(self) -> None:
        self._stores: dict[Source, Any] = {}

    def decode(self, source: Source, data: bytes) -> Any:
        """The message, a sweep that we packed as the sweep; None where it is no CDR, nobody says what it holds, or it
        is broken."""
        if source not in self._stores:
            self._stores[source] = _store_of(source)
        store = self._stores[source]
        try:
            if source.type == msg.CompressedPointCloud2.__msgtype__:
                with suppress(ForeignError):
                    return STORE.deserialize_cdr(unpack(data), msg.PointCloud2.__msgtype__)
            return None if store is None else store.deserialize_cdr(data, source.type)
        except Exception:  # noqa: BLE001  whatever the broken bytes trip over
            return None


def _store_of(source: Source) -> Any:
    if source.encoding != "cdr" or not source.type:
        return None
    if source.type in STORE.fielddefs:
        return STORE
    text = source.schema.data.decode(errors="replace") if source.schema else ""
    try:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(text, source.type))
    except Exception:  # noqa: BLE001  a definition may hold anything
        return None
    return store


def _source(
    topic: str, kind: str, count: int, text: str, metadata: dict[str, str], encoding: str = "cdr"
) -> Source:
    if not text and kind in STORE.fielddefs:
        text = definition(kind)
    schema = Schema(0, text.encode(), "ros2msg", kind)
    channel = Channel(id=0, topic=topic, message_encoding=encoding, metadata=metadata, schema_id=0)
    return Source(topic, kind, count, encoding, schema, channel)


def ros2_name(kind: str) -> str:
    """`package/msg/Name` of `package/Name`, and of the names that ROS 1 had."""
    package, slash, name = kind.partition("/")
    full = kind if not slash or "/" in name else f"{package}/msg/{name}"
    return {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}.get(full, full)


def _kind(path: Path) -> str:
    """`mcap`, `db3`, `bag`. Raises LogError."""
    try:
        with open_regular(path) as file:
            begin = file.read(16)
    except OSError as error:
        raise LogError(f"cannot read {path}: {error.strerror}") from error
    for magic, kind in MAGIC:
        if begin.startswith(magic):
            return kind
    if begin.startswith(b"\x28\xb5\x2f\xfd"):
        raise LogError(
            f"{path} is compressed with zstd: name the folder with its {METADATA_YAML}, or `zstd -d` it"
        )
    if begin.startswith(b"version https://"):
        raise LogError(f"{path} is a Git LFS pointer, not the bag: `git lfs pull` fetches it")
    raise LogError(
        f"{path} is no bag: MCAP, rosbag2 (.db3) and ROS 1 (.bag) are read; it begins with {begin[:8]!r}"
    )


def _parts(path: Path) -> list[Path]:
    """Files to be read one after the other, or a folder that rosbags reads."""
    if not path.exists():
        raise LogError(f"there is no {path}")
    if not path.is_dir():
        return [path]
    about = path / METADATA_YAML
    if about.is_file():
        try:
            info = yaml_file.read(about)["rosbag2_bagfile_information"]
            files = [path / Path(name).name for name in info["relative_file_paths"]]
            plain = not info.get("compression_format")
        except (YamlError, OSError, KeyError, TypeError) as error:
            raise LogError(f"{about} is no description of a rosbag2: {error}") from error
        missing = [file.name for file in files if not file.exists()]
        if missing:
            raise LogError(f"{path} lacks {', '.join(missing)}, which its {METADATA_YAML} names")
        if not (files and plain and all(_kind(file) == "mcap" for file in files)):
            return [path]
        # A recorder that was killed left a file that it has not described.
        return files + [file for file in log_files(path) if file not in files]
    files = [f for suffix in ("mcap", "db3", "bag") for f in path.glob(f"*.{suffix}") if f.stat().st_size]
    if not files:
        raise LogError(f"no .mcap, .db3 or .bag file in {path}")
    return sorted(files, key=lambda p: (len(p.name), p.name))


def _open(path: Path) -> _Part:
    if path.is_dir():
        return _Rosbag(path, Reader2)
    kind = _kind(path)
    return _Mcap(path) if kind == "mcap" else _Rosbag(path, Reader2 if kind == "db3" else Reader1)


def entry_of(source: Source, topic: str, log_time: int, stamp: int, sequence: int, data: bytes) -> Entry:
    """A message as the log writer copies it, under another name."""
    return Entry(topic, source.type, data, log_time, stamp, sequence)
