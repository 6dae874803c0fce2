"""Motion compensation: every point to where it would have been measured at the end of the sweep."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.rotation import rotation_rpy, rotation_vectors, rotations
from hal.types import Array, Extrinsics, LidarName
from mapping.odometry.intake import Sweep


def mount_matrix(mount: Extrinsics) -> Array:
    """(4, 4) base_link <- sensor; rotation Rz(yaw) Ry(pitch) Rx(roll)."""
    out = np.eye(4)
    out[:3, :3] = rotation_rpy(*mount.rpy)
    out[:3, 3] = mount.translation
    return out


@njit(cache=True)
def _deskew(
    xyz: NDArray[np.float32],
    time: Array,
    knot: Array,
    rot: Array,
    pos: Array,
    step: Array,
    out: NDArray[np.float32],
) -> None:
    """Point i at time[i] between knots k, k+1 moves by rot[k] Exp(s step[k]) p + pos interpolated, s in [0, 1]."""
    last = len(knot) - 2
    k = 0
    for i in range(len(time)):
        t = time[i]
        while k < last and t > knot[k + 1]:
            k += 1
        while k > 0 and t < knot[k]:
            k -= 1
        s = min(max((t - knot[k]) / (knot[k + 1] - knot[k]), 0.0), 1.0)
        ax, ay, az = s * step[k, 0], s * step[k, 1], s * step[k, 2]
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        # Exp to second order: knots are milliseconds apart.
        cx, cy, cz = ay * z - az * y, az * x - ax * z, ax * y - ay * x
        x, y, z = (
            x + cx + 0.5 * (ay * cz - az * cy),
            y + cy + 0.5 * (az * cx - ax * cz),
            z + cz + 0.5 * (ax * cy - ay * cx),
        )
        for a in range(3):
            out[i, a] = (
                rot[k, a, 0] * x
                + rot[k, a, 1] * y
                + rot[k, a, 2] * z
                + pos[k, a]
                + s * (pos[k + 1, a] - pos[k, a])
            )


def deskew(
    xyz: NDArray[np.float32], time: Array, stamps: NDArray[np.int64], track: Array, start: int, lever: Array
) -> NDArray[np.float32]:
    """Move points (n, 3) in base_link as measured to (n, 3) float32 in base_link at the last stamp of the track.

    `time` (n,) [s] since `start` [ns]; `stamps` (k,) [ns] and `track` (k, >= 10) poses of the IMU at `lever` (3,) in
    base_link, ascending. Points measured outside the track are taken at its ends."""
    first = max(int(np.searchsorted(stamps, start, side="right")) - 1, 0)
    knots = (stamps[first:] - start) * 1e-9
    moved = np.concatenate([[True], np.diff(knots) > 0.0])
    poses = track[first:][moved]
    knots = knots[moved]
    if len(knots) < 2:
        return np.array(xyz, np.float32)
    rots = rotations(np.ascontiguousarray(poses[:, 6:10]))
    pos = poses[:, :3] - rots @ lever
    end_rot, end_pos = rots[-1], pos[-1]
    step = rotation_vectors(np.matmul(rots[:-1].transpose(0, 2, 1), rots[1:]))
    out = np.empty((len(xyz), 3), np.float32)
    _deskew(
        np.ascontiguousarray(xyz, np.float32),
        np.ascontiguousarray(time, np.float64),
        np.ascontiguousarray(knots),
        np.ascontiguousarray(end_rot.T @ rots),
        np.ascontiguousarray((pos - end_pos) @ end_rot),
        step,
        out,
    )
    return out


class Deskewer:
    """Sweeps of all LiDARs, each to the end of the main one's."""

    def __init__(self, mounts: Mapping[LidarName, Extrinsics], lever: Array) -> None:
        """`mounts`: each LiDAR in base_link; `lever` (3,): IMU in base_link [m]."""
        self._mounts = {name: mount_matrix(mount).astype(np.float32) for name, mount in mounts.items()}
        self._lever = lever
        self._path: tuple[NDArray[np.int64], Array] | None = None
        """Track of the last scan: a sweep of another LiDAR began before this one did."""

    def forget(self) -> None:
        """The clock was set."""
        self._path = None

    def cloud(self, sweep: Sweep, stamps: NDArray[np.int64], track: Array) -> NDArray[np.float32]:
        """(n, 3) base_link at the end of the track, see `deskew`."""
        mount = self._mounts[sweep.name]
        xyz = sweep.xyz @ mount[:3, :3].T + mount[:3, 3]
        return deskew(xyz, sweep.time, stamps, track, sweep.start, self._lever)

    def beside(
        self, sweeps: Iterable[Sweep], stamps: NDArray[np.int64], track: Array
    ) -> dict[LidarName, NDArray[np.float32]]:
        """Clouds of the other LiDARs of the same time, at the end of the track. Call it for every track."""
        path, self._path = self._path, (stamps, track)
        if path is not None:
            stamps, track = np.concatenate([path[0], stamps]), np.concatenate([path[1], track])
        parts: dict[LidarName, list[NDArray[np.float32]]] = {}
        for sweep in sweeps:
            parts.setdefault(sweep.name, []).append(self.cloud(sweep, stamps, track))
        return {name: np.concatenate(clouds) for name, clouds in parts.items()}
