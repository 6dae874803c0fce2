"""Poses at the border of the map: checked once, used as matrices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hal.rotation import rotation
from mapping.elevation.exchange import MapError
from mapping.grid import FARTHEST_PLACE

POSE_SPEED, POSE_SLACK = 5.0, 3.0
"""Twice the speed of our robots [m/s], and the largest correction of an odometry [m]: no pose lies further from the
one before."""


def checked_pose(
    position: ArrayLike, orientation: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation matrix (3,3) and position (3,) of a pose with orientation (4,) x, y, z, w. Raises MapError."""
    place = np.array(position, dtype=np.float64)
    q = np.asarray(orientation, dtype=np.float64)
    # plain numbers: on arrays this small numpy's calls cost more than the work
    shaped = place.shape == (3,) and q.shape == (4,)
    far, norm = (math.hypot(*place.tolist()), math.hypot(*q.tolist())) if shaped else (math.nan, math.nan)
    if not math.isfinite(far + norm):
        raise MapError(f"pose must be finite (3,) and (4,), got {place} and {q}")
    if far > FARTHEST_PLACE:
        raise MapError(f"pose {place} is more than {FARTHEST_PLACE / 1000:.0f} km from the origin of `map`")
    if norm < 0.5:
        raise MapError(f"orientation must be a unit quaternion x, y, z, w, got {q}")
    return rotation(q / norm), place


class Course:
    """The places that a robot passes. A place out of reach from the last one is an error of the odometry. Mapping it
    would cost megabytes of tiles and draw the ground in a wrong place."""

    def __init__(self) -> None:
        self.warning = ""
        """For the operator, while poses are refused."""
        self._last: tuple[int, NDArray[np.float64]] | None = None

    @property
    def place(self) -> tuple[float, float] | None:
        """x, y [m] of the last one; None before the first."""
        return None if self._last is None else (float(self._last[1][0]), float(self._last[1][1]))

    def forget(self) -> None:
        """The pose was set: the next place may be anywhere."""
        self.warning, self._last = "", None

    def follow(self, position: ArrayLike, stamp: int) -> None:
        """The next place (3,) [m] at `stamp` [ns]. Raises MapError if it is out of reach; the last good place stays
        the last."""
        place = np.array(position, dtype=np.float64)
        if not np.isfinite(place).all():
            raise MapError(f"pose must be finite, got {place}")
        if self._last is not None:
            before, last = self._last
            far = float(np.linalg.norm(place - last))
            if far > POSE_SLACK + POSE_SPEED * max(0, stamp - before) / 1e9:
                self.warning = (
                    f"the pose jumped {far:.0f} m: set it while the robot stands, or restart the stack"
                )
                raise MapError(self.warning)
        self.warning, self._last = "", (stamp, place)
