"""PointCloud2 and Imu of the robot's LiDAR topics: CDR bytes to `POINT_DTYPE` and back, without per-point Python.

The point layout differs by driver and firmware, so it is read from the message: x y z are needed; intensity, ring and
a per-point time (`time` or `t` relative, `timestamp` absolute) are taken where present.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.types import NS, POINT_DTYPE, POINT_QUANTUM, TIME_QUANTUM, Array
from hal.unitree.api import WireError
from hal.unitree.layout import CDR_HEADER

_DATATYPES = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
"""sensor_msgs/PointField datatype codes."""
_CODES = {np.dtype(v): k for k, v in _DATATYPES.items()}
LONGEST_SWEEP = 10.0
"""[s]: times of one cloud that spread further are nanoseconds."""
RELATIVE = 1e3
"""[s]: times below are relative to the header, unless the header is that early too."""
_TIME_NAMES = ("time", "t", "timestamp", "time_stamp", "offset_time")


class CdrReader:
    """Walks through a CDR body."""

    def __init__(self, data: bytes) -> None:
        if len(data) < 8 or data[1] != 1:
            raise WireError(f"message of {len(data)} bytes is not little-endian CDR")
        self.data, self.at = data, 4

    def number(self, fmt: str, size: int) -> int:
        self.at += -(self.at - 4) % size
        try:
            (value,) = struct.unpack_from("<" + fmt, self.data, self.at)
        except struct.error as error:
            raise WireError("message ends early") from error
        self.at += size
        return value

    def u32(self) -> int:
        return self.number("I", 4)

    def text(self) -> str:
        length = self.u32()
        if length < 1 or self.at + length > len(self.data):
            raise WireError("message ends inside a string")
        raw = self.data[self.at : self.at + length - 1]
        self.at += length
        return raw.decode("utf-8", "replace")


@dataclass(frozen=True, slots=True)
class RawCloud:
    """A PointCloud2 as it came: no copy of the points."""

    stamp: int
    """Header stamp [ns], the LiDAR's own clock."""
    frame: str
    points: NDArray[np.void]
    """(n,) with the sender's field names."""


def decode_cloud(data: bytes) -> RawCloud:
    """Read a PointCloud2. Raises WireError when it is cut off or its fields do not fit its point size."""
    r = CdrReader(data)
    stamp = r.number("i", 4) * NS + r.u32()
    frame = r.text()
    height, width = r.u32(), r.u32()
    count = r.u32()
    if count > 64:
        raise WireError(f"{count} point fields")
    fields = []
    for _ in range(count):
        name, offset, datatype, number = r.text(), r.u32(), r.number("B", 1), r.u32()
        if datatype not in _DATATYPES:
            raise WireError(f"point field {name!r} has unknown datatype {datatype}")
        fields.append((name, _DATATYPES[datatype], offset, number))
    big_endian = r.number("B", 1)
    step = r.u32()
    r.u32()  # row_step: rows are contiguous in every driver seen
    size = r.u32()
    if big_endian:
        raise WireError("big-endian clouds are not supported")
    n = height * width
    if step < 1 or n * step > size or r.at + size > len(data):
        raise WireError(f"cloud of {height} x {width} points of {step} bytes has {size} bytes of data")
    used = [(name, fmt, offset) for name, fmt, offset, number in fields if number == 1]
    if len({name for name, _, _ in used}) < len(used):
        raise WireError(f"a point field comes twice: {[name for name, *_ in fields]}")
    if any(offset + np.dtype(fmt).itemsize > step for _, fmt, offset in used):
        raise WireError("a point field lies outside the point")
    if not {"x", "y", "z"} <= {name for name, _, _ in used}:
        raise WireError(f"cloud has no x, y, z: {[name for name, *_ in fields]}")
    dtype = np.dtype(
        {
            "names": [name for name, _, _ in used],
            "formats": [fmt for _, fmt, _ in used],
            "offsets": [offset for _, _, offset in used],
            "itemsize": step,
        }
    )
    return RawCloud(stamp, frame, np.frombuffer(data, dtype, n, r.at))


@njit(cache=True)
def _pack(x, y, z, intensity, ring, time, near, far, out):  # type: ignore[no-untyped-def]
    """Copy the points that are finite and within range, in coordinates and times rounded as POINT_DTYPE says; returns how many."""
    n = 0
    for i in range(x.size):
        squared = x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
        if not (near * near <= squared <= far * far):  # NaN compares false
            continue
        p = out[n]
        p.x = np.rint(x[i] / POINT_QUANTUM) * POINT_QUANTUM
        p.y = np.rint(y[i] / POINT_QUANTUM) * POINT_QUANTUM
        p.z = np.rint(z[i] / POINT_QUANTUM) * POINT_QUANTUM
        p.intensity, p.ring = intensity[i], ring[i]
        p.time = np.rint(time[i] / TIME_QUANTUM) * TIME_QUANTUM
        n += 1
    return n


@dataclass(frozen=True, slots=True)
class Limits:
    """What of a LiDAR's returns to keep, by their distance [m]. Those from the robot itself the odometry takes out (`mapping.odometry.own`)."""

    min_range: float = 0.2
    max_range: float = 30.0


def sweep(cloud: RawCloud, limits: Limits) -> tuple[int, NDArray[np.void]]:
    """Start of the sweep [ns, LiDAR clock] and its valid returns as `POINT_DTYPE` in the LiDAR frame."""
    raw = cloud.points
    names = raw.dtype.names or ()
    n = len(raw)
    start, time = _times(cloud)
    ring = next((name for name in ("ring", "line") if name in names), None)
    bright = next((name for name in ("intensity", "reflectivity") if name in names), None)
    out = np.empty(n, POINT_DTYPE)
    kept = _pack(  # type: ignore[call-arg]
        *(_column(raw[axis], np.float32) for axis in "xyz"),
        _column(raw[bright], np.float32) if bright is not None else np.zeros(n, np.float32),
        _column(raw[ring], np.uint16) if ring is not None else np.zeros(n, np.uint16),
        time,
        limits.min_range,
        limits.max_range,
        out,
    )
    return start, out[:kept]


def _column(values: NDArray, dtype: type) -> NDArray:
    """A contiguous copy: one compiled kernel instead of one per alignment and layout."""
    return values.astype(dtype)


def _times(cloud: RawCloud) -> tuple[int, NDArray[np.float32]]:
    """Start of the sweep [ns, LiDAR clock] and the seconds since then, per point. Raises WireError for times of no sweep."""
    raw = cloud.points
    name = next((name for name in _TIME_NAMES if name in (raw.dtype.names or ())), None)
    if name is None or len(raw) == 0:
        return cloud.stamp, np.zeros(len(raw), np.float32)
    if raw.dtype[name] == np.float32:  # too coarse for a clock: seconds since the header's stamp
        time = raw[name].astype(np.float32)
        if not (np.abs(time) <= LONGEST_SWEEP).all():
            raise WireError(f"point field {name!r} has times that are no seconds of a sweep")
        return cloud.stamp, time
    time = raw[name].astype(np.float64)
    if raw.dtype[name].kind in "ui":
        time *= 1e-9
    first, last = float(time.min()), float(time.max())
    if not (math.isfinite(first) and math.isfinite(last)):
        raise WireError(f"point field {name!r} is not finite")
    # Seconds or nanoseconds: a sweep lasts a tenth of a second, so its own spread tells, whatever the clock says. A field of one
    # value is told by its size: no clock counts 1e14 s.
    unit = 1e-9 if last - first > LONGEST_SWEEP or first > 1e14 else 1.0
    seconds = first * unit
    if not (last - first) * unit <= LONGEST_SWEEP or not abs(seconds) < 2.0**33:
        raise WireError(
            f"point field {name!r} runs from {first:g} to {last:g}: neither seconds nor nanoseconds of a sweep"
        )
    # Relative to the header, or the LiDAR's own clock, which may have booted in 1970.
    relative = seconds < RELATIVE and not abs(seconds - cloud.stamp / NS) < abs(seconds)
    start = (cloud.stamp if relative else 0) + round(seconds * NS)
    return start, ((time - first) * unit).astype(np.float32)


def encode_cloud(stamp: int, frame: str, points: NDArray[np.void]) -> bytes:
    """PointCloud2 with the fields of `points`, for the peer and for tests."""
    dtype = points.dtype
    names = dtype.names or ()
    out = bytearray(CDR_HEADER)

    def u32(value: int) -> None:
        out.extend(b"\0" * (-(len(out) - 4) % 4) + struct.pack("<I", value))

    def text(value: str) -> None:
        raw = value.encode() + b"\0"
        u32(len(raw))
        out.extend(raw)

    out += struct.pack("<iI", stamp // NS, stamp % NS)
    text(frame)
    u32(1)
    u32(len(points))
    u32(len(names))
    for name in names:
        assert dtype.fields is not None
        kind, offset = dtype.fields[name][:2]
        text(name)
        u32(offset)
        out.append(_CODES[kind])
        u32(1)
    out.append(0)
    u32(dtype.itemsize)
    u32(dtype.itemsize * len(points))
    u32(dtype.itemsize * len(points))
    out += np.ascontiguousarray(points).tobytes()
    out.append(1)
    return bytes(out)


@dataclass(frozen=True, slots=True)
class RawImu:
    """A sensor_msgs/Imu in the LiDAR's axes."""

    stamp: int
    """[ns], the LiDAR's own clock."""
    quaternion: Array
    """(4,) w, x, y, z."""
    gyro: Array
    """(3,) [rad/s]."""
    accel: Array
    """(3,) [m/s^2]."""


def decode_imu(data: bytes, wxyz: bool = True) -> RawImu:
    """Read an Imu. The L1 stores w, x, y, z where the message says x, y, z, w (`wxyz`). Raises WireError."""
    r = CdrReader(data)
    stamp = r.number("i", 4) * NS + r.u32()
    r.text()
    at = r.at + -(r.at - 4) % 8
    if len(data) < at + 37 * 8:
        raise WireError("imu message ends early")
    values = np.frombuffer(data, "<f8", 37, at)
    quaternion = values[:4] if wxyz else values[[3, 0, 1, 2]]
    return RawImu(stamp, quaternion, values[13:16], values[25:28])


def encode_imu(imu: RawImu, frame: str, wxyz: bool = True) -> bytes:
    """The inverse of `decode_imu`."""
    raw = frame.encode() + b"\0"
    out = CDR_HEADER + struct.pack("<iII", imu.stamp // NS, imu.stamp % NS, len(raw)) + raw
    out += b"\0" * (-(len(out) - 4) % 8)
    values = np.zeros(37)
    values[:4] = imu.quaternion if wxyz else imu.quaternion[[1, 2, 3, 0]]
    values[13:16], values[25:28] = imu.gyro, imu.accel
    return out + values.tobytes()
