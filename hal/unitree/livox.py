"""`CustomMsg` of livox_ros_driver2, which a Mid-360 on hardware usually sends: CDR bytes to a `RawCloud` and back.

Facts of the type: std_msgs/Header, uint64 timebase, uint32 point_num, uint8 lidar_id, uint8[3] rsvd, then the points.
`timebase` [ns] is the LiDAR's time of the first point, `offset_time` [ns] counts from there."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from hal.types import NS
from hal.unitree.api import WireError
from hal.unitree.cloud import CdrReader, RawCloud
from hal.unitree.layout import CDR_HEADER

POINT = np.dtype(
    {
        "names": ["offset_time", "x", "y", "z", "reflectivity", "tag", "line"],
        "formats": ["<u4", "<f4", "<f4", "<f4", "u1", "u1", "u1"],
        "offsets": [0, 4, 8, 12, 16, 17, 18],
        "itemsize": 20,
    }
)
"""A CustomPoint. CDR aligns the next one to 4 bytes: 19 of the 20 belong to it, and the last one has no more."""


def decode_livox(data: bytes) -> RawCloud:
    """Read a CustomMsg. Raises WireError when it is cut off or counts other points than it holds."""
    r = CdrReader(data)
    header = r.number("i", 4) * NS + r.u32()
    frame = r.text()
    base = r.number("Q", 8)
    told = r.u32()
    r.at += 4  # lidar_id, rsvd
    n = r.u32()
    if n != told:
        raise WireError(f"CustomMsg of {told} points has {n}")
    missing = r.at + n * POINT.itemsize - len(data)
    if n and missing > 1:
        raise WireError(f"CustomMsg ends {missing - 1} bytes early")
    points = np.frombuffer(data + b"\0" if n and missing == 1 else data, POINT, n, r.at)
    return RawCloud(base or header, frame, points)


def encode_livox(stamp: int, frame: str, points: NDArray[np.void]) -> bytes:
    """CustomMsg of `points` (x, y, z [m], time [s], intensity, ring) that begin at `stamp` [ns], for tests."""
    raw = frame.encode() + b"\0"
    out = bytearray(CDR_HEADER + struct.pack("<iII", stamp // NS, stamp % NS, len(raw)) + raw)
    out += b"\0" * (-(len(out) - 4) % 8) + struct.pack("<QIBxxxI", stamp, len(points), 0, len(points))
    packed = np.zeros(len(points), POINT)
    for axis in "xyz":
        packed[axis] = points[axis]
    packed["offset_time"] = np.rint(points["time"].astype(np.float64) * NS)
    packed["reflectivity"], packed["line"] = points["intensity"], points["ring"]
    out += packed.tobytes()
    return bytes(out[:-1] if len(points) else out)
