"""PointCloud2 and Imu of the robot's LiDAR topics: CDR bytes to `POINT_DTYPE` and back, without per-point Python.

The point layout differs by driver and firmware, so it is read from the message: x y z are needed; intensity, ring and
a per-point time (`time` or `t` relative, `timestamp` absolute) are taken where present.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.safety.monitors import POINT_TIMES
from hal.sweep_times import SHORTEST, TimesError, sweep_times
from hal.types import NS, POINT_DTYPE, POINT_QUANTUM, TIME_QUANTUM, Array
from hal.unitree.api import WireError
from hal.unitree.layout import CDR_HEADER

_DATATYPES = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
"""sensor_msgs/PointField datatype codes."""
_CODES = {np.dtype(v): k for k, v in _DATATYPES.items()}
RELATIVE_BELOW = 1e3
"""[s]: times below are relative to the header, unless the header is that early too."""
TIME_NAMES = ("time", "t", "timestamp", "time_stamp", "offset_time")
_SURE_POINTS = 100
"""Points from which the unit of a time field is believed for the sweeps that follow."""


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
    """Copy the points that are finite, within range and within the sweep, rounded as POINT_DTYPE says; returns how
    many."""
    n = 0
    for i in range(x.size):
        squared = x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
        if not (near * near <= squared <= far * far and time[i] >= 0.0):  # NaN compares false
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
    """Which returns of a LiDAR to keep, by distance [m]. Odometry removes those from the robot itself
    (`mapping.odometry.own`)."""

    min_range: float = 0.2
    max_range: float = 30.0


def sweep(
    cloud: RawCloud, limits: Limits, unit: float | None = None
) -> tuple[int, NDArray[np.void], float | None]:
    """Start of the sweep [ns, LiDAR clock], its valid returns as `POINT_DTYPE` in the LiDAR frame, and the unit of
    its times.

    `unit` [s]: that of a sweep before, None before the first with enough points. Raises WireError for times of no
    sweep."""
    raw = cloud.points
    names = raw.dtype.names or ()
    n = len(raw)
    x, y, z = (_column(raw[axis], np.float32) for axis in "xyz")
    with np.errstate(over="ignore", invalid="ignore"):
        square = x * x + y * y + z * z
        hit = (square >= limits.min_range**2) & (square < np.inf)
    start, time, unit = _times(cloud, hit, unit)
    ring = next((name for name in ("ring", "line") if name in names), None)
    bright = next((name for name in ("intensity", "reflectivity") if name in names), None)
    out = np.empty(n, POINT_DTYPE)
    kept = _pack(  # type: ignore[call-arg]
        x,
        y,
        z,
        _column(raw[bright], np.float32) if bright is not None else np.zeros(n, np.float32),
        _column(raw[ring], np.uint16) if ring is not None else np.zeros(n, np.uint16),
        time,
        limits.min_range,
        limits.max_range,
        out,
    )
    return start, out[:kept], unit


def _column(values: NDArray, dtype: type) -> NDArray:
    """A contiguous copy: one compiled kernel instead of one per alignment and layout."""
    return values.astype(dtype)


def _times(
    cloud: RawCloud, hit: NDArray[np.bool_], unit: float | None
) -> tuple[int, NDArray[np.float32], float | None]:
    """Start of the sweep [ns, LiDAR clock], the seconds since then per point, NaN for strays, and the unit [s]."""
    raw = cloud.points
    name = next((name for name in TIME_NAMES if name in (raw.dtype.names or ())), None)
    if name is None or not hit.any():
        return cloud.stamp, np.zeros(len(raw), np.float32), unit
    field = raw[name]
    try:
        times = sweep_times(field, hit, 1e-9 if name == "offset_time" else unit, cloud.stamp)
    except TimesError as error:
        raise WireError(POINT_TIMES.tell(field=name, held=error)) from error
    # Relative to the header, or the LiDAR's own clock, which may have booted in 1970. Single precision is too coarse
    # for a clock.
    first = times.first
    relative = abs(first) < RELATIVE_BELOW * NS and not abs(first - cloud.stamp) < abs(first)
    if raw.dtype[name] == np.float32 and not relative:
        raise WireError(
            POINT_TIMES.tell(field=name, held=f"{first / NS / times.unit:g}, too coarse for a clock")
        )
    # The header tells the begin of the sweep, or its end where times are negative.
    counted = relative and first >= 0
    seconds, start = times.seconds(since_first=not counted), first + (cloud.stamp if relative else 0)
    start = cloud.stamp if counted else start
    sure = np.count_nonzero(times.inside) >= _SURE_POINTS and np.nanmax(seconds) > SHORTEST
    return start, seconds.astype(np.float32), times.unit if sure else unit


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
