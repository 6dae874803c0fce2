"""Forces of the ground on the wheels from leg torques: the one estimate behind contact flags, wheel odometry and
controller."""

from __future__ import annotations

import numpy as np
from numba import njit

from hal.limbs import Limbs, wheel_jacobians
from hal.types import Array

CONTACT_FORCE = 12.0
"""A wheel that carries more than this [N] is on the ground."""


@njit(cache=True)
def inverse3(a: Array) -> Array:
    """Inverse of a (3, 3) matrix; near singularity (straight knee) the determinant is floored, so the result stays
    finite."""
    out = np.empty((3, 3))
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if abs(det) < 1e-4:
        det = 1e-4 if det >= 0.0 else -1e-4
    inv = 1.0 / det
    out[0, 0] = c00 * inv
    out[1, 0] = c01 * inv
    out[2, 0] = c02 * inv
    out[0, 1] = (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) * inv
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) * inv
    out[2, 1] = (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) * inv
    out[0, 2] = (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]) * inv
    out[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) * inv
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) * inv
    return out


@njit(cache=True)
def axle_force(jacobian: Array, t0: float, t1: float, t2: float) -> tuple[float, float, float]:
    """Force f [N] on the axle that balances the joint torques t [Nm]: J^T f = t, in the axes of `jacobian` (3, 3) of
    the wheel centre.

    Quasi-static: the leg's inertia is left out. The ground's force on a wheel is the one that balances minus the
    motor torques."""
    inv = inverse3(jacobian)
    fx = inv[0, 0] * t0 + inv[1, 0] * t1 + inv[2, 0] * t2
    fy = inv[0, 1] * t0 + inv[1, 1] * t1 + inv[2, 1] * t2
    fz = inv[0, 2] * t0 + inv[1, 2] * t1 + inv[2, 2] * t2
    return fx, fy, fz


@njit(cache=True)
def is_rigid(limbs: Limbs) -> bool:
    """Whether the wheels sit on the body itself: then no joint tells what they carry."""
    return limbs.thigh + limbs.calf == 0.0


@njit(cache=True)
def wheel_loads(limbs: Limbs, q: Array, tau: Array, up: Array) -> Array:
    """(4,) force of the ground on each wheel [N] along the unit vector `up` (3,), base_link axes; legs FR, FL, RR, RL.

    `q` [rad] and `tau` [Nm]: (16,) as `hal.limbs.MOTORS`. The weight of the legs is left out: about 10 N a leg of 2.5
    kg. Infinite where no joint tells."""
    load = np.full(4, np.inf)
    if is_rigid(limbs):
        return load
    jacobian = wheel_jacobians(limbs, q)
    for leg in range(4):
        fx, fy, fz = axle_force(jacobian[leg], -tau[3 * leg], -tau[3 * leg + 1], -tau[3 * leg + 2])
        load[leg] = fx * up[0] + fy * up[1] + fz * up[2]
    return load


@njit(cache=True)
def wheel_pushes(limbs: Limbs, q: Array, tau: Array) -> Array:
    """(4,) force of the ground on each wheel [N] along the trunk's x axis, as `wheel_loads`, with the reaction of the
    wheels' own motors; of wheels on the body itself what their motors push."""
    jacobian = wheel_jacobians(limbs, q)
    push = np.empty(4)
    for leg in range(4):
        wheel = tau[12 + leg]
        if is_rigid(limbs):
            push[leg] = wheel / limbs.radius
            continue
        push[leg] = axle_force(
            jacobian[leg], -tau[3 * leg], wheel - tau[3 * leg + 1], wheel - tau[3 * leg + 2]
        )[0]
    return push
