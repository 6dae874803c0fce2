"""Fixed-size messages of the robot as numpy records: LowState, LowCmd, SportModeState; checksum; motor order.

On the wire (CDR) every number is aligned to its own size and structs are not padded; the checksum is taken over the
padded C struct instead. Both layouts come from one field list. Decoding is a view: no copy, about a microsecond.
Source: unitree_go IDL of unitree_sdk2; checksum: `utils/crc.py` there.
"""

from __future__ import annotations

import zlib
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.unitree.api import WireError

Field = tuple[str, Any] | tuple[str, Any, int]
"""Name, numpy type string or nested field list, optional array length."""

IMU: list[Field] = [
    ("quaternion", "<f4", 4),
    ("gyroscope", "<f4", 3),
    ("accelerometer", "<f4", 3),
    ("rpy", "<f4", 3),
    ("temperature", "u1"),
]
_MOTOR: list[Field] = [
    ("mode", "u1"),
    *((name, "<f4") for name in ("q", "dq", "ddq", "tau_est", "q_raw", "dq_raw", "ddq_raw")),
    ("temperature", "u1"),
    ("lost", "<u4"),
    ("reserve", "<u4", 2),
]
_BMS: list[Field] = [
    ("version_high", "u1"),
    ("version_low", "u1"),
    ("status", "u1"),
    ("soc", "u1"),
    ("current", "<i4"),
    ("cycle", "<u2"),
    ("bq_ntc", "u1", 2),
    ("mcu_ntc", "u1", 2),
    ("cell_vol", "<u2", 15),
]
_HEAD: list[Field] = [
    ("head", "u1", 2),
    ("level_flag", "u1"),
    ("frame_reserve", "u1"),
    ("sn", "<u4", 2),
    ("version", "<u4", 2),
    ("bandwidth", "<u2"),
]
LOW_STATE: list[Field] = [
    *_HEAD,
    ("imu_state", IMU),
    ("motor_state", _MOTOR, 20),
    ("bms_state", _BMS),
    ("foot_force", "<i2", 4),
    ("foot_force_est", "<i2", 4),
    ("tick", "<u4"),
    ("wireless_remote", "u1", 40),
    ("bit_flag", "u1"),
    ("adc_reel", "<f4"),
    ("temperature_ntc1", "u1"),
    ("temperature_ntc2", "u1"),
    ("power_v", "<f4"),
    ("power_a", "<f4"),
    ("fan_frequency", "<u2", 4),
    ("reserve", "<u4"),
    ("crc", "<u4"),
]
_MOTOR_CMD: list[Field] = [
    ("mode", "u1"),
    *((name, "<f4") for name in ("q", "dq", "tau", "kp", "kd")),
    ("reserve", "<u4", 3),
]
_BMS_CMD: list[Field] = [("off", "u1"), ("reserve", "u1", 3)]
LOW_CMD: list[Field] = [
    *_HEAD,
    ("motor_cmd", _MOTOR_CMD, 20),
    ("bms_cmd", _BMS_CMD),
    ("wireless_remote", "u1", 40),
    ("led", "u1", 12),
    ("fan", "u1", 2),
    ("gpio", "u1"),
    ("reserve", "<u4"),
    ("crc", "<u4"),
]
SPORT_MODE_STATE: list[Field] = [
    ("stamp", [("sec", "<i4"), ("nanosec", "<u4")]),
    ("error_code", "<u4"),
    ("imu_state", IMU),
    ("mode", "u1"),
    ("progress", "<f4"),
    ("gait_type", "u1"),
    ("foot_raise_height", "<f4"),
    ("position", "<f4", 3),
    ("body_height", "<f4"),
    ("velocity", "<f4", 3),
    ("yaw_speed", "<f4"),
    ("range_obstacle", "<f4", 4),
    ("foot_force", "<i2", 4),
    ("foot_position_body", "<f4", 12),
    ("foot_speed_body", "<f4", 12),
    ("path_point", [(name, "<f4") for name in ("t_from_start", "x", "y", "yaw", "vx", "vy", "vyaw")], 10),
]


def _struct(members: list[tuple[str, Any, int]], size: int) -> np.dtype[np.void]:
    """dtype from (name, format, offset); fields may overlap."""
    names, formats, offsets = zip(*members, strict=True)
    return np.dtype(
        {"names": list(names), "formats": list(formats), "offsets": list(offsets), "itemsize": size}
    )


def _cdr(fields: list[Field], at: int) -> tuple[np.dtype[np.void], int, int]:
    """dtype of a struct in a CDR stream at offset `at`, its aligned start, and its end.

    CDR aligns numbers only, so the first of several structs may have other gaps than the rest: the first motor's
    `mode` directly follows the byte before it. Such an array becomes three fields: NAME without the leading byte,
    NAME_first_mode and NAME_modes (of the rest).
    """
    members: list[tuple[str, Any, int]] = []
    for name, kind, *length in fields:
        count = length[0] if length else 1
        if isinstance(kind, str):
            base = np.dtype(kind)
            at += -at % base.itemsize
            members.append((name, np.dtype((base, (count,))) if length else base, at))
            at += base.itemsize * count
            continue
        starts, end = [], at
        for _ in range(count):
            element, start, end = _cdr(kind, end)
            starts.append(start)
        stride = starts[-1] - starts[-2] if count > 1 else element.itemsize
        if all(b - a == stride for a, b in pairwise(starts)):
            element = _struct([(n, *element.fields[n]) for n in element.names], max(stride, element.itemsize))  # type: ignore[index,misc,union-attr]
            members.append((name, np.dtype((element, (count,))) if length else element, starts[0]))
        else:
            rest, first, _ = _cdr(kind[1:], starts[0] + 1)
            rest = _struct([(n, *rest.fields[n]) for n in rest.names], stride)  # type: ignore[index,misc,union-attr]
            members.append((name, np.dtype((rest, (count,))), first))
            members.append((f"{name}_first_mode", np.dtype("u1"), starts[0]))
            modes = _struct([("mode", np.dtype("u1"), 0)], stride)
            members.append((f"{name}_modes", np.dtype((modes, (count - 1,))), starts[1]))
        at = end
    begin = members[0][2]
    size = max(at - begin, *(offset - begin + fmt.itemsize for _, fmt, offset in members))
    return _struct([(name, fmt, offset - begin) for name, fmt, offset in members], size), begin, at


def cdr_dtype(fields: list[Field]) -> np.dtype[np.void]:
    """numpy dtype of the CDR body of a message with these fields."""
    return _cdr(fields, 0)[0]


def c_dtype(fields: list[Field]) -> np.dtype[np.void]:
    """numpy dtype of the C struct with these fields."""
    parts = []
    for name, kind, *length in fields:
        base = np.dtype(kind) if isinstance(kind, str) else c_dtype(kind)
        parts.append((name, base, *(((length[0],),) if length else ())))
    return np.dtype(parts, align=True)


LOW_STATE_CDR = cdr_dtype(LOW_STATE)
SPORT_MODE_STATE_CDR = cdr_dtype(SPORT_MODE_STATE)
LOW_CMD_CDR = cdr_dtype(LOW_CMD)
LOW_STATE_C = c_dtype(LOW_STATE)
LOW_CMD_C = c_dtype(LOW_CMD)

CDR_HEADER = b"\x00\x01\x00\x00"
"""Encapsulation of a little-endian XCDR1 message."""


def view(data: bytes, dtype: np.dtype[np.void]) -> np.void:
    """The message as a numpy record that shares memory with `data`. Raises WireError when it is too short."""
    if len(data) < 4 + dtype.itemsize or data[:2] != CDR_HEADER[:2]:
        raise WireError(f"message of {len(data)} bytes, expected {4 + dtype.itemsize} little-endian")
    return np.frombuffer(data, dtype=dtype, count=1, offset=4)[0]


_REVERSED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc32(words: NDArray[np.uint32]) -> int:
    """CRC-32/MPEG-2 over little-endian words, each fed most significant byte first."""
    return _crc(words.astype(">u4").tobytes())


def _crc(stream: bytes) -> int:
    """zlib computes the reflected sibling of this code, so the bits are reversed before and after."""
    return int(f"{zlib.crc32(stream.translate(_REVERSED_BITS)) ^ 0xFFFFFFFF:032b}"[::-1], 2)


def low_state_checksum(data: bytes) -> int:
    """What `crc` of this LowState should be: over its C struct without the last word (`crc` itself)."""
    return _crc(np.frombuffer(data, np.uint8)[_CHECKED].tobytes())


def low_cmd_checksum(data: bytes) -> int:
    """The same of a LowCmd."""
    return _crc(np.frombuffer(data, np.uint8)[_CHECKED_CMD].tobytes())


def _checked(cdr: np.dtype[np.void], c: np.dtype[np.void]) -> NDArray[np.intp]:
    """Where in a message the bytes of the checksum stand, in its order: words of the C struct, high byte first.

    Padding, which CDR has not, is taken from the message's first byte, which is 0. Found by copying a message whose
    bytes are their own places, low and high byte in turn."""
    places = np.arange(4, 4 + cdr.itemsize)
    found = np.zeros(c.itemsize, np.intp)
    for shift in (0, 8):
        record = np.zeros(1, c)
        _assign(record[0], np.frombuffer((places >> shift & 0xFF).astype(np.uint8).tobytes(), cdr)[0])
        found += np.frombuffer(record.tobytes(), np.uint8).astype(np.intp) << shift
    return found.reshape(-1, 4)[:-1, ::-1].ravel()


def _assign(target: np.void, source: np.void) -> None:
    assert target.dtype.names is not None
    for name in target.dtype.names:
        if target.dtype[name].base.names is None:
            target[name] = source[name]
        elif f"{name}_modes" in source.dtype.names:  # type: ignore[operator]
            for field in source.dtype[name].base.names:  # type: ignore[union-attr]
                target[name][field] = source[name][field]
            target[name]["mode"][0] = source[f"{name}_first_mode"]
            target[name]["mode"][1:] = source[f"{name}_modes"]["mode"]
        else:
            _assign(target[name], source[name])


_CHECKED = _checked(LOW_STATE_CDR, LOW_STATE_C)
_CHECKED_CMD = _checked(LOW_CMD_CDR, LOW_CMD_C)
