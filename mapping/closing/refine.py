"""Keyframes laid onto each other once more, when all loops are known: one sweep onto another, point to plane.

What odometry adds up between two loops no loop tells: lengths, and the noise of its heading. Two sweeps some metres
apart tell both ten times better, and no drift is in them, as it is in a map of many scans."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import small_gicp

from hal.rotation import rotation_rpy, wrap
from hal.types import Array
from mapping.closing.graph import back
from mapping.closing.keyframes import Keyframe, seen_from
from mapping.closing.recording import Recording
from mapping.closing.verify import LEAST_GRIP
from mapping.relocalise.submap import NEAREST_POINT
from mapping.thin_cloud import ThinCloud

SWEEP_VOXEL = 0.1
"""Voxels of a sweep [m]."""
NORMAL_NEIGHBOURS = 20
"""Points behind the normal of one."""
PULL_REACH = (0.4, 0.4, 0.4, 0.2, 0.2, 0.2, 0.2, 0.1, 0.1, 0.1, 0.1)
"""Farthest partner of a point [m] in each step."""
PLANE_SCALE = 0.02
"""Points that lie so far off the plane [m] count a quarter, or a tenth of the pull where that is more."""
DIRECTION_GAP = (0.02, 0.02, 0.02, math.radians(0.1))
"""The two ways of a registration differ by less along x, y, z [m] and in yaw [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """What was seen from one place."""

    points: Array
    """(n, 3) in the frame of the ground under the robot, x ahead [m]."""
    normals: Array
    """(n, 3)"""
    tree: small_gicp.KdTree

    @classmethod
    def of(cls, recording: Recording, keyframe: Keyframe) -> Sweep | None:
        """The keyframe's own scan; None where it holds next to nothing."""
        scan, thin = recording.scans[keyframe.scan], ThinCloud(SWEEP_VOXEL)
        pose = seen_from(keyframe.place, scan.pose)
        for _, points in recording.points(scan):
            far = np.hypot(points[:, 0], points[:, 1]) > NEAREST_POINT
            thin.add(points[far], pose[:3, :3], pose[:3, 3])
        if len(thin.points) < NORMAL_NEIGHBOURS:
            return None
        cloud = small_gicp.PointCloud(thin.points.astype(np.float64))
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_normals_covariances(cloud, tree, NORMAL_NEIGHBOURS)
        return cls(
            np.asarray(cloud.points())[:, :3], np.ascontiguousarray(np.asarray(cloud.normals())[:, :3]), tree
        )

    def lay(self, other: Sweep, relative: Array) -> tuple[Array, float]:
        """Where (4,) in the frame of this one the other is, near `relative` (4,), as gravity is known; and how well the
        walls hold it in the plane [0..0.5]."""
        pose, grip = relative.copy(), 0.0
        for reach in PULL_REACH:
            there = other.points @ rotation_rpy(0.0, 0.0, pose[3]).T + pose[:3]
            index, square = (
                np.asarray(a).reshape(-1) for a in self.tree.batch_nearest_neighbor_search(there)
            )
            met = square < reach**2
            there, index = there[met], index[met].astype(np.int64)
            normal = self.normals[index]
            off = np.einsum("ij,ij->i", there - self.points[index], normal)
            arm = there[:, :2] - pose[:2]
            turn = normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]
            jacobian = np.column_stack([normal, turn])
            weight = 1.0 / (1.0 + (off / max(PLANE_SCALE, 0.1 * reach)) ** 2) ** 2
            a = (jacobian * weight[:, None]).T @ jacobian + 1e-6 * np.eye(4)
            pose = pose - np.linalg.solve(a, (jacobian * weight[:, None]).T @ off)
            held = np.linalg.eigvalsh(a[:2, :2])
            grip = float(held[0] / held.sum())
        pose[3] = wrap(pose[3])
        return pose, grip


def exact(a: Sweep | None, b: Sweep | None, relative: Array) -> Array | None:
    """(4,) b in the frame of a, near `relative` (4,), by both ways; None where they do not agree, or where the walls
    hold it in one direction only."""
    if a is None or b is None:
        return None
    there, grip = a.lay(b, relative)
    again, other = b.lay(a, back(there))
    again = back(again)
    if min(grip, other) < LEAST_GRIP or (apart(there, again) > DIRECTION_GAP).any():
        return None
    again[3] = there[3] + wrap(again[3] - there[3])
    return 0.5 * (there + again)


def apart(a: Array, b: Array) -> Array:
    """(4,) by how much two relative poses differ along x, y, z [m] and in yaw [rad]."""
    return np.abs(np.array([*(a - b)[:3], wrap(a[3] - b[3])]))
