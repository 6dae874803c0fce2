"""IDL types of the robot's topics, for DDS matching only; the bytes are coded in `layout`, `api` and `cloud`.

Every octet is declared `byte`. cyclonedds 11 announces `uint8` as a type kind that Cyclone 0.10 (the robot's version)
does not know: a 0.10 process that discovers such a type dies in `ddsi_xt_type_init_impl`. Type names, member names
and their order follow unitree_go, unitree_api and the ROS 2 message packages.
"""

# mypy: disable-error-code="type-arg,valid-type"
# No `from __future__ import annotations` here: cyclonedds reads the annotations as objects.
from dataclasses import dataclass
from typing import Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import (
    array,
    float32,
    float64,
    int16,
    int32,
    int64,
    sequence,
    uint16,
    uint32,
    uint64,
)

try:
    from cyclonedds.idl.types import byte
except ImportError:  # cyclonedds 0.10 (aarch64) has no other octet, and announces it as the robot does
    from cyclonedds.idl.types import uint8 as byte


def _of(cls: Any, cdr: bytes) -> Any:
    """A sample with these CDR bytes, encapsulation header included."""
    sample = cls.__new__(cls)
    sample.cdr = cdr
    return sample


def _serialize(self: Any, buffer: Any = None, endianness: Any = None, use_version_2: Any = None) -> bytes:
    return self.cdr


def _deserialize(cls: Any, data: bytes, has_header: bool = True, use_version_2: Any = None) -> Any:
    return _of(cls, data)


def packed(cls: Any) -> Any:
    """Make the samples of a top-level type carry their bytes in `cdr`: the DDS layer neither packs nor unpacks.

    A decorator, because cyclonedds takes every base class other than IdlStruct for a part of the IDL type.
    """
    cls.of = classmethod(_of)
    cls.serialize = _serialize
    cls.deserialize = classmethod(_deserialize)
    return cls


# --- unitree_go ---------------------------------------------------------------------------------------------------


@dataclass
@final
class ImuState(IdlStruct, typename="unitree_go.msg.dds_.IMUState_"):
    quaternion: array[float32, 4]
    gyroscope: array[float32, 3]
    accelerometer: array[float32, 3]
    rpy: array[float32, 3]
    temperature: byte


@dataclass
@final
class MotorState(IdlStruct, typename="unitree_go.msg.dds_.MotorState_"):
    mode: byte
    q: float32
    dq: float32
    ddq: float32
    tau_est: float32
    q_raw: float32
    dq_raw: float32
    ddq_raw: float32
    temperature: byte
    lost: uint32
    reserve: array[uint32, 2]


@dataclass
@final
class BmsState(IdlStruct, typename="unitree_go.msg.dds_.BmsState_"):
    version_high: byte
    version_low: byte
    status: byte
    soc: byte
    current: int32
    cycle: uint16
    bq_ntc: array[byte, 2]
    mcu_ntc: array[byte, 2]
    cell_vol: array[uint16, 15]


@packed
@dataclass
@final
class LowState(IdlStruct, typename="unitree_go.msg.dds_.LowState_"):
    head: array[byte, 2]
    level_flag: byte
    frame_reserve: byte
    sn: array[uint32, 2]
    version: array[uint32, 2]
    bandwidth: uint16
    imu_state: ImuState
    motor_state: array[MotorState, 20]
    bms_state: BmsState
    foot_force: array[int16, 4]
    foot_force_est: array[int16, 4]
    tick: uint32
    wireless_remote: array[byte, 40]
    bit_flag: byte
    adc_reel: float32
    temperature_ntc1: byte
    temperature_ntc2: byte
    power_v: float32
    power_a: float32
    fan_frequency: array[uint16, 4]
    reserve: uint32
    crc: uint32


@dataclass
@final
class MotorCmd(IdlStruct, typename="unitree_go.msg.dds_.MotorCmd_"):
    mode: byte
    q: float32
    dq: float32
    tau: float32
    kp: float32
    kd: float32
    reserve: array[uint32, 3]


@dataclass
@final
class BmsCmd(IdlStruct, typename="unitree_go.msg.dds_.BmsCmd_"):
    off: byte
    reserve: array[byte, 3]


@packed
@dataclass
@final
class LowCmd(IdlStruct, typename="unitree_go.msg.dds_.LowCmd_"):
    head: array[byte, 2]
    level_flag: byte
    frame_reserve: byte
    sn: array[uint32, 2]
    version: array[uint32, 2]
    bandwidth: uint16
    motor_cmd: array[MotorCmd, 20]
    bms_cmd: BmsCmd
    wireless_remote: array[byte, 40]
    led: array[byte, 12]
    fan: array[byte, 2]
    gpio: byte
    reserve: uint32
    crc: uint32


@dataclass
@final
class TimeSpec(IdlStruct, typename="unitree_go.msg.dds_.TimeSpec_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class PathPoint(IdlStruct, typename="unitree_go.msg.dds_.PathPoint_"):
    t_from_start: float32
    x: float32
    y: float32
    yaw: float32
    vx: float32
    vy: float32
    vyaw: float32


@packed
@dataclass
@final
class SportModeState(IdlStruct, typename="unitree_go.msg.dds_.SportModeState_"):
    stamp: TimeSpec
    error_code: uint32
    imu_state: ImuState
    mode: byte
    progress: float32
    gait_type: byte
    foot_raise_height: float32
    position: array[float32, 3]
    body_height: float32
    velocity: array[float32, 3]
    yaw_speed: float32
    range_obstacle: array[float32, 4]
    foot_force: array[int16, 4]
    foot_position_body: array[float32, 12]
    foot_speed_body: array[float32, 12]
    path_point: array[PathPoint, 10]


# --- unitree_api --------------------------------------------------------------------------------------------------


@dataclass
@final
class RequestIdentity(IdlStruct, typename="unitree_api.msg.dds_.RequestIdentity_"):
    id: int64
    api_id: int64


@dataclass
@final
class RequestLease(IdlStruct, typename="unitree_api.msg.dds_.RequestLease_"):
    id: int64


@dataclass
@final
class RequestPolicy(IdlStruct, typename="unitree_api.msg.dds_.RequestPolicy_"):
    priority: int32
    noreply: bool


@dataclass
@final
class RequestHeader(IdlStruct, typename="unitree_api.msg.dds_.RequestHeader_"):
    identity: RequestIdentity
    lease: RequestLease
    policy: RequestPolicy


@packed
@dataclass
@final
class RequestMessage(IdlStruct, typename="unitree_api.msg.dds_.Request_"):
    header: RequestHeader
    parameter: str
    binary: sequence[byte]


@dataclass
@final
class ResponseStatus(IdlStruct, typename="unitree_api.msg.dds_.ResponseStatus_"):
    code: int32


@dataclass
@final
class ResponseHeader(IdlStruct, typename="unitree_api.msg.dds_.ResponseHeader_"):
    identity: RequestIdentity
    status: ResponseStatus


@packed
@dataclass
@final
class ResponseMessage(IdlStruct, typename="unitree_api.msg.dds_.Response_"):
    header: ResponseHeader
    data: str
    binary: sequence[byte]


# --- ROS 2 messages on the robot ----------------------------------------------------------------------------------


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
@final
class PointField(IdlStruct, typename="sensor_msgs.msg.dds_.PointField_"):
    name: str
    offset: uint32
    datatype: byte
    count: uint32


@packed
@dataclass
@final
class PointCloud2(IdlStruct, typename="sensor_msgs.msg.dds_.PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[byte]
    is_dense: bool


@dataclass
@final
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@packed
@dataclass
@final
class Imu(IdlStruct, typename="sensor_msgs.msg.dds_.Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


# --- livox_ros_driver2 --------------------------------------------------------------------------------------------


@dataclass
@final
class CustomPoint(IdlStruct, typename="livox_ros_driver2.msg.dds_.CustomPoint_"):
    offset_time: uint32
    x: float32
    y: float32
    z: float32
    reflectivity: byte
    tag: byte
    line: byte


@packed
@dataclass
@final
class CustomMsg(IdlStruct, typename="livox_ros_driver2.msg.dds_.CustomMsg_"):
    header: Header
    timebase: uint64
    point_num: uint32
    lidar_id: byte
    rsvd: array[byte, 3]
    points: sequence[CustomPoint]


TOPIC_TYPES = (
    LowState,
    LowCmd,
    SportModeState,
    RequestMessage,
    ResponseMessage,
    PointCloud2,
    Imu,
    CustomMsg,
)
"""Every type that is announced on the network."""
