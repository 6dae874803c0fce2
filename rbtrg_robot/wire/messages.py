"""ROS 2 messages: types, CDR, hashes. `types` holds one dataclass per message, `encode`/`decode` the wire bytes.

Standard types come from the ROS 2 Jazzy set that rosbags carries; ours from the .msg files beside this module.
"""

from __future__ import annotations

import struct
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hal.types import NS

STORE = get_typestore(Stores.ROS2_JAZZY)
for _package in ("grid_map_msgs", "rbtrg_msgs"):
    _found: dict[str, Any] = {}
    for _file in sorted(files("rbtrg_robot.wire").joinpath("msgs", _package).iterdir(), key=lambda f: f.name):
        _name = f"{_package}/msg/{_file.name.removesuffix('.msg')}"
        _found.update(get_types_from_msg(_file.read_text(), _name))
    STORE.register(_found)


class MessageError(ValueError):
    """Bytes that are no message of the expected type."""


def encode(message: Any) -> bytes:
    """CDR bytes (little-endian XCDR1 with its 4-byte header) of a message."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def decode(data: bytes, typename: str) -> Any:
    """The message in `data`. Arrays are views on `data`. Raises MessageError."""
    try:
        return STORE.deserialize_cdr(data, typename)
    except Exception as error:  # rosbags raises whatever the broken bytes trip over
        raise MessageError(f"not a {typename}: {error}") from error


@cache
def type_hash(typename: str) -> str:
    """RIHS01 hash of a type, as it stands in the Zenoh key."""
    return STORE.hash_rihs01(typename)


@cache
def definition(typename: str) -> str:
    """The concatenated .msg text (`ros2msg`) of a type."""
    return STORE.generate_msgdef(typename, ros_version=2)[0]


def make(typename: str, **fields: Any) -> Any:
    """A message of `typename`; fields that are not given get ROS defaults (zero, empty)."""
    kind, blanks = _blanks(typename)
    for name, blank in blanks:
        if name not in fields:
            fields[name] = blank() if callable(blank) else blank
    return kind(**fields)


_ZERO = {"bool": False, "string": "", "float32": 0.0, "float64": 0.0}
_NUMPY = {"octet": np.uint8, "char": np.uint8, "bool": np.bool_}


@cache
def _blanks(typename: str) -> tuple[type, list[tuple[str, Any]]]:
    """The class of a type, and per field its default: a value that cannot change, or what makes a fresh one."""
    return STORE.types[typename], [(name, _blank(desc)) for name, desc in STORE.fielddefs[typename][1]]


def _blank(desc: Any) -> Any:
    kind, detail = int(desc[0]), desc[1]
    if kind == 1:  # base type: (name, string limit)
        return _ZERO.get(detail[0], 0)
    if kind == 2:  # nested message
        return lambda: make(detail)
    (element, inner), length = detail
    count = length if kind == 3 else 0  # array: fixed length; sequence: its limit
    if int(element) == 1 and inner[0] != "string":
        dtype = np.dtype(_NUMPY.get(inner[0], inner[0]))
        return lambda: np.zeros(count, dtype)
    blank = _blank((element, inner))
    return lambda: [blank() if callable(blank) else blank for _ in range(count)]


def array(values: Any, dtype: str) -> np.ndarray:
    """A numeric message field."""
    return np.ascontiguousarray(values, dtype=dtype)


def time_msg(stamp: int) -> Any:
    """builtin_interfaces/Time of a stamp [ns]."""
    return STORE.types["builtin_interfaces/msg/Time"](sec=stamp // NS, nanosec=stamp % NS)


def header(stamp: int, frame: str) -> Any:
    """std_msgs/Header; `stamp` in ns of the source clock."""
    return STORE.types["std_msgs/msg/Header"](stamp=time_msg(stamp), frame_id=frame)


@cache
def _starts_with_stamp(typename: str) -> bool:
    """True where the first field is a header or a time: its eight bytes follow the encapsulation."""
    _, (kind, detail) = STORE.fielddefs[typename][1][0]
    return int(kind) == 2 and detail in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")


def stamp_in(data: bytes, typename: str) -> int:
    """Source stamp [ns] of wire bytes, without decoding them where it stands in front."""
    if not _starts_with_stamp(typename):
        return stamp_of(decode(data, typename))
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return int(seconds) * NS + int(nanoseconds)


def stamp_of(message: Any) -> int:
    """Source stamp [ns] of a message with a header or clock, else 0."""
    time = getattr(getattr(message, "header", None), "stamp", None) or getattr(message, "clock", None)
    if time is None and getattr(message, "transforms", None):
        time = message.transforms[0].header.stamp
    return 0 if time is None else time.sec * NS + time.nanosec
