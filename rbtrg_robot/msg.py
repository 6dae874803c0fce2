"""The messages as dataclasses. Fields that are not given get ROS defaults: zero, empty.

Written by `python -m tools.messages` from the .msg definitions, which also tell the units: change those, not this file.
Arrays of a decoded message are views on its bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Message:
    """What every message is."""

    __slots__ = ()
    __msgtype__: ClassVar[str]


def _zeros(dtype: str, length: int) -> Any:
    import numpy as np  # late: the topics are listed without it

    return np.zeros(length, dtype)


@dataclass(slots=True, eq=False)
class Time(Message):
    """builtin_interfaces/msg/Time."""

    __msgtype__ = "builtin_interfaces/msg/Time"
    sec: int = 0
    nanosec: int = 0


@dataclass(slots=True, eq=False)
class Header(Message):
    """std_msgs/msg/Header."""

    __msgtype__ = "std_msgs/msg/Header"
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass(slots=True, eq=False)
class KeyValue(Message):
    """diagnostic_msgs/msg/KeyValue."""

    __msgtype__ = "diagnostic_msgs/msg/KeyValue"
    key: str = ""
    value: str = ""


@dataclass(slots=True, eq=False)
class DiagnosticStatus(Message):
    """diagnostic_msgs/msg/DiagnosticStatus."""

    __msgtype__ = "diagnostic_msgs/msg/DiagnosticStatus"
    OK: ClassVar[int] = 0
    WARN: ClassVar[int] = 1
    ERROR: ClassVar[int] = 2
    STALE: ClassVar[int] = 3
    level: int = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: list[KeyValue] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class DiagnosticArray(Message):
    """diagnostic_msgs/msg/DiagnosticArray."""

    __msgtype__ = "diagnostic_msgs/msg/DiagnosticArray"
    header: Header = field(default_factory=Header)
    status: list[DiagnosticStatus] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Point(Message):
    """geometry_msgs/msg/Point."""

    __msgtype__ = "geometry_msgs/msg/Point"
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(slots=True, eq=False)
class Quaternion(Message):
    """geometry_msgs/msg/Quaternion."""

    __msgtype__ = "geometry_msgs/msg/Quaternion"
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 0.0


@dataclass(slots=True, eq=False)
class Pose(Message):
    """geometry_msgs/msg/Pose."""

    __msgtype__ = "geometry_msgs/msg/Pose"
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass(slots=True, eq=False)
class PoseStamped(Message):
    """geometry_msgs/msg/PoseStamped."""

    __msgtype__ = "geometry_msgs/msg/PoseStamped"
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass(slots=True, eq=False)
class PoseWithCovariance(Message):
    """geometry_msgs/msg/PoseWithCovariance."""

    __msgtype__ = "geometry_msgs/msg/PoseWithCovariance"
    pose: Pose = field(default_factory=Pose)
    covariance: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 36))


@dataclass(slots=True, eq=False)
class PoseWithCovarianceStamped(Message):
    """geometry_msgs/msg/PoseWithCovarianceStamped."""

    __msgtype__ = "geometry_msgs/msg/PoseWithCovarianceStamped"
    header: Header = field(default_factory=Header)
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)


@dataclass(slots=True, eq=False)
class Vector3(Message):
    """geometry_msgs/msg/Vector3."""

    __msgtype__ = "geometry_msgs/msg/Vector3"
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(slots=True, eq=False)
class Twist(Message):
    """geometry_msgs/msg/Twist."""

    __msgtype__ = "geometry_msgs/msg/Twist"
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass(slots=True, eq=False)
class TwistStamped(Message):
    """geometry_msgs/msg/TwistStamped."""

    __msgtype__ = "geometry_msgs/msg/TwistStamped"
    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@dataclass(slots=True, eq=False)
class GridMapInfo(Message):
    """grid_map_msgs/msg/GridMapInfo."""

    __msgtype__ = "grid_map_msgs/msg/GridMapInfo"
    resolution: float = 0.0
    length_x: float = 0.0
    length_y: float = 0.0
    pose: Pose = field(default_factory=Pose)


@dataclass(slots=True, eq=False)
class MultiArrayDimension(Message):
    """std_msgs/msg/MultiArrayDimension."""

    __msgtype__ = "std_msgs/msg/MultiArrayDimension"
    label: str = ""
    size: int = 0
    stride: int = 0


@dataclass(slots=True, eq=False)
class MultiArrayLayout(Message):
    """std_msgs/msg/MultiArrayLayout."""

    __msgtype__ = "std_msgs/msg/MultiArrayLayout"
    dim: list[MultiArrayDimension] = field(default_factory=list)
    data_offset: int = 0


@dataclass(slots=True, eq=False)
class Float32MultiArray(Message):
    """std_msgs/msg/Float32MultiArray."""

    __msgtype__ = "std_msgs/msg/Float32MultiArray"
    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: NDArray[np.float32] = field(default_factory=lambda: _zeros("float32", 0))


@dataclass(slots=True, eq=False)
class GridMap(Message):
    """grid_map_msgs/msg/GridMap."""

    __msgtype__ = "grid_map_msgs/msg/GridMap"
    header: Header = field(default_factory=Header)
    info: GridMapInfo = field(default_factory=GridMapInfo)
    layers: list[str] = field(default_factory=list)
    basic_layers: list[str] = field(default_factory=list)
    data: list[Float32MultiArray] = field(default_factory=list)
    outer_start_index: int = 0
    inner_start_index: int = 0


@dataclass(slots=True, eq=False)
class MapMetaData(Message):
    """nav_msgs/msg/MapMetaData."""

    __msgtype__ = "nav_msgs/msg/MapMetaData"
    map_load_time: Time = field(default_factory=Time)
    resolution: float = 0.0
    width: int = 0
    height: int = 0
    origin: Pose = field(default_factory=Pose)


@dataclass(slots=True, eq=False)
class OccupancyGrid(Message):
    """nav_msgs/msg/OccupancyGrid."""

    __msgtype__ = "nav_msgs/msg/OccupancyGrid"
    header: Header = field(default_factory=Header)
    info: MapMetaData = field(default_factory=MapMetaData)
    data: NDArray[np.int8] = field(default_factory=lambda: _zeros("int8", 0))


@dataclass(slots=True, eq=False)
class TwistWithCovariance(Message):
    """geometry_msgs/msg/TwistWithCovariance."""

    __msgtype__ = "geometry_msgs/msg/TwistWithCovariance"
    twist: Twist = field(default_factory=Twist)
    covariance: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 36))


@dataclass(slots=True, eq=False)
class Odometry(Message):
    """nav_msgs/msg/Odometry."""

    __msgtype__ = "nav_msgs/msg/Odometry"
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)


@dataclass(slots=True, eq=False)
class Path(Message):
    """nav_msgs/msg/Path."""

    __msgtype__ = "nav_msgs/msg/Path"
    header: Header = field(default_factory=Header)
    poses: list[PoseStamped] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class PointField(Message):
    """sensor_msgs/msg/PointField."""

    __msgtype__ = "sensor_msgs/msg/PointField"
    INT8: ClassVar[int] = 1
    UINT8: ClassVar[int] = 2
    INT16: ClassVar[int] = 3
    UINT16: ClassVar[int] = 4
    INT32: ClassVar[int] = 5
    UINT32: ClassVar[int] = 6
    FLOAT32: ClassVar[int] = 7
    FLOAT64: ClassVar[int] = 8
    name: str = ""
    offset: int = 0
    datatype: int = 0
    count: int = 0


@dataclass(slots=True, eq=False)
class CompressedPointCloud2(Message):
    """point_cloud_interfaces/msg/CompressedPointCloud2."""

    __msgtype__ = "point_cloud_interfaces/msg/CompressedPointCloud2"
    header: Header = field(default_factory=Header)
    height: int = 0
    width: int = 0
    fields: list[PointField] = field(default_factory=list)
    is_bigendian: bool = False
    point_step: int = 0
    row_step: int = 0
    compressed_data: NDArray[np.uint8] = field(default_factory=lambda: _zeros("uint8", 0))
    is_dense: bool = False
    format: str = ""


@dataclass(slots=True, eq=False)
class GroundArea(Message):
    """rbtrg_msgs/msg/GroundArea."""

    __msgtype__ = "rbtrg_msgs/msg/GroundArea"
    name: str = ""
    keep_out: bool = False
    corners: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))


@dataclass(slots=True, eq=False)
class Areas(Message):
    """rbtrg_msgs/msg/Areas."""

    __msgtype__ = "rbtrg_msgs/msg/Areas"
    header: Header = field(default_factory=Header)
    id: str = ""
    refused: str = ""
    areas: list[GroundArea] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Event(Message):
    """rbtrg_msgs/msg/Event."""

    __msgtype__ = "rbtrg_msgs/msg/Event"
    INFO: ClassVar[int] = 0
    WARNING: ClassVar[int] = 1
    ERROR: ClassVar[int] = 2
    header: Header = field(default_factory=Header)
    logged: int = 0
    number: int = 0
    severity: int = 0
    kind: str = ""
    text: str = ""
    who: str = ""
    has_place: bool = False
    x: float = 0.0
    y: float = 0.0


@dataclass(slots=True, eq=False)
class ExploreQuestion(Message):
    """rbtrg_msgs/msg/ExploreQuestion."""

    __msgtype__ = "rbtrg_msgs/msg/ExploreQuestion"
    header: Header = field(default_factory=Header)
    sequence: int = 0
    start_x: float = 0.0
    start_y: float = 0.0
    has_home: bool = False
    home_x: float = 0.0
    home_y: float = 0.0
    has_target: bool = False
    target_x: float = 0.0
    target_y: float = 0.0
    area: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    barred: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    anew: bool = False


@dataclass(slots=True, eq=False)
class GoalRequest(Message):
    """rbtrg_msgs/msg/GoalRequest."""

    __msgtype__ = "rbtrg_msgs/msg/GoalRequest"
    SET: ClassVar[int] = 0
    CANCEL: ClassVar[int] = 1
    header: Header = field(default_factory=Header)
    id: str = ""
    owner: str = ""
    action: int = 0
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    has_yaw: bool = False
    name: str = ""
    timeout: float = 0.0
    accept_risk: bool = False
    no_return: bool = False


@dataclass(slots=True, eq=False)
class GoalStatus(Message):
    """rbtrg_msgs/msg/GoalStatus."""

    __msgtype__ = "rbtrg_msgs/msg/GoalStatus"
    header: Header = field(default_factory=Header)
    id: str = ""
    owner: str = ""
    state: str = ""
    reason: str = ""
    detail: str = ""
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    has_yaw: bool = False
    no_return: bool = False
    distance_left: float = 0.0
    replans: int = 0
    recoveries: int = 0
    risk: float = 0.0
    frontier: bool = False
    p_fail: float = 0.0
    worst: str = ""
    chance_change: str = ""


@dataclass(slots=True, eq=False)
class Heartbeat(Message):
    """rbtrg_msgs/msg/Heartbeat."""

    __msgtype__ = "rbtrg_msgs/msg/Heartbeat"
    header: Header = field(default_factory=Header)
    process: str = ""
    pid: int = 0
    state: str = ""
    detail: str = ""
    topic: list[str] = field(default_factory=list)
    published: NDArray[np.uint64] = field(default_factory=lambda: _zeros("uint64", 0))
    newest: NDArray[np.int64] = field(default_factory=lambda: _zeros("int64", 0))
    dropped: int = 0
    refused: int = 0
    longest_turn: float = 0.0


@dataclass(slots=True, eq=False)
class Journal(Message):
    """rbtrg_msgs/msg/Journal."""

    __msgtype__ = "rbtrg_msgs/msg/Journal"
    header: Header = field(default_factory=Header)
    process: str = ""
    topic: list[str] = field(default_factory=list)
    taken: NDArray[np.uint8] = field(default_factory=lambda: _zeros("uint8", 0))
    sequence: NDArray[np.uint32] = field(default_factory=lambda: _zeros("uint32", 0))
    stamp: NDArray[np.int64] = field(default_factory=lambda: _zeros("int64", 0))


@dataclass(slots=True, eq=False)
class MapPart(Message):
    """rbtrg_msgs/msg/MapPart."""

    __msgtype__ = "rbtrg_msgs/msg/MapPart"
    header: Header = field(default_factory=Header)
    part: int = 0
    parts: int = 0
    map: GridMap = field(default_factory=GridMap)


@dataclass(slots=True, eq=False)
class PointCloud2(Message):
    """sensor_msgs/msg/PointCloud2."""

    __msgtype__ = "sensor_msgs/msg/PointCloud2"
    header: Header = field(default_factory=Header)
    height: int = 0
    width: int = 0
    fields: list[PointField] = field(default_factory=list)
    is_bigendian: bool = False
    point_step: int = 0
    row_step: int = 0
    data: NDArray[np.uint8] = field(default_factory=lambda: _zeros("uint8", 0))
    is_dense: bool = False


@dataclass(slots=True, eq=False)
class MapPrior(Message):
    """rbtrg_msgs/msg/MapPrior."""

    __msgtype__ = "rbtrg_msgs/msg/MapPrior"
    header: Header = field(default_factory=Header)
    id: str = ""
    map: list[GridMap] = field(default_factory=list)
    cloud: PointCloud2 = field(default_factory=PointCloud2)
    areas: list[GroundArea] = field(default_factory=list)
    odom_in_map: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    until: Time = field(default_factory=Time)


@dataclass(slots=True, eq=False)
class MapRequest(Message):
    """rbtrg_msgs/msg/MapRequest."""

    __msgtype__ = "rbtrg_msgs/msg/MapRequest"
    header: Header = field(default_factory=Header)
    action: str = ""


@dataclass(slots=True, eq=False)
class MapStatus(Message):
    """rbtrg_msgs/msg/MapStatus."""

    __msgtype__ = "rbtrg_msgs/msg/MapStatus"
    header: Header = field(default_factory=Header)
    epoch: int = 0
    scans: int = 0
    tiles: int = 0
    known_cells: int = 0
    trusted_cells: int = 0
    resolution: float = 0.0
    height_correction: float = 0.0
    restoring: bool = False
    warning: str = ""
    prior: str = ""
    touched: int = 0
    refused: int = 0
    detail: str = ""
    location: str = ""
    location_detail: str = ""
    odom_in_map: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 3))
    candidates: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))


@dataclass(slots=True, eq=False)
class MissionLoop(Message):
    """rbtrg_msgs/msg/MissionLoop."""

    __msgtype__ = "rbtrg_msgs/msg/MissionLoop"
    first: int = 0
    last: int = 0
    times: int = 0


@dataclass(slots=True, eq=False)
class MissionStep(Message):
    """rbtrg_msgs/msg/MissionStep."""

    __msgtype__ = "rbtrg_msgs/msg/MissionStep"
    id: str = ""
    kind: str = ""
    blocking_type: str = ""
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    has_yaw: bool = False
    pitch: float = 0.0
    duration: float = 0.0
    timeout: float = 0.0
    text: str = ""
    choices: list[str] = field(default_factory=list)
    area: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    until: float = 0.0
    swath: float = 0.0
    on_failure: str = ""
    retries: int = 0
    accept_risk: bool = False


@dataclass(slots=True, eq=False)
class MissionOrder(Message):
    """rbtrg_msgs/msg/MissionOrder."""

    __msgtype__ = "rbtrg_msgs/msg/MissionOrder"
    header: Header = field(default_factory=Header)
    order_id: str = ""
    order_update_id: int = 0
    name: str = ""
    owner: str = ""
    map: str = ""
    frame: str = ""
    on_comms_loss: str = ""
    comms_timeout: float = 0.0
    no_return: bool = False
    start: int = 0
    has_home: bool = False
    home_x: float = 0.0
    home_y: float = 0.0
    home_yaw: float = 0.0
    steps: list[MissionStep] = field(default_factory=list)
    loops: list[MissionLoop] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class MissionRequest(Message):
    """rbtrg_msgs/msg/MissionRequest."""

    __msgtype__ = "rbtrg_msgs/msg/MissionRequest"
    header: Header = field(default_factory=Header)
    id: str = ""
    owner: str = ""
    action: str = ""
    order_id: str = ""
    step: int = 0
    answer: str = ""
    order: MissionOrder = field(default_factory=MissionOrder)


@dataclass(slots=True, eq=False)
class MissionState(Message):
    """rbtrg_msgs/msg/MissionState."""

    __msgtype__ = "rbtrg_msgs/msg/MissionState"
    header: Header = field(default_factory=Header)
    request: str = ""
    refused: str = ""
    map: str = ""
    has_home: bool = False
    home_told: bool = False
    home_x: float = 0.0
    home_y: float = 0.0
    home_yaw: float = 0.0
    order_id: str = ""
    order_update_id: int = 0
    name: str = ""
    owner: str = ""
    phase: str = ""
    reason: str = ""
    returning: bool = False
    failure: str = ""
    warning: str = ""
    memory: str = ""
    step: int = 0
    tries: int = 0
    loop_rounds: NDArray[np.uint32] = field(default_factory=lambda: _zeros("uint32", 0))
    goal_id: str = ""
    goals: int = 0
    question: str = ""
    choices: list[str] = field(default_factory=list)
    action_id: list[str] = field(default_factory=list)
    action_type: list[str] = field(default_factory=list)
    action_status: list[str] = field(default_factory=list)
    result_description: list[str] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class MotionLimits(Message):
    """rbtrg_msgs/msg/MotionLimits."""

    __msgtype__ = "rbtrg_msgs/msg/MotionLimits"
    header: Header = field(default_factory=Header)
    forward: float = 0.0
    backward: float = 0.0
    left: float = 0.0
    right: float = 0.0
    reason: str = ""
    uneven_ahead: float = 0.0
    uneven_behind: float = 0.0
    near_body: bool = False


@dataclass(slots=True, eq=False)
class OdometryHealth(Message):
    """rbtrg_msgs/msg/OdometryHealth."""

    __msgtype__ = "rbtrg_msgs/msg/OdometryHealth"
    header: Header = field(default_factory=Header)
    health: str = ""
    reason: str = ""
    overlap: float = 0.0
    inliers: float = 0.0
    residual: float = 0.0
    correction: float = 0.0
    place_sigma: float = 0.0
    degenerate: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 3))
    degeneracy: float = 0.0
    lidar: list[str] = field(default_factory=list)
    time_offset: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    time_offset_sigma: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    time_applied: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    calibration: str = ""
    counter: list[str] = field(default_factory=list)
    count: NDArray[np.uint32] = field(default_factory=lambda: _zeros("uint32", 0))


@dataclass(slots=True, eq=False)
class PathCommand(Message):
    """rbtrg_msgs/msg/PathCommand."""

    __msgtype__ = "rbtrg_msgs/msg/PathCommand"
    header: Header = field(default_factory=Header)
    id: str = ""
    x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    z: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    yaw: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    speed: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    least_speed: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    creep: float = 0.0
    has_goal_yaw: bool = False
    goal_yaw: float = 0.0
    look: float = 0.0


@dataclass(slots=True, eq=False)
class Plan(Message):
    """rbtrg_msgs/msg/Plan."""

    __msgtype__ = "rbtrg_msgs/msg/Plan"
    header: Header = field(default_factory=Header)
    goal_id: str = ""
    sequence: int = 0
    ok: bool = False
    reason: str = ""
    detail: str = ""
    reaches_goal: bool = False
    cost: float = 0.0
    length: float = 0.0
    x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    z: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    yaw: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    speed: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    least_speed: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    creep: bool = False
    has_goal_yaw: bool = False
    goal_yaw: float = 0.0
    node_x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    node_y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_length: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_risk: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_body: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_unknown: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    p_fail: float = 0.0
    worst: str = ""


@dataclass(slots=True, eq=False)
class PlanRequest(Message):
    """rbtrg_msgs/msg/PlanRequest."""

    __msgtype__ = "rbtrg_msgs/msg/PlanRequest"
    header: Header = field(default_factory=Header)
    goal_id: str = ""
    sequence: int = 0
    start_x: float = 0.0
    start_y: float = 0.0
    start_yaw: float = 0.0
    goal_x: float = 0.0
    goal_y: float = 0.0
    goal_yaw: float = 0.0
    has_goal_yaw: bool = False
    held_left: bool = False
    held_right: bool = False
    avoid: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    creep: bool = False
    accept_risk: bool = False


@dataclass(slots=True, eq=False)
class Presence(Message):
    """rbtrg_msgs/msg/Presence."""

    __msgtype__ = "rbtrg_msgs/msg/Presence"
    header: Header = field(default_factory=Header)
    owner: str = ""


@dataclass(slots=True, eq=False)
class RobotCommand(Message):
    """rbtrg_msgs/msg/RobotCommand."""

    __msgtype__ = "rbtrg_msgs/msg/RobotCommand"
    header: Header = field(default_factory=Header)
    mode: str = ""
    cause: str = ""
    latch: int = 0


@dataclass(slots=True, eq=False)
class RobotState(Message):
    """rbtrg_msgs/msg/RobotState."""

    __msgtype__ = "rbtrg_msgs/msg/RobotState"
    header: Header = field(default_factory=Header)
    phase: str = ""
    cause: str = ""
    estop: bool = False
    estop_cause: str = ""
    latch: int = 0
    taken: str = ""
    battery: float = 0.0
    motor_temperature: float = 0.0
    contact: NDArray[np.bool_] = field(default_factory=lambda: _zeros("bool", 4))
    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0
    trunk_roll: float = 0.0
    trunk_pitch: float = 0.0
    refused_reason: list[str] = field(default_factory=list)
    refused_count: NDArray[np.uint32] = field(default_factory=lambda: _zeros("uint32", 0))
    hold: str = ""
    hands: float = 0.0
    realtime_factor: float = 0.0


@dataclass(slots=True, eq=False)
class RouteQuestion(Message):
    """rbtrg_msgs/msg/RouteQuestion."""

    __msgtype__ = "rbtrg_msgs/msg/RouteQuestion"
    header: Header = field(default_factory=Header)
    id: str = ""
    start_x: float = 0.0
    start_y: float = 0.0
    start_yaw: float = 0.0
    goal_x: float = 0.0
    goal_y: float = 0.0
    goal_yaw: float = 0.0
    has_goal_yaw: bool = False
    graph: bool = False


@dataclass(slots=True, eq=False)
class RouteReport(Message):
    """rbtrg_msgs/msg/RouteReport."""

    __msgtype__ = "rbtrg_msgs/msg/RouteReport"
    header: Header = field(default_factory=Header)
    id: str = ""
    question: bool = False
    ok: bool = False
    reason: str = ""
    detail: str = ""
    reaches_goal: bool = False
    cost: float = 0.0
    length: float = 0.0
    duration: float = 0.0
    x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    z: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    yaw: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    node_x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    node_y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    node_z: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_length: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_cost: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_turn: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_risk: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_body: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_unknown: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    transition_p_fail: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    p_fail: float = 0.0
    worst: str = ""
    d_fb: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    a_lr: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    p_int: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    worst_x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    worst_y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    worst_yaw: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    native_x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    native_y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    native_length: float = 0.0
    native_body: float = 0.0
    graph_x: NDArray[np.float32] = field(default_factory=lambda: _zeros("float32", 0))
    graph_y: NDArray[np.float32] = field(default_factory=lambda: _zeros("float32", 0))
    graph_z: NDArray[np.float32] = field(default_factory=lambda: _zeros("float32", 0))
    graph_from: NDArray[np.uint32] = field(default_factory=lambda: _zeros("uint32", 0))
    graph_to: NDArray[np.uint32] = field(default_factory=lambda: _zeros("uint32", 0))
    graph_risk: NDArray[np.float32] = field(default_factory=lambda: _zeros("float32", 0))


@dataclass(slots=True, eq=False)
class RouteStatus(Message):
    """rbtrg_msgs/msg/RouteStatus."""

    __msgtype__ = "rbtrg_msgs/msg/RouteStatus"
    header: Header = field(default_factory=Header)
    goal_id: str = ""
    sequence: int = 0
    valid: bool = False
    detail: str = ""
    nodes: int = 0
    edges: int = 0
    map_version: int = 0
    crept: bool = False


@dataclass(slots=True, eq=False)
class TrackerState(Message):
    """rbtrg_msgs/msg/TrackerState."""

    __msgtype__ = "rbtrg_msgs/msg/TrackerState"
    header: Header = field(default_factory=Header)
    path_id: str = ""
    phase: str = ""
    hold: str = ""
    slow: str = ""
    distance_left: float = 0.0
    cross_track: float = 0.0
    heading_error: float = 0.0


@dataclass(slots=True, eq=False)
class TrunkCommand(Message):
    """rbtrg_msgs/msg/TrunkCommand."""

    __msgtype__ = "rbtrg_msgs/msg/TrunkCommand"
    header: Header = field(default_factory=Header)
    roll: float = 0.0
    pitch: float = 0.0


@dataclass(slots=True, eq=False)
class Viewpoints(Message):
    """rbtrg_msgs/msg/Viewpoints."""

    __msgtype__ = "rbtrg_msgs/msg/Viewpoints"
    header: Header = field(default_factory=Header)
    sequence: int = 0
    refused: str = ""
    x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    gain: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    way: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    seen: float = 0.0
    hidden: float = 0.0
    home: float = 0.0
    unreachable_x: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    unreachable_y: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))


@dataclass(slots=True, eq=False)
class Clock(Message):
    """rosgraph_msgs/msg/Clock."""

    __msgtype__ = "rosgraph_msgs/msg/Clock"
    clock: Time = field(default_factory=Time)


@dataclass(slots=True, eq=False)
class RegionOfInterest(Message):
    """sensor_msgs/msg/RegionOfInterest."""

    __msgtype__ = "sensor_msgs/msg/RegionOfInterest"
    x_offset: int = 0
    y_offset: int = 0
    height: int = 0
    width: int = 0
    do_rectify: bool = False


@dataclass(slots=True, eq=False)
class CameraInfo(Message):
    """sensor_msgs/msg/CameraInfo."""

    __msgtype__ = "sensor_msgs/msg/CameraInfo"
    header: Header = field(default_factory=Header)
    height: int = 0
    width: int = 0
    distortion_model: str = ""
    d: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    k: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 9))
    r: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 9))
    p: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 12))
    binning_x: int = 0
    binning_y: int = 0
    roi: RegionOfInterest = field(default_factory=RegionOfInterest)


@dataclass(slots=True, eq=False)
class CompressedImage(Message):
    """sensor_msgs/msg/CompressedImage."""

    __msgtype__ = "sensor_msgs/msg/CompressedImage"
    header: Header = field(default_factory=Header)
    format: str = ""
    data: NDArray[np.uint8] = field(default_factory=lambda: _zeros("uint8", 0))


@dataclass(slots=True, eq=False)
class Imu(Message):
    """sensor_msgs/msg/Imu."""

    __msgtype__ = "sensor_msgs/msg/Imu"
    header: Header = field(default_factory=Header)
    orientation: Quaternion = field(default_factory=Quaternion)
    orientation_covariance: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 9))
    angular_velocity: Vector3 = field(default_factory=Vector3)
    angular_velocity_covariance: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 9))
    linear_acceleration: Vector3 = field(default_factory=Vector3)
    linear_acceleration_covariance: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 9))


@dataclass(slots=True, eq=False)
class JointState(Message):
    """sensor_msgs/msg/JointState."""

    __msgtype__ = "sensor_msgs/msg/JointState"
    header: Header = field(default_factory=Header)
    name: list[str] = field(default_factory=list)
    position: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    velocity: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))
    effort: NDArray[np.float64] = field(default_factory=lambda: _zeros("float64", 0))


@dataclass(slots=True, eq=False)
class String(Message):
    """std_msgs/msg/String."""

    __msgtype__ = "std_msgs/msg/String"
    data: str = ""


@dataclass(slots=True, eq=False)
class Transform(Message):
    """geometry_msgs/msg/Transform."""

    __msgtype__ = "geometry_msgs/msg/Transform"
    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass(slots=True, eq=False)
class TransformStamped(Message):
    """geometry_msgs/msg/TransformStamped."""

    __msgtype__ = "geometry_msgs/msg/TransformStamped"
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass(slots=True, eq=False)
class TFMessage(Message):
    """tf2_msgs/msg/TFMessage."""

    __msgtype__ = "tf2_msgs/msg/TFMessage"
    transforms: list[TransformStamped] = field(default_factory=list)
