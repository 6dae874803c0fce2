"""Sweeps as `recorder.profile=standard` writes them: a quarter of their size, and back to the same bytes.

The values of a sweep are multiples of a quantum (`hal.types.POINT_QUANTUM`), and a point lies near the one before it
on the same ring. So each field becomes a column of small whole numbers: differences to the point before on the ring.
Its bytes are compressed plane by plane, lowest bytes first. A value that is no such multiple (-0.0, NaN) is kept as
it is, beside the columns."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator

import numpy as np
import zstandard
from numpy.typing import NDArray

from hal.types import POINT_DTYPE, POINT_QUANTUM, TIME_QUANTUM
from rbtrg_robot import msg
from rbtrg_robot.wire.convert import LayoutError, lidar_scan
from rbtrg_robot.wire.messages import MessageError, decode, encode

COLUMNS = "rbtrg_columns"
"""`format` of points in columns."""
VERBATIM = "rbtrg_verbatim"
"""`format` of a whole PointCloud2 as it was on the wire: one whose fields are not those of `POINT_DTYPE`, or that is
broken."""
MOST_POINTS = 1 << 21
"""Points that a packed sweep may claim to have."""
_QUANTA = {"x": POINT_QUANTUM, "y": POINT_QUANTUM, "z": POINT_QUANTUM, "intensity": 1.0, "time": TIME_QUANTUM}
_LARGEST_MULTIPLE = 2.0**29
"""Multiples from this on are kept as they are: differences must fit 32 bits."""
_SIZE = struct.Struct("<I")
_COMPRESSOR = zstandard.ZstdCompressor(level=3)
_DECOMPRESSOR = zstandard.ZstdDecompressor()


class PackedError(ValueError):
    """Bytes that are no packed sweep."""


class ForeignError(PackedError):
    """A sweep that another program packed."""


def pack(payload: bytes) -> bytes:
    """CompressedPointCloud2 (CDR) of a PointCloud2 (CDR). `unpack` gives the same bytes back, also those of a broken
    message."""
    cloud, data, form = msg.PointCloud2(), payload, VERBATIM
    with contextlib.suppress(MessageError, LayoutError):
        cloud = decode(payload, msg.PointCloud2)
        points = lidar_scan(cloud).points
        whole = len(cloud.data) == cloud.width * POINT_DTYPE.itemsize
        if whole and cloud.width <= MOST_POINTS and encode(cloud) == payload:
            data, form = _pack_points(points), COLUMNS
    return encode(
        msg.CompressedPointCloud2(
            cloud.header,
            cloud.height,
            cloud.width,
            cloud.fields,
            cloud.is_bigendian,
            cloud.point_step,
            cloud.row_step,
            np.frombuffer(data, np.uint8),
            cloud.is_dense,
            form,
        )
    )


def unpack(payload: bytes) -> bytes:
    """The PointCloud2 (CDR) that was packed. Raises ForeignError, PackedError and MessageError."""
    packed = decode(payload, msg.CompressedPointCloud2)
    if packed.format == VERBATIM:
        return packed.compressed_data.tobytes()
    if packed.format != COLUMNS:
        raise ForeignError(f"a sweep in the form {packed.format!r}, which is another program's")
    if packed.width > MOST_POINTS:
        raise PackedError(f"a sweep of {packed.width} points in the form {packed.format!r}")
    points = _unpack_points(packed.compressed_data.tobytes(), packed.width)
    return encode(
        msg.PointCloud2(
            packed.header,
            packed.height,
            packed.width,
            packed.fields,
            packed.is_bigendian,
            packed.point_step,
            packed.row_step,
            points.view(np.uint8),
            packed.is_dense,
        )
    )


def _pack_points(points: NDArray[np.void]) -> bytes:
    """Frames of zstd, each behind its length: planes of the rings; then for each field its planes and the values kept
    as they are."""
    ring = points["ring"].astype(np.int64)
    frames = _pack_column(ring)
    order = np.argsort(ring, kind="stable")
    for name, quantum in _QUANTA.items():
        value = points[name][order]
        rounded = np.rint(value.astype(np.float64) / quantum)
        multiple = np.where(np.abs(rounded) < _LARGEST_MULTIPLE, rounded, 0.0).astype(np.int64)
        kept = np.flatnonzero(
            (multiple * quantum).astype(np.float32).view(np.uint32) != value.view(np.uint32)
        )
        frames += _pack_column(multiple)
        frames += [kept.astype("<u4").tobytes(), value[kept].tobytes()]
    packed = [_COMPRESSOR.compress(frame) for frame in frames]
    return b"".join(part for frame in packed for part in (_SIZE.pack(len(frame)), frame))


def _unpack_points(data: bytes, count: int) -> NDArray[np.void]:
    """(count,) points of `POINT_DTYPE`. Raises PackedError."""
    frames = _frames(data)
    points = np.zeros(count, POINT_DTYPE)
    ring = _unpack_column(frames, count)
    points["ring"] = ring
    order = np.argsort(ring, kind="stable")
    for name, quantum in _QUANTA.items():
        value = (_unpack_column(frames, count) * quantum).astype(np.float32)
        kept = np.frombuffer(_next(frames, count * 4), "<u4")
        bits = np.frombuffer(_next(frames, count * 4), np.float32)
        if kept.size != bits.size or (kept >= count).any():
            raise PackedError("values that are kept beside their column do not fit it")
        value[kept] = bits
        points[name][order] = value
    if next(frames, None) is not None:
        raise PackedError("more columns than a sweep has")
    return points


def _pack_column(values: NDArray[np.int64]) -> list[bytes]:
    """Four planes of bytes of the differences, the lowest first. Small numbers of either sign have zeros in the upper
    ones."""
    difference = np.diff(values, prepend=0)
    folded = ((difference << 1) ^ (difference >> 63)).astype("<u4")
    return [plane.tobytes() for plane in folded.view(np.uint8).reshape(-1, 4).T]


def _unpack_column(frames: Iterator[bytes], count: int) -> NDArray[np.int64]:
    """(count,) values. Raises PackedError."""
    planes = np.zeros((count, 4), np.uint8)
    for k in range(4):
        plane = _next(frames, count)
        if len(plane) != count:
            raise PackedError(f"a column has {len(plane)} bytes for {count} points")
        planes[:, k] = np.frombuffer(plane, np.uint8)
    folded = planes.view("<u4")[:, 0].astype(np.int64)
    return np.cumsum((folded >> 1) ^ -(folded & 1))


def _frames(data: bytes) -> Iterator[bytes]:
    """The compressed frames. Raises PackedError where one is cut off."""
    at = 0
    while at < len(data):
        if at + _SIZE.size > len(data):
            raise PackedError("a length is cut off")
        (size,) = _SIZE.unpack_from(data, at)
        at += _SIZE.size + size
        if at > len(data):
            raise PackedError("a column is cut off")
        yield data[at - size : at]


def _next(frames: Iterator[bytes], most: int) -> bytes:
    """The next frame's bytes, at most `most`. Raises PackedError."""
    frame = next(frames, None)
    if frame is None:
        raise PackedError("a column is missing")
    try:
        if not 0 <= zstandard.frame_content_size(frame) <= most:  # before the memory for it is taken
            raise PackedError("a column is larger than its points")
        return _DECOMPRESSOR.decompress(frame)
    except zstandard.ZstdError as error:
        raise PackedError(f"a column is damaged: {error}") from error
