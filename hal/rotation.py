"""Rotations: angles, roll, pitch and yaw, quaternions x, y, z, w, matrices and rotation vectors."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import ArrayLike

from hal.types import Array

Angle = TypeVar("Angle", float, Array)


@register_jitable
def wrap(angle: Angle) -> Angle:
    """The same direction in (-pi, pi]. `angle` [rad]: a number, or an array of any shape. Kernels may call it."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def rotation_rpy(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """(..., 3, 3) rotations parent <- child about the fixed x, y, z axes of the parent, Rz(yaw) Ry(pitch) Rx(roll)
    (REP 103).

    Angles (...) [rad]."""
    r, p, y = (np.asarray(angle, np.float64) for angle in (roll, pitch, yaw))
    cr, cp, cy, sr, sp, sy = np.cos(r), np.cos(p), np.cos(y), np.sin(r), np.sin(p), np.sin(y)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp * np.ones_like(cy), cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rpy_of(matrix: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of a (3, 3) rotation, the inverse of `rotation_rpy`; pitch within a right angle."""
    r = np.asarray(matrix)
    roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    return float(roll), float(np.arctan2(-r[2, 0], np.hypot(r[2, 1], r[2, 2]))), float(yaw)


@njit(cache=True)
def up_of(quaternion: Array) -> tuple[float, float, float]:
    """World z in the axes of a body whose attitude is the unit quaternion w, x, y, z (the order of LowState and
    MuJoCo)."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True)
def rotation(q: Array) -> Array:
    """(3, 3) matrix of the unit quaternion x, y, z, w."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    out = np.empty((3, 3))
    out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    out[0, 1] = 2.0 * (x * y - z * w)
    out[0, 2] = 2.0 * (x * z + y * w)
    out[1, 0] = 2.0 * (x * y + z * w)
    out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    out[1, 2] = 2.0 * (y * z - x * w)
    out[2, 0] = 2.0 * (x * z - y * w)
    out[2, 1] = 2.0 * (y * z + x * w)
    out[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return out


@njit(cache=True)
def rotations(q: Array) -> Array:
    """(n, 3, 3) `rotation` of n unit quaternions (n, 4)."""
    out = np.empty((len(q), 3, 3))
    for i in range(len(q)):
        one = rotation(q[i])
        for a in range(3):
            for b in range(3):
                out[i, a, b] = one[a, b]
    return out


@njit(cache=True)
def turn(q: Array, rx: float, ry: float, rz: float) -> None:
    """In place q <- q * Exp(r), r a rotation vector [rad] in the body frame; renormalised."""
    angle = math.sqrt(rx * rx + ry * ry + rz * rz)
    s = 0.5 - angle * angle / 48.0 if angle < 1e-3 else math.sin(0.5 * angle) / angle
    bx, by, bz, bw = rx * s, ry * s, rz * s, math.cos(0.5 * angle)
    x, y, z, w = q[0], q[1], q[2], q[3]
    nx = w * bx + x * bw + y * bz - z * by
    ny = w * by - x * bz + y * bw + z * bx
    nz = w * bz + x * by - y * bx + z * bw
    nw = w * bw - x * bx - y * by - z * bz
    n = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + nw * nw)
    q[0], q[1], q[2], q[3] = nx * n, ny * n, nz * n, nw * n


def quaternion(matrix: Array) -> Array:
    """(4,) x, y, z, w of a rotation matrix (3, 3), w >= 0."""
    m = np.asarray(matrix, float)
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    options = np.array([m[0, 0], m[1, 1], m[2, 2], trace])
    k = int(options.argmax())
    q = np.empty(4)
    if k == 3:
        q[:] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1.0 + trace
    else:
        i, j, n = k, (k + 1) % 3, (k + 2) % 3
        q[i] = 1.0 - trace + 2.0 * m[i, i]
        q[j] = m[j, i] + m[i, j]
        q[n] = m[n, i] + m[i, n]
        q[3] = m[n, j] - m[j, n]
    q /= math.sqrt(float(q @ q))
    return -q if q[3] < 0.0 else q


def rotation_vector(matrix: Array) -> Array:
    """(3,) Log of a rotation matrix [rad]."""
    q = quaternion(matrix)
    s = math.sqrt(float(q[:3] @ q[:3]))
    angle = 2.0 * math.atan2(s, float(q[3]))
    return q[:3] * (2.0 if s < 1e-9 else angle / s)


def rotation_vectors(matrices: Array) -> Array:
    """(n, 3) `rotation_vector` of n rotation matrices (n, 3, 3), in a seventh of the time where all turns are small."""
    m = matrices
    trace = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    if not (trace > np.max([m[:, k, k] for k in range(3)], axis=0)).all():
        return np.array([rotation_vector(one) for one in m]).reshape(-1, 3)
    turned = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    q = np.stack([*turned, 1.0 + trace], axis=1)
    q /= np.sqrt(_squares(q))[:, None]
    s = np.sqrt(_squares(q[:, :3]))
    angle = np.array([2.0 * math.atan2(a, b) for a, b in zip(s.tolist(), q[:, 3].tolist(), strict=True)])
    small = s < 1e-9
    return q[:, :3] * np.where(small, 2.0, angle / np.where(small, 1.0, s))[:, None]


def _squares(v: Array) -> Array:
    """(n,) inner product of each row (n, k) with itself."""
    out: Array = np.matmul(v[:, None, :], v[:, :, None])[:, 0, 0]
    return out


def cross(a: ArrayLike, b: ArrayLike) -> Array:
    """(3,) cross product of two vectors (3,): that of numpy in a tenth of its time."""
    (ax, ay, az), (bx, by, bz) = np.asarray(a, np.float64).tolist(), np.asarray(b, np.float64).tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def skew(v: Array) -> Array:
    """(3, 3) cross-product matrix."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
