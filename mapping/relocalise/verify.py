"""What speaks for a place and what against it: points on the map's surfaces, rays through them, things on ground that the map knows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import small_gicp
from numba import njit
from numpy.typing import NDArray

from hal.rotation import rotation_rpy, wrap
from mapping.grid import ElevationGrid
from mapping.relocalise.search import Place
from mapping.relocalise.submap import GROUND
from mapping.thin_cloud import FREE, VOXEL, ThinCloud, find_voxel, voxel_key

NEIGHBOURS = 10
"""Points behind the normal of one."""
PULL = (*(0.6,) * 6, *(0.3,) * 6)
"""Farthest partner of a point [m] in each step of the registration."""
ON = 0.06
"""A point within this of a surface lies on it [m]."""
PATCH = 0.35
"""The surface around a point of the map reaches this far [m]."""
FACING = 0.35
"""Cosine of ray and normal above which a ray passes through a surface and not along it."""
SHORT = 0.5
"""The two ends of a ray prove nothing [m]."""
TALL = 1.2
"""Something up to this high above known ground contradicts it [m]; what hangs higher may always hang there."""
LOW, RISES = 0.25, 6.0
"""Points up to so high above known ground [m], where nothing higher stands, and the weight of their share: ramps and kerbs are all that tells
the two ends of a lane apart, and boxes, which are moved, are higher."""
FLAT = 0.1
"""Largest range of heights [m] in a square of known ground."""


class Surfaces:
    """The cloud of a map with its normals, and its known flat ground."""

    def __init__(self, cloud: NDArray[np.float32], ground: Sequence[ElevationGrid]) -> None:
        thin = ThinCloud()
        thin.enter(cloud)
        self.points = thin.points.astype(np.float64)
        self.index = thin.index
        self.voxel = thin.voxel
        self.target = small_gicp.PointCloud(self.points)
        self.tree = small_gicp.KdTree(self.target)
        small_gicp.estimate_normals_covariances(self.target, self.tree, NEIGHBOURS)
        self.normals = np.ascontiguousarray(np.asarray(self.target.normals())[:, :3])
        self.ground = FlatGround(ground)

    def register(self, cloud: NDArray[np.float64], place: Place) -> Place:
        """The place of a submap (n, 3), exactly: point to plane in x, y, z and yaw, as gravity is known."""
        x, y, z, yaw = place.x, place.y, place.z, place.yaw
        for reach in PULL:
            pose = pose_of(Place(x, y, z, yaw, place.share))
            there = cloud @ pose[:3, :3].T + pose[:3, 3]
            near, square = self._nearest(there)
            there, near = there[square < reach**2], near[square < reach**2]
            normal = self.normals[near]
            off = np.einsum("ij,ij->i", there - self.points[near], normal)
            arm = there[:, :2] - (x, y)
            turn = normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]
            jacobian = np.column_stack([normal, turn])
            weight = 1.0 / (1.0 + (off / (0.25 * reach)) ** 2) ** 2
            a = (jacobian * weight[:, None]).T @ jacobian + np.eye(4)
            step = np.linalg.solve(a, -(jacobian * weight[:, None]).T @ off)
            x, y, z, yaw = x + step[0], y + step[1], z + step[2], wrap(yaw + step[3])
        return Place(float(x), float(y), float(z), float(yaw), place.share)

    def _nearest(self, there: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Index (n,) of the map's point nearest to each of (n, 3), and the square of its distance (n,) [m^2]."""
        index, square = self.tree.batch_nearest_neighbor_search(there)
        return np.asarray(index, np.int64).reshape(-1), np.asarray(square, np.float64).reshape(-1)

    def evidence(
        self, cloud: NDArray[np.float64], eyes: NDArray[np.float64], place: Place
    ) -> tuple[float, float]:
        """Shares [0..1] of the submap's structure that lies on surfaces of the map, and that contradicts it.

        cloud, eyes (n, 3) [m] from the ground under the robot, see `Submap.cloud`.
        """
        pose = pose_of(place)
        there, eye = (x @ pose[:3, :3].T + pose[:3, 3] for x in (cloud, eyes))
        near, square = self._nearest(there)
        off = np.abs(np.einsum("ij,ij->i", there - self.points[near], self.normals[near]))
        on = (square < PATCH**2) & (off < ON)
        structure = cloud[:, 2] > GROUND
        met = np.unique(near[on & structure]).size
        gone = int(pierced(eye, there, self.points, self.normals, *self.index, self.voxel).sum())
        low, high, where = self.ground.below(there)
        stands = structure & ~on & (there[:, 2] > low + GROUND) & (there[:, 2] < low + TALL)
        agree = share(on, structure) * share(on, ~structure)
        over = there[:, 2] - high
        beside_tall = np.isin(where, _with_neighbours(np.unique(where[over > LOW])))
        rises = float(((over > ON) & (over < LOW) & ~beside_tall).mean())
        return agree, share(stands, structure) + gone / max(1, gone + met) + RISES * rises


def share(what: NDArray[np.bool_], of: NDArray[np.bool_]) -> float:
    """Of the points `of` (n,) that are `what` (n,) [0..1]; 1 where there are none."""
    return float(what[of].mean()) if of.any() else 1.0


class FlatGround:
    """Height of the squares of a map whose ground is known and flat. Blocks in, one sorted list of squares out: memory goes with the ground."""

    def __init__(self, ground: Sequence[ElevationGrid]) -> None:
        """ground: blocks of one lattice; a square that lies in several is not known."""
        res = ground[0].resolution
        k = max(1, round(VOXEL / res))
        self._side = k * res
        first = [tuple(round(v / res) for v in block.origin) for block in ground]
        col, row = min(c for c, _ in first), min(r for _, r in first)
        self._corner = ((col - 0.5) * res, (row - 0.5) * res)
        keys, heights = [np.empty(0, np.int64)], [np.empty((0, 2), np.float32)]
        for block, (c0, r0) in zip(ground, first, strict=True):
            skip_r, skip_c = (row - r0) % k, (col - c0) % k
            cut = np.where(block.trusted, block.height, np.nan)[skip_r:, skip_c:]
            rows, cols = (n // k for n in cut.shape)
            blocks = cut[: rows * k, : cols * k].reshape(rows, k, cols, k)
            low, high = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))  # NaN where any cell is unknown
            r, c = np.nonzero(high - low < FLAT)
            keys.append(_key(r + (r0 + skip_r - row) // k, c + (c0 + skip_c - col) // k))
            heights.append(np.column_stack([low[r, c], high[r, c]]))
        key, height = np.concatenate(keys), np.concatenate(heights)
        order = np.argsort(key)
        self._keys, self._heights = key[order], height[order]

    def below(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """Of the square that each of (n, 3) lies over: lowest and highest height (n,) [m], NaN where it is not known, and its number (n,)."""
        out = np.full((2, len(points)), np.nan, np.float32)
        key = np.zeros(len(points), np.int64)
        if len(self._keys):
            c, r = (np.floor((points[:, k] - self._corner[k]) / self._side).astype(np.int64) for k in (0, 1))
            key = _key(r, c)
            at = np.searchsorted(self._keys, key).clip(max=len(self._keys) - 1)
            here = self._keys[at] == key
            out[:, here] = self._heights[at[here]].T
        return out[0], out[1], key


def _with_neighbours(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Squares by their numbers (n,) and the eight around each."""
    row, col = np.mgrid[-1:2, -1:2].reshape(2, -1)
    return (keys[:, None] + _key(row, col)).ravel()


def _key(row: NDArray[np.int64], col: NDArray[np.int64]) -> NDArray[np.int64]:
    """Row and column of a square as one number."""
    return (row << 32) + col


def pose_of(place: Place) -> NDArray[np.float64]:
    """(4, 4) `map` <- ground under the robot."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_rpy(0.0, 0.0, place.yaw)
    pose[:3, 3] = place.x, place.y, place.z
    return pose


@njit(cache=True)
def pierced(eyes, ends, surfaces, normals, table, keys, voxel):  # pragma: no cover - compiled
    """(m,) bool: through which surfaces, points (m, 3) with normals (m, 3) found by their voxels, a ray from eyes to ends (n, 3) passes."""
    out = np.zeros(len(surfaces), np.bool_)
    for n in range(len(ends)):
        dx, dy, dz = ends[n, 0] - eyes[n, 0], ends[n, 1] - eyes[n, 1], ends[n, 2] - eyes[n, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        if length < 2.0 * SHORT:
            continue
        dx, dy, dz = dx / length, dy / length, dz / length
        s = SHORT
        last = np.int64(0)
        while s < length - SHORT:
            key = voxel_key(eyes[n, 0] + s * dx, eyes[n, 1] + s * dy, eyes[n, 2] + s * dz, voxel)
            s += 0.4 * voxel
            if key == last:
                continue
            last = key
            m = table[find_voxel(key, table, keys)]
            if m == FREE or out[m]:
                continue
            facing = dx * normals[m, 0] + dy * normals[m, 1] + dz * normals[m, 2]
            if abs(facing) < FACING:
                continue
            px, py, pz = surfaces[m, 0] - eyes[n, 0], surfaces[m, 1] - eyes[n, 1], surfaces[m, 2] - eyes[n, 2]
            along = (px * normals[m, 0] + py * normals[m, 1] + pz * normals[m, 2]) / facing
            if along < SHORT or along > length - SHORT:
                continue
            aside = (px - along * dx) ** 2 + (py - along * dy) ** 2 + (pz - along * dz) ** 2
            out[m] = aside < (0.3 * voxel) ** 2
    return out
