"""Values of the libraries to ROS messages and back. Frames are set here and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hal.limbs import MOTORS
from hal.types import POINT_DTYPE, GroundTruth, ImuSample, JointSample, LidarName, LidarScan
from mapping.elevation.exchange import PATCH_LAYERS, MapPatch
from mapping.grid import FARTHEST_PLACE
from rbtrg_robot import msg
from rbtrg_robot.wire.messages import header, stamp_of

if TYPE_CHECKING:
    from mapping.elevation.map import ElevationMap

P = TypeVar("P")
MAP = "map"
ODOM = "odom"
BASE = "base_link"
CAMERA = "camera_"
LIDAR = "lidar_"
"""With the name of a LiDAR behind it: its frame."""
IMU = "imu"

_names = POINT_DTYPE.names or ()
_offsets: dict[str, int] = {name: entry[1] for name, entry in (POINT_DTYPE.fields or {}).items()}
MIN_CELL, MAX_CELL = 1e-3, 10.0
"""Cells that a map may have [m]."""
_FIELD_TYPES = {"f4": 7, "u2": 4}
_FIELDS: list[msg.PointField] = [
    msg.PointField(
        name=name,
        offset=_offsets[name],
        datatype=_FIELD_TYPES[POINT_DTYPE[name].str[1:]],
        count=1,
    )
    for name in _names
]
_XYZ_FIELDS = _FIELDS[:3]


def _constant(*values: float) -> NDArray[np.float64]:
    """An array that messages share."""
    out = np.array(values)
    out.setflags(write=False)
    return out


_UNKNOWN_3, _UNKNOWN_6 = _constant(*[0.0] * 9), _constant(*[0.0] * 36)
"""Covariances that are not known, as ROS writes them."""
_NOT_GIVEN = _constant(-1.0, *[0.0] * 8)
"""Covariance of what a sensor_msgs/Imu does not have."""


class LayoutError(ValueError):
    """A message whose arrays do not have the agreed layout."""


def _floats(values: Any) -> Iterable[float]:
    """As plain floats; taken out of an array one by one they cost three times as much."""
    return values.tolist() if isinstance(values, np.ndarray) else map(float, values)


def vector(values: Any) -> msg.Vector3:
    """From x, y, z."""
    return msg.Vector3(*_floats(values))


def point(values: Any) -> msg.Point:
    """From x, y, z."""
    return msg.Point(*_floats(values))


def quaternion(xyzw: Any) -> msg.Quaternion:
    """geometry_msgs/Quaternion from x, y, z, w."""
    return msg.Quaternion(*_floats(xyzw))


def xyz(message: msg.Point | msg.Vector3) -> NDArray[np.float64]:
    """(3,) of a Point or Vector3."""
    return np.array([message.x, message.y, message.z])


def xyzw(message: msg.Quaternion) -> NDArray[np.float64]:
    """(4,) x, y, z, w of a Quaternion."""
    return np.array([message.x, message.y, message.z, message.w])


def yaw_of(q: msg.Quaternion) -> float:
    """Heading [rad] of a Quaternion message."""
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def up_tilt(q: msg.Quaternion) -> float:
    """Angle [rad] between the body's z axis and gravity of a Quaternion message."""
    return math.acos(max(-1.0, min(1.0, 1 - 2 * (q.x * q.x + q.y * q.y))))


def yaw_quaternion(yaw: float) -> msg.Quaternion:
    """Quaternion message of a heading [rad]."""
    return quaternion((0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


def imu_msg(sample: ImuSample) -> msg.Imu:
    """sensor_msgs/Imu; orientation is not given (covariance[0] = -1)."""
    return msg.Imu(
        header=header(sample.stamp, BASE),
        orientation_covariance=_NOT_GIVEN,
        angular_velocity=vector(sample.gyro),
        angular_velocity_covariance=_UNKNOWN_3,
        linear_acceleration=vector(sample.accel),
        linear_acceleration_covariance=_UNKNOWN_3,
    )


def imu_sample(message: msg.Imu) -> ImuSample:
    """The sample in a sensor_msgs/Imu."""
    return ImuSample(stamp_of(message), xyz(message.angular_velocity), xyz(message.linear_acceleration))


def joint_msg(sample: JointSample) -> msg.JointState:
    """sensor_msgs/JointState with the motors' names in SDK order."""
    return msg.JointState(
        header=header(sample.stamp, BASE),
        name=list(MOTORS),
        position=np.ascontiguousarray(sample.position, np.float64),
        velocity=np.ascontiguousarray(sample.velocity, np.float64),
        effort=np.ascontiguousarray(sample.effort, np.float64),
    )


def joint_sample(message: msg.JointState) -> JointSample:
    """The sample in a JointState. Raises LayoutError where names or lengths differ."""
    if tuple(message.name) != tuple(MOTORS):
        raise LayoutError("joint names are not those of `hal.limbs.MOTORS`, in order")
    if any(len(v) != len(MOTORS) for v in (message.position, message.velocity, message.effort)):
        raise LayoutError("position, velocity and effort must have one value per motor")
    return JointSample(stamp_of(message), message.position, message.velocity, message.effort)


def scan_msg(scan: LidarScan) -> msg.PointCloud2:
    """PointCloud2 with the fields of `POINT_DTYPE`, in the frame of its LiDAR."""
    return _cloud(scan.stamp, LIDAR + scan.name, scan.points, _FIELDS, POINT_DTYPE.itemsize)


def lidar_scan(message: msg.PointCloud2, name: LidarName = "main") -> LidarScan:
    """The sweep of LiDAR `name` in a PointCloud2. Raises LayoutError where fields differ."""
    got = [(f.name, f.offset, f.datatype) for f in message.fields]
    want = [(f.name, f.offset, f.datatype) for f in _FIELDS]
    if got != want or message.point_step != POINT_DTYPE.itemsize or message.is_bigendian:
        raise LayoutError(f"cloud fields are {got}, expected {want}")
    usable = len(message.data) // POINT_DTYPE.itemsize * POINT_DTYPE.itemsize
    return LidarScan(stamp_of(message), message.data[:usable].view(POINT_DTYPE), name)


def cloud_msg(stamp: int, frame: str, points: NDArray[np.float32]) -> msg.PointCloud2:
    """PointCloud2 with x, y, z of (n, 3) float32 [m]."""
    return _cloud(stamp, frame, np.ascontiguousarray(points, np.float32), _XYZ_FIELDS, 12)


def cloud_points(message: msg.PointCloud2) -> NDArray[np.float32]:
    """(n, 3) float32 of a cloud made by `cloud_msg`. Raises LayoutError."""
    if message.point_step != 12 or len(message.data) % 12:
        raise LayoutError(f"expected 12 bytes per point, got {message.point_step}")
    return message.data.view(np.float32).reshape(-1, 3)


def _cloud(
    stamp: int, frame: str, points: NDArray[Any], fields: list[msg.PointField], step: int
) -> msg.PointCloud2:
    count = len(points)
    return msg.PointCloud2(
        header=header(stamp, frame),
        height=1,
        width=count,
        fields=fields,
        is_bigendian=False,
        point_step=step,
        row_step=step * count,
        data=points.reshape(-1).view(np.uint8),
        is_dense=True,
    )


def odometry_msg(
    stamp: int,
    position: Any,
    orientation: Any,
    linear: Any,
    angular: Any,
    covariance: NDArray[np.float64] | None = None,
    frame: str = ODOM,
) -> msg.Odometry:
    """nav_msgs/Odometry, `frame` -> base_link; twist in base_link; covariance (6, 6) of x, y, z, roll, pitch, yaw."""
    pose = msg.PoseWithCovariance(
        pose=msg.Pose(position=point(position), orientation=quaternion(orientation)),
        covariance=_UNKNOWN_6
        if covariance is None
        else np.ascontiguousarray(covariance, np.float64).reshape(36),
    )
    twist = msg.TwistWithCovariance(
        twist=msg.Twist(linear=vector(linear), angular=vector(angular)), covariance=_UNKNOWN_6
    )
    return msg.Odometry(header=header(stamp, frame), child_frame_id=BASE, pose=pose, twist=twist)


def truth_msg(truth: GroundTruth) -> msg.Odometry:
    """Ground truth as nav_msgs/Odometry in frame world."""
    return odometry_msg(
        truth.stamp, truth.position, truth.orientation, truth.linear, truth.angular, frame="world"
    )


def transform_msg(
    stamp: int, parent: str, child: str, translation: Any, orientation: Any
) -> msg.TransformStamped:
    """geometry_msgs/TransformStamped, parent <- child."""
    return msg.TransformStamped(
        header=header(stamp, parent),
        child_frame_id=child,
        transform=msg.Transform(translation=vector(translation), rotation=quaternion(orientation)),
    )


def rpy_quaternion(rpy: tuple[float, float, float]) -> NDArray[np.float64]:
    """(4,) x, y, z, w of fixed-axis roll, pitch, yaw [rad]."""
    cr, cp, cy = (math.cos(a / 2) for a in rpy)
    sr, sp, sy = (math.sin(a / 2) for a in rpy)
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def patch_msg(patch: MapPatch) -> msg.GridMap:
    """grid_map_msgs/GridMap. grid_map counts cells from the +x, +y corner, column-major; ours from the other one."""
    layers = list(patch.layers)
    rows, cols = patch.layers[layers[0]].shape
    message = msg.GridMap(
        header=header(patch.stamp, MAP),
        layers=layers,
        basic_layers=["elevation"],
        data=[_layer_msg(patch.layers[name]) for name in layers],
    )
    message.info.resolution = patch.resolution
    message.info.length_x = cols * patch.resolution
    message.info.length_y = rows * patch.resolution
    message.info.pose.position = point(
        (
            patch.origin[0] + (cols - 1) * patch.resolution / 2,
            patch.origin[1] + (rows - 1) * patch.resolution / 2,
            0.0,
        )
    )
    message.info.pose.orientation.w = 1.0
    return message


def cost_msg(stamp: int, cost: NDArray[np.int8], ground: MapPatch) -> msg.OccupancyGrid:
    """nav_msgs/OccupancyGrid of the cells of `ground` in `map`; `cost` (rows, cols), row 0 in the south, as ROS
    counts."""
    rows, cols = cost.shape
    corner = [value - 0.5 * ground.resolution for value in ground.origin]
    return msg.OccupancyGrid(
        header=header(stamp, MAP),
        info=msg.MapMetaData(
            map_load_time=header(stamp, MAP).stamp,
            resolution=ground.resolution,
            width=cols,
            height=rows,
            origin=msg.Pose(position=point((*corner, 0.0)), orientation=yaw_quaternion(0.0)),
        ),
        data=np.ascontiguousarray(cost, np.int8).reshape(-1),
    )


def map_parts(places: list[P], read: Callable[[P], MapPatch], stamp: int) -> Iterator[msg.MapPart]:
    """A whole map as parts that are read as they are asked for; `stamp` tells those of one sending from others'."""
    for part, place in enumerate(places):
        yield msg.MapPart(header=header(stamp, MAP), part=part, parts=len(places), map=patch_msg(read(place)))


def _layer_msg(layer: NDArray[np.float32]) -> msg.Float32MultiArray:
    rows, cols = layer.shape
    dimension = msg.MultiArrayDimension
    return msg.Float32MultiArray(
        layout=msg.MultiArrayLayout(
            dim=[
                dimension(label="column_index", size=rows, stride=rows * cols),
                dimension(label="row_index", size=cols, stride=cols),
            ],
            data_offset=0,
        ),
        data=np.ascontiguousarray(layer[::-1, ::-1], np.float32).reshape(-1),
    )


def map_patch(message: msg.GridMap, epoch: int) -> MapPatch:
    """The patch in a GridMap made by `patch_msg`; GridMap has no place for the epoch. Raises LayoutError."""
    info = message.info
    sides, place = (info.length_x, info.length_y), (info.pose.position.x, info.pose.position.y)
    within = all(abs(x) + abs(side) < 0.9 * FARTHEST_PLACE for x, side in zip(place, sides, strict=True))
    if not (MIN_CELL <= info.resolution <= MAX_CELL and within):
        raise LayoutError(f"a map of {sides} m at {place} in cells of {info.resolution} m")
    cols, rows = round(info.length_x / info.resolution), round(info.length_y / info.resolution)
    if cols < 1 or rows < 1:
        raise LayoutError(f"a map of {rows} x {cols} cells")
    if len(message.layers) != len(message.data):
        raise LayoutError(f"a map of {len(message.layers)} names for {len(message.data)} layers")
    layers = {}
    for name, data in zip(message.layers, message.data, strict=True):
        if data.data.size != rows * cols:
            raise LayoutError(f"layer {name} has {data.data.size} cells, expected {rows} x {cols}")
        layers[name] = np.ascontiguousarray(data.data.reshape(rows, cols)[::-1, ::-1])
    origin = (
        info.pose.position.x - (cols - 1) * info.resolution / 2,
        info.pose.position.y - (rows - 1) * info.resolution / 2,
    )
    for name in PATCH_LAYERS:
        if name not in layers:
            raise LayoutError(f"layer {name} is missing")
    return MapPatch(origin, info.resolution, stamp_of(message), epoch, layers)


def as_prior(elevation: ElevationMap, stamp: int, name: str) -> msg.MapPrior:
    """A map as it is sent; stamp: of the message [ns], name: by which it is known."""
    blocks = [patch_msg(replace(elevation.read(box), stamp=stamp)) for box in elevation.boxes()]
    cloud = cloud_msg(stamp, MAP, elevation.cloud.points)
    return msg.MapPrior(header=header(stamp, MAP), id=name, map=blocks, cloud=cloud)
