"""What the LiDARs saw while the robot stood, here and at earlier stands: one cloud in `odom`, with the sensor
position of each point."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hal.rotation import rotation as matrix_of
from hal.rotation import rpy_of
from mapping.thin_cloud import ThinCloud

SUBMAP_VOXEL = 0.1
"""Voxels of the submap [m]: registration needs more than the search."""
NEAREST_POINT = 0.6
"""Nearer points are the robot itself or the ground beneath it [m]."""
GROUND_BAND = 0.2
"""What is higher than this above the robot's ground stands on it, or is other ground [m]."""


class Submap:
    """Scans in, one cloud out."""

    def __init__(self, voxel: float = SUBMAP_VOXEL) -> None:
        """`voxel`: edge of what becomes one point [m]."""
        self._voxel = voxel
        self._stands: list[tuple[ThinCloud, NDArray[np.float64]]] = []
        self.scans = 0
        """Of the newest stand."""
        self.ground = np.zeros(3)
        """x, y, z in `odom` of the ground under the robot at the newest scan [m]."""
        self.yaw = 0.0
        """Its heading there [rad]."""

    @property
    def stands(self) -> int:
        """Places from which the robot looked."""
        return len(self._stands)

    def stand(self) -> None:
        """The robot stands at another place from the next scan on."""
        self.scans = 0

    def add(
        self,
        points: NDArray[np.float32],
        position: NDArray[np.float64],
        orientation: NDArray[np.float64],
        eye: ArrayLike,
        below: float,
    ) -> None:
        """One scan: points (n, 3) in base_link; pose of base_link in `odom` (3,), x, y, z, w (4,); the LiDAR in
        base_link (3,); height of base_link above the ground [m]."""
        turned = matrix_of(np.asarray(orientation, np.float64))
        place = np.asarray(position, np.float64)
        if self.scans == 0:
            self._stands.append((ThinCloud(self._voxel), turned @ np.asarray(eye, np.float64) + place))
        self.scans += 1
        self._stands[-1][0].add(points, turned, place)
        self.ground = place - [0.0, 0.0, below]
        self.yaw = rpy_of(turned)[2]

    def cloud(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points (n, 3) and the sensor positions that saw them (n, 3) [m], relative to the ground under the robot,
        along its heading and up."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        points, eyes = [np.empty((0, 3))], [np.empty((0, 3))]
        for thin, eye in self._stands:
            cloud = (thin.points - self.ground) @ back.T
            seen = (eye - self.ground) @ back.T
            cloud = cloud[np.hypot(*(cloud - seen)[:, :2].T) > NEAREST_POINT]
            points.append(cloud)
            eyes.append(np.broadcast_to(seen, cloud.shape))
        return np.concatenate(points), np.concatenate(eyes)
