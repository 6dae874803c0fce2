"""Poses at the border of the map: checked once, used as matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hal.rotation import rotation
from mapping.elevation.exchange import MapError
from mapping.grid import FARTHEST


def checked_pose(
    position: ArrayLike, orientation: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation matrix (3,3) and position (3,) of a pose with orientation (4,) x, y, z, w. Raises MapError."""
    place = np.array(position, dtype=np.float64)
    q = np.asarray(orientation, dtype=np.float64)
    if place.shape != (3,) or q.shape != (4,) or not (np.isfinite(place).all() and np.isfinite(q).all()):
        raise MapError(f"pose must be finite (3,) and (4,), got {place} and {q}")
    if np.abs(place).max() > FARTHEST:
        raise MapError(f"pose {place} is more than {FARTHEST / 1000:.0f} km from the origin of `map`")
    norm = float(np.linalg.norm(q))
    if norm < 0.5:
        raise MapError(f"orientation must be a unit quaternion x, y, z, w, got {q}")
    return rotation(q / norm), place
