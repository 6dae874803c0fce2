"""Services of the robot: names, api ids, result codes, and the request and response messages on the wire.

Source: unitree_sdk2_python (`rpc/`, `go2/sport`, `comm/motion_switcher`, `go2/obstacles_avoid`). A service X listens on
`rt/api/X/request` and answers on `rt/api/X/response`. Parameters and results are JSON text.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

SPORT = "sport"
MOTION_SWITCHER = "motion_switcher"
OBSTACLES_AVOID = "obstacles_avoid"
SERVICES = (SPORT, MOTION_SWITCHER, OBSTACLES_AVOID)


class Sport(IntEnum):
    """Sport service, version 1.0.0.1."""

    DAMP = 1001
    """Highest priority: joints go soft, the robot sinks."""
    BALANCE_STAND = 1002
    """Unlocks the joints and keeps attitude and height; Move works only from here."""
    STOP_MOVE = 1003
    STAND_UP = 1004
    """Stands with locked joints."""
    STAND_DOWN = 1005
    """Lies down; works only after StandUp in the same session."""
    RECOVERY_STAND = 1006
    """From a fall or from lying to balance stand."""
    EULER = 1007
    """{x, y, z}: roll, pitch within 0.75 rad, yaw within 0.6 rad; repeat to hold."""
    MOVE = 1008
    """{x, y, z}: vx, vy [m/s], yaw rate [rad/s]; no reply; held for 1 s, not filtered."""


class MotionSwitcher(IntEnum):
    """Motion switcher service, version 1.0.0.1: which motion service owns the motors."""

    CHECK_MODE = 1001
    """-> {form, name}; an empty name means none."""
    SELECT_MODE = 1002
    """{name}; answers busy (7002) for about 10 s after a release."""
    RELEASE_MODE = 1003
    """Torque drops at once. Sent to a robot that lies, and with `unitree.level: low` alone."""


class ObstaclesAvoid(IntEnum):
    """Obstacle avoidance service, version 1.0.0.2 (forward only)."""

    SWITCH_SET = 1001
    """{enable}."""
    SWITCH_GET = 1002
    MOVE = 1003
    """{x, y, yaw, mode}; mode 0: velocity."""
    USE_REMOTE_COMMAND_FROM_API = 1004
    """{is_remote_commands_from_api}: true while commands come from here, false again at the end."""


VIDEO = "videohub"


class Video(IntEnum):
    """Video service, version 1.0.0.1 (unitree_sdk2_python, `go2/video`)."""

    GET_IMAGE_SAMPLE = 1001
    """-> a JPEG in the binary part."""


BUSY = 7002
"""Motion switcher: try again."""

CODES = {
    0: "ok",
    3001: "unknown error",
    3102: "request could not be sent",
    3103: "this api is not registered on the robot (firmware differs)",
    3104: "no answer in time",
    3105: "answer does not belong to the request",
    3106: "answer could not be read",
    3107: "lease is not valid",
    3201: "robot could not answer",
    3202: "robot had an internal error",
    3203: "not implemented on this robot",
    3204: "robot refused the parameter",
    3205: "another client holds the lease",
    3206: "lease is missing",
    3207: "lease exists already",
    4101: "path is not valid",
    4201: "action took too long",
    4202: "sport service is not initialised",
    4205: "sport service is not initialised",
    7001: "mode switcher refused the parameter",
    7002: "mode switcher is busy",
    7003: "mode switcher event failed",
    7004: "mode name is not known to the robot",
    7005: "mode name is not known to the robot",
    7006: "mode check failed",
    7007: "mode selection failed",
    7008: "mode release failed",
    7009: "mode could not be saved",
}
"""Result codes in plain words."""


def describe(code: int) -> str:
    """A result code for an operator."""
    return f"{CODES.get(code, 'unknown code')} ({code})"


class WireError(ValueError):
    """A message on the wire is cut off or not what its type says."""


_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_REQUEST = struct.Struct("<qqqi?")
_RESPONSE = struct.Struct("<qqi")


@dataclass(frozen=True, slots=True)
class Request:
    """unitree_api Request_ without lease and binary part."""

    id: int
    """Monotonic nanoseconds of the client; echoed in the response."""
    api: int
    parameter: str = ""
    """JSON."""
    no_reply: bool = False

    def pack(self) -> bytes:
        """CDR with encapsulation header."""
        head = _REQUEST.pack(self.id, self.api, 0, 0, self.no_reply)
        return _LITTLE_ENDIAN + _tail(head, self.parameter)

    @staticmethod
    def unpack(data: bytes) -> Request:
        """Raises WireError."""
        body = _body(data, _REQUEST.size)
        identity, api, _lease, _priority, no_reply = _REQUEST.unpack_from(body)
        return Request(identity, api, _string(body, _REQUEST.size)[0], no_reply)


@dataclass(frozen=True, slots=True)
class Response:
    """unitree_api Response_."""

    id: int
    api: int
    code: int
    data: str = ""
    """JSON."""
    binary: bytes = b""

    def pack(self) -> bytes:
        """CDR with encapsulation header."""
        head = _RESPONSE.pack(self.id, self.api, self.code)
        return _LITTLE_ENDIAN + _tail(head, self.data, self.binary)

    @staticmethod
    def unpack(data: bytes) -> Response:
        """Raises WireError."""
        body = _body(data, _RESPONSE.size)
        identity, api, code = _RESPONSE.unpack_from(body)
        text, end = _string(body, _RESPONSE.size)
        return Response(identity, api, code, text, _bytes(body, end))

    def json(self) -> dict[str, Any]:
        """`data`; an empty text is an empty object. Raises WireError."""
        try:
            value = json.loads(self.data) if self.data else {}
        except (ValueError, RecursionError) as error:  # a number of 5000 digits is no JSONDecodeError
            raise WireError(f"answer {self.data[:40]!r} is not JSON") from error
        if not isinstance(value, dict):
            raise WireError(f"answer {self.data[:40]!r} is not an object")
        return value


def compact(parameter: dict[str, Any]) -> str:
    """JSON text as the SDK writes it; no parameters are an empty string."""
    return json.dumps(parameter) if parameter else ""


def _body(data: bytes, size: int) -> bytes:
    if len(data) < 4 + size or data[:2] != _LITTLE_ENDIAN[:2]:
        raise WireError(f"message of {len(data)} bytes is not little-endian CDR of this type")
    return data[4:]


def _tail(head: bytes, text: str, binary: bytes = b"") -> bytes:
    """`head`, aligned to 4, then the string and the octet sequence."""
    raw = text.encode() + b"\0"
    out = head + b"\0" * (-len(head) % 4) + struct.pack("<I", len(raw)) + raw
    return out + b"\0" * (-len(out) % 4) + struct.pack("<I", len(binary)) + binary


def _bytes(body: bytes, at: int) -> bytes:
    """The octet sequence at `at`; empty where the message ends before."""
    at += -at % 4
    if len(body) <= at:
        return b""
    if len(body) < at + 4:
        raise WireError("message ends inside the length of a sequence of bytes")
    (length,) = struct.unpack_from("<I", body, at)
    if len(body) < at + 4 + length:
        raise WireError("message ends inside a sequence of bytes")
    return body[at + 4 : at + 4 + length]


def _string(body: bytes, at: int) -> tuple[str, int]:
    """The string at `at`, and where it ends."""
    at += -at % 4
    if len(body) < at + 4:
        raise WireError("message ends inside a string")
    (length,) = struct.unpack_from("<I", body, at)
    if length < 1 or len(body) < at + 4 + length:
        raise WireError("message ends inside a string")
    try:
        return body[at + 4 : at + 3 + length].decode(), at + 4 + length
    except UnicodeDecodeError as error:
        raise WireError("string is not UTF-8") from error
