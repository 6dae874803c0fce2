"""Contact points of the wheels, from joint angles and torques."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.limbs import Limbs, wheel_centres
from hal.rotation import cross
from hal.types import Array, JointSample
from mapping.odometry.wheels import leg_velocity


def contacts_of(limbs: Limbs, rows: Array) -> Array:
    """`wheel_contacts` of the last of `rows` (n, 48): position, velocity, effort of 16 motors; (0, 3) without one."""
    if not len(rows):
        return np.zeros((0, 3))
    return wheel_contacts(limbs, JointSample(0, rows[-1, :16], rows[-1, 16:32], rows[-1, 32:]))


def wheel_contacts(limbs: Limbs, joints: JointSample) -> NDArray[np.float64]:
    """(k, 3) lowest points of the wheels that carry load, base_link [m].

    The wheel's lowest point lies along the normal of the plane through the four wheel centres: on a ramp that is the
    ramp's normal, whatever the trunk does.
    """
    # Copies: for arrays that cannot be written to every kernel would be compiled once more.
    q, dq, tau = (np.array(each, np.float64) for each in (joints.position, joints.velocity, joints.effort))
    contact = np.empty(4, np.bool_)
    leg_velocity(limbs, q, dq, tau, np.zeros(3), np.ones(3), np.empty(3), np.empty(3), contact)
    centre = wheel_centres(limbs, q)
    normal = cross(centre[0] - centre[3], centre[1] - centre[2])
    length = np.linalg.norm(normal)
    if length < 1e-6:
        return np.zeros((0, 3))
    normal *= np.sign(normal[2]) / length
    return (centre - limbs.radius * normal)[contact]
