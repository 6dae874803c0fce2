"""Facts of the Unitree Go2-W for its own controllers and model: those of `robot.yaml`, inertia, limits and poses.

Source: the URDF of `go2w_description` (unitreerobotics/unitree_ros) for masses, geometry and limits;
`unitree_sdk2_python/example/go2w` for motor order. Limbs and joints are in the order of `hal.limbs`.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from hal import limbs
from hal.limbs import LEGS, MOTORS, SIGN_X, SIGN_Y, WHEEL_JOINTS
from hal.robots import describe
from hal.types import Array

_ROBOT: Final = describe("go2w")
LIMBS: Final = _ROBOT.limbs

# --- geometry [m], of robot.yaml; kernels freeze these numbers --------------------------------------------------------
HIP_X: Final = LIMBS.hip_x
HIP_Y: Final = LIMBS.hip_y
THIGH_Y: Final = LIMBS.thigh_y
THIGH: Final = LIMBS.thigh
CALF: Final = LIMBS.calf
TREAD_Y: Final = LIMBS.tread_y
TREAD_WIDTH: Final = LIMBS.tread_width
WHEEL_RADIUS: Final = LIMBS.radius
BODY_LENGTH: Final = _ROBOT.body.length
BODY_WIDTH: Final = _ROBOT.body.width
IMU_POSITION: Final = _ROBOT.imu.translation
"""IMU in base_link; its axes are base_link's."""
L1_MOUNT: Final = _ROBOT.mounts["l1"]
XT16_MOUNT: Final = _ROBOT.mounts["xt16"]


# --- inertia ------------------------------------------------------------------------------------------------------
class Link(NamedTuple):
    """Rigid-body inertia in the link's own frame, for the front left leg (sx = sy = +1)."""

    mass: float
    """[kg]"""
    com: tuple[float, float, float]
    """[m]"""
    inertia: tuple[float, float, float, float, float, float]
    """Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass [kg m^2]."""


BASE_LINK: Final = Link(
    6.921, (0.021112, 0.0, -0.005366), (0.02448, 0.098077, 0.107, 1.2166e-4, 1.4849e-3, -3.12e-5)
)
HIP_LINK: Final = Link(
    0.678, (-0.0054, 0.00194, -0.000105), (0.00048, 0.000884, 0.000596, -3.01e-6, 1.11e-6, -1.42e-6)
)
THIGH_LINK: Final = Link(
    1.152, (-0.00374, -0.0223, -0.0327), (0.00584, 0.0058, 0.00103, 8.72e-5, -2.89e-4, 8.08e-4)
)
CALF_LINK: Final = Link(
    0.154, (0.00548, -0.000975, -0.115), (0.00108, 0.0011, 3.29e-5, 3.4e-7, 1.72e-5, 8.28e-6)
)
WHEEL_MOTOR: Final = Link(0.646, (0.0, 0.01, -0.2264), (0.001, 0.0016, 0.001, 0.0, 0.0, 0.0))
"""Fixed to the calf; `com` is in the calf frame."""
WHEEL_LINK: Final = Link(0.520, (0.0, 0.06, 0.0), (0.0007, 0.0012, 0.0007, 0.0, 0.0, 0.0))
ROBOT_MASS: Final = BASE_LINK.mass + 4 * (
    HIP_LINK.mass + THIGH_LINK.mass + CALF_LINK.mass + WHEEL_MOTOR.mass + WHEEL_LINK.mass
)
"""Whole robot [kg]: 19.52."""
MOTOR_ARMATURE: Final = 0.01
"""Reflected rotor inertia of every motor [kg m^2]."""
JOINT_DAMPING: Final = 0.1
"""Viscous joint friction [Nm s/rad]."""
JOINT_FRICTION: Final = 0.2
"""Dry joint friction [Nm]."""

# --- limits, (16,) in SDK order -----------------------------------------------------------------------------------
_FRONT_RANGE = ((-1.0472, 1.0472), (-1.5708, 3.4907), (-2.7227, -0.83776))
_REAR_RANGE = ((-1.0472, 1.0472), (-0.5236, 4.5379), (-2.7227, -0.83776))
JOINT_RANGE: Final[Array] = np.array(
    [*_FRONT_RANGE, *_FRONT_RANGE, *_REAR_RANGE, *_REAR_RANGE] + [(-np.inf, np.inf)] * 4
)
"""(16, 2) lowest and highest joint angle [rad]; wheels turn freely."""
TORQUE_LIMIT: Final[Array] = np.array([23.7, 23.7, 35.55] * 4 + [23.7] * 4)
"""(16,) [Nm]."""
SPEED_LIMIT: Final[Array] = np.array([30.1, 30.1, 20.07] * 4 + [30.1] * 4)
"""(16,) [rad/s]."""


# --- poses, (16,) in SDK order ------------------------------------------------------------------------------------
def pose(hip: float, thigh: float, calf: float) -> Array:
    """(16,) the same leg angles [rad] in all four legs, wheels at zero."""
    return np.array([hip, thigh, calf] * 4 + [0.0] * 4)


STAND: Final[Array] = _ROBOT.pose
"""Default stand: base_link 0.408 m above level ground."""
FOLDED_POSE: Final[Array] = pose(0.0, 1.36, -2.65)
"""Lying: 0.193 m."""


# --- kinematics ---------------------------------------------------------------------------------------------------
@njit(cache=True)
def wheel_centres(q: Array) -> Array:
    """`hal.limbs.wheel_centres` of this robot."""
    return limbs.wheel_centres(LIMBS, q)


@njit(cache=True)
def wheel_jacobians(q: Array) -> Array:
    """`hal.limbs.wheel_jacobians` of this robot."""
    return limbs.wheel_jacobians(LIMBS, q)


def leg_angles(centres: Array) -> Array:
    """Inverse of `wheel_centres`: joint angles that put the tread centres there, knees backward.

    `centres`: (4, 3) [m] in base_link. Returns (16,) [rad], wheels 0. Out of reach or past a joint limit: the nearest
    angles inside the limits."""
    out = np.zeros(16)
    side = THIGH_Y + TREAD_Y
    for leg in range(4):
        x = centres[leg, 0] - HIP_X * SIGN_X[leg]
        y = centres[leg, 1] - HIP_Y * SIGN_Y[leg]
        z = centres[leg, 2]
        down = math.sqrt(max(y * y + z * z - side * side, 1e-6))
        hip = math.atan2(z, y) - math.atan2(-down, side * SIGN_Y[leg])
        hip = math.remainder(hip, 2.0 * math.pi)
        cosine = (x * x + down * down - THIGH**2 - CALF**2) / (2.0 * THIGH * CALF)
        calf = -math.acos(min(max(cosine, -1.0), 1.0))
        calf = min(max(calf, JOINT_RANGE[3 * leg + 2, 0]), JOINT_RANGE[3 * leg + 2, 1])
        thigh = math.atan2(-x, down) - math.atan2(CALF * math.sin(calf), THIGH + CALF * math.cos(calf))
        out[3 * leg : 3 * leg + 3] = hip, thigh, calf
    return np.clip(out, JOINT_RANGE[:, 0], JOINT_RANGE[:, 1])


def stand_height(q: Array) -> float:
    """`hal.limbs.stand_height` of this robot."""
    return limbs.stand_height(LIMBS, q)


__all__ = ["LEGS", "MOTORS", "SIGN_X", "SIGN_Y", "WHEEL_JOINTS"]
