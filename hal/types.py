"""Value types that cross the hardware boundary.

Units are SI, angles radians, stamps integer nanoseconds of the *source clock* (the simulator's clock in
simulation, the host's on hardware; the backend converts). Frames follow REP 105: `base_link` is the
trunk centre, x forward, y left, z up. Arrays are float64 unless said otherwise and must not be modified.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NS = 1_000_000_000
"""Nanoseconds in a second."""

GRAVITY = 9.81
"""[m/s^2]"""

LidarName = Literal["main", "head"]
"""What a LiDAR is for: `main` localises and maps all around, `head` sees the ground in front of the feet."""

POINT_DTYPE = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("ring", "<u2"),
        ("time", "<f4"),
    ]
)
"""One LiDAR return: x, y, z [m] in the LiDAR's own frame, intensity [0..255], ring, time [s] since `LidarScan.stamp`.
"""

NO_POINTS = np.empty((0, 3), np.float32)
"""x, y, z [m], of none."""
POINT_QUANTUM = 2.0**-8
"""x, y, z are multiples of this [m]: an error of 1.1 mm (1 sigma) beside a sensor noise of 10 to 20 mm. Noise does not
compress: finer values would only make logs larger."""
TIME_QUANTUM = 2.0**-14
"""`time` is a multiple of this [s]: at 10 m and 1 rad/s at most 0.3 mm of deskewing."""


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One inertial sample, already rotated into `base_link` axes."""

    stamp: int
    gyro: Array
    """(3,) angular rate [rad/s], base_link."""
    accel: Array
    """(3,) specific force [m/s^2], base_link; +9.81 on z at rest."""


@dataclass(frozen=True, slots=True)
class JointSample:
    """All sixteen motors in SDK order (`hal.limbs.MOTORS`)."""

    stamp: int
    position: Array
    """(16,) [rad]; wheels are continuous."""
    velocity: Array
    """(16,) [rad/s]."""
    effort: Array
    """(16,) [Nm]."""


@dataclass(frozen=True, slots=True)
class LidarScan:
    """One sweep. `points` is a structured array of `POINT_DTYPE` in the LiDAR's own frame, body returns removed."""

    stamp: int
    """Start of the sweep [ns]; `points["time"]` counts from here."""
    points: NDArray[np.void]
    name: LidarName = "main"
    """Which LiDAR of the robot."""


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """True pose from a simulator. For evaluation only: no stage of the stack may consume it."""

    stamp: int
    position: Array
    """(3,) base_link in the world [m]."""
    orientation: Array
    """(4,) quaternion x, y, z, w: world <- base_link."""
    linear: Array
    """(3,) velocity of base_link, expressed in base_link [m/s]."""
    angular: Array
    """(3,) [rad/s], base_link."""


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """Body velocity, frame `base_link`."""

    stamp: int
    vx: float = 0.0
    """Forward [m/s]."""
    vy: float = 0.0
    """Left [m/s]; must be 0 where `Capabilities.strafe` is false."""
    wz: float = 0.0
    """Yaw rate, counter-clockwise positive [rad/s]."""
    frame: str = "base_link"
    climb: bool = True
    """A held wheel may be lifted onto what holds it; False where the map has no face there."""


@dataclass(frozen=True, slots=True)
class PostureCommand:
    """Trunk posture relative to the ground plane under the wheels."""

    stamp: int
    height: float | None = None
    """base_link above the ground plane [m]; None keeps the default."""
    roll: float = 0.0
    """[rad], right side down."""
    pitch: float = 0.0
    """[rad], nose down."""


class Phase(StrEnum):
    """State machine every backend shows. Transitions carry a cause and have a timeout."""

    DISCONNECTED = "disconnected"
    DAMPED = "damped"
    SITTING = "sitting"
    STANDING = "standing"
    """Getting up; not yet ready to take velocity."""
    READY = "ready"
    MOVING = "moving"
    STOPPED = "stopped"
    """Standing still under the e-stop latch."""
    FAULT = "fault"


LYING = (Phase.SITTING, Phase.DAMPED)
"""A robot that is well, but drives nowhere before somebody asks it to stand."""


class ModeRequest(StrEnum):
    """What an operator or a stage may ask of the robot besides velocity."""

    STAND = "stand"
    SIT = "sit"
    DAMP = "damp"
    RECOVER = "recover"
    STOP = "stop"
    """Latched e-stop: zero velocity now, stays until `resume`."""
    RESUME = "resume"


@dataclass(frozen=True, slots=True)
class RobotState:
    """Summary state at `stamp`."""

    stamp: int
    phase: Phase
    cause: str = ""
    """Plain words: why the robot is in this phase (fault reason, stop reason, last transition)."""
    battery: float = 1.0
    """State of charge [0..1]."""
    motor_temperature: float = 30.0
    """Hottest motor [deg C]."""
    contact: tuple[bool, bool, bool, bool] = (True, True, True, True)
    """Wheel on ground: FR, FL, RR, RL."""
    remote: bool = False
    """The operator moves the sticks of the robot's own remote."""


@dataclass(frozen=True, slots=True)
class Extrinsics:
    """Pose of a sensor in base_link."""

    translation: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class MountedLidar:
    """One LiDAR of a robot."""

    name: LidarName
    model: str
    """A name in `hal.lidar.spec.LIDARS`."""
    mount: Extrinsics


FELT_EDGE = "cliff: an edge"
"""With this and "ahead" or "behind" the cause of a robot's state begins while its wheels feel an edge that goes down.
"""


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What this robot with this controller can do: hard limits for gate, planner and tracker."""

    name: str
    length: float = 0.70
    """Of the body [m], base_link in its middle. The defaults are the body of the paper."""
    width: float = 0.43
    """[m]"""
    max_vx: float = 1.0
    """[m/s], both directions."""
    max_vy: float = 0.0
    max_wz: float = 1.0
    """[rad/s]."""
    max_accel: float = 1.0
    """[m/s^2] slew of the commanded linear velocity."""
    max_alpha: float = 3.0
    """[rad/s^2] slew of the commanded yaw rate."""
    min_vx: float = 0.2
    """[m/s] slowest speed of which at least half is driven, forward and backward. The default is a guess on the safe
    side."""
    step_vx: float = 0.0
    """[m/s] slowest speed at which uneven ground with faces up to `max_step` is passed: slower, wheels stall on it; 0:
    any."""
    min_wz: float = 0.3
    """[rad/s] slowest turn on the spot of which at least half is turned, to both sides. The default is such a guess,
    too."""
    max_step: float = 0.10
    """Highest vertical face driven over [m]."""
    max_slope: float = 0.436
    """[rad]."""
    max_gap: float = 0.10
    """Widest gap crossed [m]."""
    max_trunk_tilt: float = 0.0
    """Roll and pitch [rad] to which the trunk tilts by command while the robot stands; 0: it cannot."""
    max_posts: float = 0.05
    """Highest posts of a stepfield driven through [m] (`tools.bench envelope`, rows `posts_*`): faces on all sides of
    all wheels are harder than one face of `max_step`. The default is that of the model-based controller, the smallest
    that was measured."""
    creep: float = 0.0
    """[m/s] speed up to which the wheels feel edges that go down, and the robot backs off by itself (`FELT_EDGE`); 0:
    they feel none."""
    strafe: bool = False
    lidars: tuple[MountedLidar, ...] = ()
    """What is there; at most one of each name."""


Sample = ImuSample | JointSample | LidarScan | RobotState | GroundTruth
