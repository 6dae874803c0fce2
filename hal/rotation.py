"""Rotation matrices from roll, pitch and yaw, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hal.types import Array


def rotation_rpy(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """(..., 3, 3) rotations parent <- child about the fixed x, y, z axes of the parent, Rz(yaw) Ry(pitch) Rx(roll) (REP 103).

    Angles (...) [rad].
    """
    r, p, y = (np.asarray(angle, np.float64) for angle in (roll, pitch, yaw))
    cr, cp, cy, sr, sp, sy = np.cos(r), np.cos(p), np.cos(y), np.sin(r), np.sin(p), np.sin(y)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp * np.ones_like(cy), cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rpy_of(rotation: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of a (3, 3) rotation, the inverse of `rotation_rpy`; pitch within a right angle."""
    r = np.asarray(rotation)
    roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    return float(roll), float(np.arctan2(-r[2, 0], np.hypot(r[2, 1], r[2, 2]))), float(yaw)
