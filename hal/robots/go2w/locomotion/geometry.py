"""Compiled geometry and statics of the four wheeled legs: level frame, contact points, leg weight, force distribution.

Frame H: origin base_link, z against gravity, x the trunk's heading projected on the horizontal plane. Legs FR, FL,
RR, RL."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hal.robots.go2w.facts import (
    BASE_LINK,
    CALF,
    CALF_LINK,
    HIP_LINK,
    HIP_X,
    HIP_Y,
    ROBOT_MASS,
    SIGN_X,
    SIGN_Y,
    THIGH,
    THIGH_LINK,
    THIGH_Y,
    WHEEL_LINK,
    WHEEL_MOTOR,
    WHEEL_RADIUS,
)
from hal.rotation import up_of
from hal.types import GRAVITY, Array

_BASE_M = BASE_LINK.mass
_BASE_X = BASE_LINK.com[0]
_BASE_Z = BASE_LINK.com[2]
_HIP_M = HIP_LINK.mass
_THIGH_M = THIGH_LINK.mass
_THIGH_Y = THIGH_LINK.com[1]
_THIGH_Z = THIGH_LINK.com[2]
_SHANK_M = CALF_LINK.mass + WHEEL_MOTOR.mass
_SHANK_Z = (CALF_LINK.mass * CALF_LINK.com[2] + WHEEL_MOTOR.mass * WHEEL_MOTOR.com[2]) / _SHANK_M
_WHEEL_M = WHEEL_LINK.mass
_WHEEL_Y = WHEEL_LINK.com[1]


@njit(cache=True)
def level_frame(quaternion: Array) -> Array:
    """Rotation H <- base_link, (3, 3), of an attitude quaternion w, x, y, z; the heading drops out."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    up0, up1, up2 = up_of(quaternion * (1.0 / math.sqrt(w * w + x * x + y * y + z * z)))
    rot = np.empty((3, 3))
    # A trunk that stands on its nose has no heading; the floor keeps the numbers finite until the caller gives up.
    s = 1.0 / math.sqrt(max(1.0 - up0 * up0, 1e-9))
    rot[0, 0] = (1.0 - up0 * up0) * s
    rot[0, 1] = -up0 * up1 * s
    rot[0, 2] = -up0 * up2 * s
    rot[2, 0] = up0
    rot[2, 1] = up1
    rot[2, 2] = up2
    rot[1, 0] = 0.0
    rot[1, 1] = up2 * s
    rot[1, 2] = -up1 * s
    return rot


@njit(cache=True)
def rotate(rot: Array, v: Array) -> Array:
    """`rot` (3, 3) times each row of `v` (n, 3)."""
    out = np.empty_like(v)
    for i in range(v.shape[0]):
        for axis in range(3):
            out[i, axis] = rot[axis, 0] * v[i, 0] + rot[axis, 1] * v[i, 1] + rot[axis, 2] * v[i, 2]
    return out


@njit(cache=True)
def leg_weight(q: Array, rot: Array) -> tuple[Array, Array]:
    """Joint torques (4, 3) [Nm] that carry the legs' own weight with the trunk held, and the robot's centre of mass
    (3,) [m], H."""
    torque = np.zeros((4, 3))
    com = np.empty(3)
    com[0] = _BASE_M * _BASE_X
    com[1] = 0.0
    com[2] = _BASE_M * _BASE_Z
    up = rot[2]
    for leg in range(4):
        hip = q[3 * leg]
        thigh = q[3 * leg + 1]
        shank = thigh + q[3 * leg + 2]
        s = math.sin(hip)
        c = math.cos(hip)
        sy = SIGN_Y[leg]
        st = math.sin(thigh)
        ct = math.cos(thigh)
        ss = math.sin(shank)
        cs = math.cos(shank)
        com[0] += _HIP_M * HIP_X * SIGN_X[leg]
        com[1] += _HIP_M * HIP_Y * sy
        for part in range(3):
            if part == 0:
                mass = _THIGH_M
                x = _THIGH_Z * st
                y = (THIGH_Y + _THIGH_Y) * sy
                z = _THIGH_Z * ct
                cx = 0.0
                cz = 0.0
            else:
                mass = _SHANK_M if part == 1 else _WHEEL_M
                down = -_SHANK_Z if part == 1 else CALF
                y = THIGH_Y * sy if part == 1 else (THIGH_Y + _WHEEL_Y) * sy
                cx = -down * ss
                cz = -down * cs
                x = -THIGH * st + cx
                z = -THIGH * ct + cz
            com[0] += mass * (HIP_X * SIGN_X[leg] + x)
            com[1] += mass * (HIP_Y * sy + y * c - z * s)
            com[2] += mass * (y * s + z * c)
            mg = mass * GRAVITY
            torque[leg, 0] += mg * (up[1] * (-y * s - z * c) + up[2] * (y * c - z * s))
            torque[leg, 1] += mg * (up[0] * z + up[1] * x * s - up[2] * x * c)
            torque[leg, 2] += mg * (up[0] * cz + up[1] * cx * s - up[2] * cx * c)
    com /= ROBOT_MASS
    return torque, rotate(rot, com.reshape(1, 3))[0]


@njit(cache=True)
def contact_geometry(
    q: Array, rot: Array, centres: Array, jac: Array, slope_x: float, slope_y: float
) -> tuple[Array, Array, Array, Array]:
    """Where the wheels touch a plane of the given slopes and how the leg joints move those points with the wheels
    locked.

    `centres` (4, 3), `jac` (4, 3, 3) in H. Returns the contact points (4, 3) [m], their Jacobians (4, 3, 3) over hip,
    thigh, calf, the rolling direction (4, 3) and the axle (4, 3), all in H."""
    n = np.empty(3)
    norm = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    n[0] = -slope_x * norm
    n[1] = -slope_y * norm
    n[2] = norm
    points = np.empty((4, 3))
    jac_c = np.empty((4, 3, 3))
    forward = np.empty((4, 3))
    axles = np.empty((4, 3))
    hip_axis = rot[:, 0]
    for leg in range(4):
        s = math.sin(q[3 * leg])
        c = math.cos(q[3 * leg])
        a0 = rot[0, 1] * c + rot[0, 2] * s
        a1 = rot[1, 1] * c + rot[1, 2] * s
        a2 = rot[2, 1] * c + rot[2, 2] * s
        dot = n[0] * a0 + n[1] * a1 + n[2] * a2
        u0 = n[0] - dot * a0
        u1 = n[1] - dot * a1
        u2 = n[2] - dot * a2
        k = 1.0 / math.sqrt(max(u0 * u0 + u1 * u1 + u2 * u2, 1e-9))
        u0 *= k
        u1 *= k
        u2 *= k
        axles[leg, 0] = a0
        axles[leg, 1] = a1
        axles[leg, 2] = a2
        forward[leg, 0] = a1 * u2 - a2 * u1
        forward[leg, 1] = a2 * u0 - a0 * u2
        forward[leg, 2] = a0 * u1 - a1 * u0
        d0 = -WHEEL_RADIUS * u0
        d1 = -WHEEL_RADIUS * u1
        d2 = -WHEEL_RADIUS * u2
        points[leg, 0] = centres[leg, 0] + d0
        points[leg, 1] = centres[leg, 1] + d1
        points[leg, 2] = centres[leg, 2] + d2
        for joint in range(3):
            if joint == 0:
                b0, b1, b2 = hip_axis[0], hip_axis[1], hip_axis[2]
            else:
                b0, b1, b2 = a0, a1, a2
            jac_c[leg, 0, joint] = jac[leg, 0, joint] + b1 * d2 - b2 * d1
            jac_c[leg, 1, joint] = jac[leg, 1, joint] + b2 * d0 - b0 * d2
            jac_c[leg, 2, joint] = jac[leg, 2, joint] + b0 * d1 - b1 * d0
    return points, jac_c, forward, axles


@njit(cache=True)
def fit_plane(points: Array, weight: Array) -> tuple[float, float, float]:
    """Weighted plane z = h + sx x + sy y through four points (4, 3): h, sx, sy. A little damping keeps lines and
    points finite."""
    sw = 0.0
    mx = 0.0
    my = 0.0
    mz = 0.0
    for i in range(4):
        sw += weight[i]
        mx += weight[i] * points[i, 0]
        my += weight[i] * points[i, 1]
        mz += weight[i] * points[i, 2]
    mx /= sw
    my /= sw
    mz /= sw
    xx = 1e-4
    yy = 1e-4
    xy = 0.0
    xz = 0.0
    yz = 0.0
    for i in range(4):
        dx = points[i, 0] - mx
        dy = points[i, 1] - my
        dz = points[i, 2] - mz
        xx += weight[i] * dx * dx
        yy += weight[i] * dy * dy
        xy += weight[i] * dx * dy
        xz += weight[i] * dx * dz
        yz += weight[i] * dy * dz
    det = xx * yy - xy * xy
    sx = (xz * yy - yz * xy) / det
    sy = (yz * xx - xz * xy) / det
    return mz - sx * mx - sy * my, sx, sy


@njit(cache=True)
def distribute(
    points: Array, com: Array, wrench: Array, lower: Array, upper: Array, force: Array, sweeps: int
) -> None:
    """Vertical wheel forces that best give a lift and two tilting moments, inside their bounds.

    Minimises (sum f - Fz)^2 + ((sum y f - Mx)^2 + (sum -x f - My)^2) / a^2 + eps |f - mean|^2 by coordinate descent,
    in place and warm-started from `force` (4,) [N]. `wrench`: Fz [N], Mx, My [Nm] about `com`; a = 0.19 m makes
    moments forces."""
    inv = 1.0 / 0.19
    eps = 0.02
    b1 = wrench[1] * inv
    b2 = wrench[2] * inv
    mean = 0.25 * wrench[0]
    r0 = -wrench[0]
    r1 = -b1
    r2 = -b2
    for i in range(4):
        r0 += force[i]
        r1 += (points[i, 1] - com[1]) * inv * force[i]
        r2 -= (points[i, 0] - com[0]) * inv * force[i]
    for _ in range(sweeps):
        for i in range(4):
            a1 = (points[i, 1] - com[1]) * inv
            a2 = -(points[i, 0] - com[0]) * inv
            grad = r0 + a1 * r1 + a2 * r2 + eps * (force[i] - mean)
            new = force[i] - grad / (1.0 + a1 * a1 + a2 * a2 + eps)
            new = min(max(new, lower[i]), upper[i])
            step = new - force[i]
            force[i] = new
            r0 += step
            r1 += a1 * step
            r2 += a2 * step
