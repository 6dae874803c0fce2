"""ROS 2 messages on the wire: bytes, hashes, definitions. The messages themselves are the dataclasses of
`rbtrg_robot.msg`.

Standard types come from the ROS 2 Jazzy set that rosbags carries; ours from the .msg files beside this module."""

from __future__ import annotations

import struct
from functools import cache
from importlib.resources import files
from typing import Any, TypeVar, cast, overload

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot.msg import Header, Message, Time
from rbtrg_robot.wire.cdr import HEADER, Codec

M = TypeVar("M", bound=Message)
STORE = get_typestore(Stores.ROS2_JAZZY)
OURS: list[str] = []
"""Types that ROS lacks."""
for _package in ("grid_map_msgs", "point_cloud_interfaces", "rbtrg_msgs"):
    _found: dict[str, Any] = {}
    for _file in sorted(files("rbtrg_robot.wire").joinpath("msgs", _package).iterdir(), key=lambda f: f.name):
        _name = f"{_package}/msg/{_file.name.removesuffix('.msg')}"
        _found.update(get_types_from_msg(_file.read_text(), _name))
    STORE.register(_found)
    OURS += _found
for _type in vars(msg).values():
    if isinstance(_type, type) and issubclass(_type, Message) and _type is not Message:
        STORE.types[_type.__msgtype__] = cast(Any, _type)  # what the store decodes to
CODEC = Codec(STORE)

PARALLEL: dict[type[Message], tuple[tuple[str, ...], ...]] = {
    msg.GridMap: (("layers", "data"),),
    msg.Heartbeat: (("topic", "published", "newest"),),
    msg.Journal: (("taken", "sequence", "stamp"),),
    msg.MissionState: (("action_id", "action_type", "action_status", "result_description"),),
    msg.OdometryHealth: (
        ("counter", "count"),
        ("lidar", "time_offset", "time_offset_sigma", "time_applied"),
    ),
    msg.PathCommand: (("x", "y", "z", "yaw", "speed"),),
    msg.Plan: (
        ("x", "y", "z", "yaw", "speed"),
        ("node_x", "node_y"),
        ("transition_length", "transition_risk", "transition_body", "transition_unknown"),
    ),
    msg.RobotState: (("refused_reason", "refused_count"),),
    msg.RouteReport: (
        ("x", "y", "z", "yaw"),
        ("node_x", "node_y", "node_z"),
        (
            *(
                f"transition_{name}"
                for name in ("length", "cost", "turn", "risk", "body", "unknown", "p_fail")
            ),
            *("d_fb", "a_lr", "p_int", "worst_x", "worst_y", "worst_yaw"),
        ),
        ("native_x", "native_y"),
        ("graph_x", "graph_y", "graph_z"),
        ("graph_from", "graph_to", "graph_risk"),
    ),
}
"""Lists of a message that run side by side; unequal ones are as broken as broken bytes."""


class MessageError(ValueError):
    """Bytes that are no message of the expected type."""


def encode(message: Message) -> bytes:
    """CDR bytes (little-endian XCDR1 with its 4-byte header) of a message."""
    return CODEC.encode(message)


@overload
def decode(data: bytes, kind: type[M]) -> M: ...
@overload
def decode(data: bytes, kind: str) -> Any: ...
def decode(data: bytes, kind: Any) -> Any:
    """The message of a class or, where only a log knows it, a type's name. Arrays are views on `data`. Raises
    MessageError."""
    typename = kind if isinstance(kind, str) else kind.__msgtype__
    try:
        known = data[:2] == HEADER[:2] and typename in STORE.types
        message: Any = CODEC.decode(data, typename) if known else STORE.deserialize_cdr(data, typename)
    except Exception as error:  # whatever the broken bytes trip over
        raise MessageError(f"not a {typename}: {error}") from error
    for names in PARALLEL.get(type(message), ()):
        if len({len(getattr(message, name)) for name in names}) > 1:
            raise MessageError(f"not a {typename}: {', '.join(names)} differ in length")
    return message


@cache
def type_hash(typename: str) -> str:
    """RIHS01 hash of a type, as it stands in the Zenoh key."""
    return STORE.hash_rihs01(typename)


@cache
def definition(typename: str) -> str:
    """The concatenated .msg text (`ros2msg`) of a type."""
    return STORE.generate_msgdef(typename, ros_version=2)[0]


def array(values: Any, dtype: str) -> np.ndarray:
    """A numeric message field."""
    return np.ascontiguousarray(values, dtype=dtype)


def time_msg(stamp: int) -> Time:
    """A stamp [ns]."""
    return Time(stamp // NS, stamp % NS)


def header(stamp: int, frame: str) -> Header:
    """A header; `stamp` in ns of the source clock."""
    return Header(time_msg(stamp), frame)


@cache
def _starts_with_stamp(typename: str) -> bool:
    """True where the first field is a header or a time: its eight bytes follow the encapsulation."""
    _, (kind, detail) = STORE.fielddefs[typename][1][0]
    return int(kind) == 2 and detail in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")


def stamp_in(data: bytes, typename: str) -> int:
    """Source stamp [ns] of wire bytes, without decoding them where it stands in front. Raises MessageError."""
    if not _starts_with_stamp(typename):
        return stamp_of(decode(data, typename))
    if len(data) < 12:
        raise MessageError(f"not a {typename}: no stamp in {len(data)} bytes")
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return int(seconds) * NS + min(int(nanoseconds), NS - 1)


def stamp_of(message: Message) -> int:
    """Source stamp [ns] of a message with a header or clock, else 0. A stamp with more nanoseconds than a second has
    is broken: it counts as the end of its second, which a message can carry."""
    time = getattr(getattr(message, "header", None), "stamp", None) or getattr(message, "clock", None)
    if time is None and isinstance(message, msg.TFMessage) and message.transforms:
        time = message.transforms[0].header.stamp
    return 0 if time is None else time.sec * NS + min(time.nanosec, NS - 1)
