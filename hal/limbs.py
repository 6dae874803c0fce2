"""Four limbs: the one layout of joints that every robot of ours is described in, and its kinematics.

A limb has a hip that turns about x, a thigh and a calf that turn about y, and a wheel, or a foot that does not turn,
at its end. A joint that a robot lacks stays at zero: a robot on four fixed wheels has links of no length. Frames:
base_link, x forward, y left, z up; at zero angles the limbs hang straight down and a knee that points backward has a
negative angle.

Joint arrays are (16,) in the order of `MOTORS`. The kinematics are numba functions of numbers, so kernels of every
robot call them."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from hal.types import Array

LEGS: Final = ("FR", "FL", "RR", "RL")
MOTORS: Final = tuple(f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf")) + tuple(
    f"{leg}_wheel" for leg in LEGS
)
"""The sixteen joints by name, in the order of Unitree's SDK (LowCmd and LowState slots 0..15 of a Go2-W)."""
WHEEL_JOINTS: Final = slice(12, 16)
"""Where the wheels sit in a (16,) joint array."""

SIGN_X: Final = np.array([1.0, 1.0, -1.0, -1.0])
"""+1 front, -1 rear, per limb."""
SIGN_Y: Final = np.array([-1.0, 1.0, -1.0, 1.0])
"""+1 left, -1 right, per limb."""


class Limbs(NamedTuple):
    """Lengths of the four limbs [m], mirrored from the front left one."""

    hip_x: float
    """Hip in base_link, forward..."""
    hip_y: float
    """... and sideways; its height is zero."""
    thigh_y: float
    """Hip joint to thigh joint, sideways."""
    thigh: float
    """Thigh joint to knee, down."""
    calf: float
    """Knee to wheel axle or to the middle of the foot, down."""
    tread_y: float
    """Wheel joint frame to the centre plane of the tread, sideways."""
    tread_width: float
    radius: float
    """Of the wheel, or of the foot's sphere."""
    hip_z: float = 0.0
    """Hip in base_link, upward."""

    @property
    def tread(self) -> float:
        """Middle of the body to the centre plane of a tread, with hips at zero [m]."""
        return self.hip_y + self.thigh_y + self.tread_y


@njit(cache=True)
def wheel_centres(limbs: Limbs, q: Array) -> Array:
    """Centres of the four treads.

    `q`: (16,) or (12,) joint angles [rad]. Returns (4, 3) [m] in base_link, limbs FR, FL, RR, RL. A wheel touches level
    ground its radius below its centre.
    """
    out = np.empty((4, 3))
    for leg in range(4):
        hip = q[3 * leg]
        thigh = q[3 * leg + 1]
        shank = thigh + q[3 * leg + 2]
        x = -limbs.thigh * math.sin(thigh) - limbs.calf * math.sin(shank)
        y = (limbs.thigh_y + limbs.tread_y) * SIGN_Y[leg]
        z = -limbs.thigh * math.cos(thigh) - limbs.calf * math.cos(shank)
        s = math.sin(hip)
        c = math.cos(hip)
        out[leg, 0] = limbs.hip_x * SIGN_X[leg] + x
        out[leg, 1] = limbs.hip_y * SIGN_Y[leg] + y * c - z * s
        out[leg, 2] = limbs.hip_z + y * s + z * c
    return out


@njit(cache=True)
def wheel_jacobians(limbs: Limbs, q: Array) -> Array:
    """Jacobians of `wheel_centres`.

    Returns (4, 3, 3) [m/rad]: `J[leg, axis, joint]`, joints hip, thigh, calf. The wheel's own angle does not move its
    centre."""
    out = np.empty((4, 3, 3))
    for leg in range(4):
        hip = q[3 * leg]
        thigh = q[3 * leg + 1]
        shank = thigh + q[3 * leg + 2]
        y = (limbs.thigh_y + limbs.tread_y) * SIGN_Y[leg]
        calf_x = -limbs.calf * math.sin(shank)
        calf_z = -limbs.calf * math.cos(shank)
        x = -limbs.thigh * math.sin(thigh) + calf_x
        z = -limbs.thigh * math.cos(thigh) + calf_z
        s = math.sin(hip)
        c = math.cos(hip)
        out[leg, 0, 0] = 0.0
        out[leg, 1, 0] = -y * s - z * c
        out[leg, 2, 0] = y * c - z * s
        out[leg, 0, 1] = z
        out[leg, 1, 1] = x * s
        out[leg, 2, 1] = -x * c
        out[leg, 0, 2] = calf_z
        out[leg, 1, 2] = calf_x * s
        out[leg, 2, 2] = -calf_x * c
    return out


def stand_height(limbs: Limbs, q: Array) -> float:
    """Height [m] of base_link above level ground with the joints at `q` (16,) and the trunk level: mean of the four
    limbs."""
    return float(limbs.radius - wheel_centres(limbs, q)[:, 2].mean())
