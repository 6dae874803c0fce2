"""Bags of robots that are not ours: layouts of clouds, kinds of containers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hal.types import NS, POINT_DTYPE
from hal.unitree.cloud import encode_cloud
from hal.unitree.livox import encode_livox
from rbtrg_robot import msg
from rbtrg_robot.wire.messages import decode, encode, header

START_STAMP = 1_700_000_000 * NS
LIVOX = "livox_ros_driver2/msg/CustomMsg"
LIVOX_TEXT = """std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
CustomPoint[] points
================================================================================
MSG: livox_ros_driver2/CustomPoint
uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""
Message = tuple[str, str, int, bytes]
"""Topic, type, time of the record [ns], CDR."""

XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
LAYOUTS: dict[str, tuple[str, np.dtype]] = {
    # name of the layout: field of the times, fields of a point as its driver sends them
    "ouster": ("t", np.dtype({"names": ["x", "y", "z", "intensity", "t", "reflectivity", "ring", "ambient", "range"], "formats": ["<f4", "<f4", "<f4", "<f4", "<u4", "<u2", "<u2", "<u2", "<u4"], "offsets": [0, 4, 8, 16, 20, 24, 26, 28, 32], "itemsize": 48})),
    "velodyne": ("time", np.dtype([*XYZ, ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])),
    "hesai": ("timestamp", np.dtype({"names": ["x", "y", "z", "intensity", "timestamp", "ring"], "formats": ["<f4", "<f4", "<f4", "<f4", "<f8", "<u2"], "offsets": [0, 4, 8, 12, 16, 24], "itemsize": 26})),
    "robosense": ("timestamp", np.dtype([*XYZ, ("intensity", "u1"), ("ring", "<u2"), ("timestamp", "<f8")])),
    "livox": ("timestamp", np.dtype([*XYZ, ("intensity", "<f4"), ("tag", "u1"), ("line", "u1"), ("timestamp", "<f8")])),
    "unitree l1": ("time", np.dtype({"names": ["x", "y", "z", "intensity", "ring", "time"], "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"], "offsets": [0, 4, 8, 16, 20, 24], "itemsize": 32})),
}  # fmt: skip


def room(seed: int = 0, place: float = 0.0, count: int = 3000) -> NDArray[np.void]:
    """A sweep (POINT_DTYPE) of a floor and four walls seen from x = `place` [m], 0.4 m above the floor."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(-np.pi, np.pi, count, endpoint=False)
    elevation = rng.uniform(-0.6, 0.3, count)
    d = np.stack([np.cos(elevation) * np.cos(angle), np.cos(elevation) * np.sin(angle), np.sin(elevation)], 1)
    lows, highs = np.array([-4.0 - place, -3.0, -0.4]), np.array([5.0 - place, 3.5, 3.0])
    with np.errstate(divide="ignore"):
        far = np.min(np.where(d > 0, highs / d, np.where(d < 0, lows / d, np.inf)), axis=1)
    points = np.zeros(count, POINT_DTYPE)
    points["x"], points["y"], points["z"] = (d * far[:, None]).T
    points["intensity"], points["ring"] = rng.integers(0, 255, count), rng.integers(0, 16, count)
    points["time"] = np.linspace(0.0, 0.0999, count)
    return points


def cloud(layout: str, points: NDArray[np.void], stamp: int, frame: str = "lidar") -> bytes:
    """Points as the driver of a layout sends them (CDR)."""
    if layout == "livox custom":
        return encode_livox(stamp, frame, points)
    if layout == "organised":
        wide = points[: len(points) // 2 * 2].copy()
        wide["x"][::7] = np.nan
        message = decode(encode_cloud(stamp, frame, wide), msg.PointCloud2)
        message.height, message.width = 2, len(wide) // 2
        message.row_step = message.width * message.point_step
        return encode(message)
    time, dtype = LAYOUTS[layout]
    out = np.zeros(len(points), dtype)
    for name in ("x", "y", "z", "intensity", "ring", "line"):
        source = "ring" if name == "line" else name
        if name in (dtype.names or ()):
            out[name] = points[source]
    seconds = points["time"].astype(np.float64)
    absolute = time == "timestamp"
    scale = 1e9 if dtype[time].kind == "u" or layout == "livox" else 1.0
    out[time] = (seconds + (stamp / NS if absolute else 0.0)) * scale
    return encode_cloud(stamp, frame, out)


def sweeps(layout: str, count: int = 12, topic: str = "/points", frame: str = "lidar") -> list[Message]:
    """A robot that drives through the room at 0.5 m/s."""
    kind = LIVOX if layout == "livox custom" else msg.PointCloud2.__msgtype__
    out = []
    for k in range(count):
        stamp = START_STAMP + k * NS // 10
        out.append((topic, kind, stamp + NS // 10, cloud(layout, room(k, 0.05 * k), stamp, frame)))
    return out


def imu(
    seconds: float,
    accel: tuple[float, float, float] = (0.0, 0.0, 9.81),
    topic: str = "/imu",
    frame: str = "imu",
) -> list[Message]:
    """200 Hz of a robot that does not turn, with the noise that a real sensor has."""
    out = []
    noise = np.random.default_rng(0).normal(0.0, (1e-3,) * 3 + (1e-2,) * 3, (round(seconds * 200), 6))
    for k, (x, y, z, *shaken) in enumerate(noise.tolist()):
        stamp = START_STAMP + k * NS // 200
        message = msg.Imu(
            header=header(stamp, frame),
            angular_velocity=msg.Vector3(x, y, z),
            linear_acceleration=msg.Vector3(*np.add(accel, shaken).tolist()),
        )
        out.append((topic, msg.Imu.__msgtype__, stamp + 1_000_000, encode(message)))
    return out


def static(
    parent: str,
    child: str,
    place: tuple[float, float, float],
    topic: str = "/tf_static",
    turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
) -> Message:
    """A transform that never changes; `turn`: quaternion x, y, z, w."""
    transform = msg.TransformStamped(
        header=header(START_STAMP, parent),
        child_frame_id=child,
        transform=msg.Transform(translation=msg.Vector3(*place), rotation=msg.Quaternion(*turn)),
    )
    return topic, msg.TFMessage.__msgtype__, START_STAMP, encode(msg.TFMessage(transforms=[transform]))


def write(path: Path, messages: Iterable[Message], kind: str = "mcap") -> Path:
    """A bag of one kind: mcap, db3, zstd (db3, file by file), messages (mcap, message by message), bag (ROS 1)."""
    ordered = sorted(messages, key=lambda m: m[2])
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(LIVOX_TEXT, LIVOX))
    if kind == "bag":
        path = path.with_suffix(".bag")
        one = get_typestore(Stores.ROS1_NOETIC)
        one.register(get_types_from_msg(LIVOX_TEXT, LIVOX))
        one.register(
            get_types_from_msg("geometry_msgs/TransformStamped[] transforms", msg.TFMessage.__msgtype__)
        )
        with Writer1(path) as bag:
            connections = {
                (t, k): bag.add_connection(t, k, typestore=one) for t, k in {m[:2] for m in ordered}
            }
            for topic, name, stamp, data in ordered:
                try:
                    raw = _ros1(one, store, data, name)
                except Exception:  # noqa: BLE001  it was made to be broken
                    raw = data
                bag.write(connections[topic, name], stamp, raw)
        return path
    plugin = StoragePlugin.SQLITE3 if kind in ("db3", "zstd") else StoragePlugin.MCAP
    writer = Writer2(path, version=9, storage_plugin=plugin)
    if kind == "zstd":
        writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    if kind == "messages":
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        held = {(t, k): writer.add_connection(t, k, typestore=store) for t, k in {m[:2] for m in ordered}}
        for topic, name, stamp, data in ordered:
            writer.write(held[topic, name], stamp, data)
    return path


def _ros1(one, store, data: bytes, name: str) -> bytes:  # type: ignore[no-untyped-def]
    """CDR as ROS 1 writes it: its header has a number more."""
    message = store.deserialize_cdr(data, name)

    def headed(part):  # type: ignore[no-untyped-def]
        if getattr(part, "__msgtype__", "") == "std_msgs/msg/Header":
            return one.types["std_msgs/msg/Header"](seq=7, stamp=part.stamp, frame_id=part.frame_id)
        if hasattr(part, "__dataclass_fields__"):
            names = [n for n in part.__dataclass_fields__ if n != "__msgtype__"]
            kind = one.types[part.__msgtype__]
            return kind(**{n: headed(getattr(part, n)) for n in names})
        return [headed(p) for p in part] if isinstance(part, list) else part

    return bytes(one.serialize_ros1(headed(message), name))
