"""What speaks for a place and what against it: points on the map's surfaces, rays through them, things on ground that
the map knows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import small_gicp
from numba import njit
from numpy.typing import NDArray

from hal.rotation import rotation_rpy, wrap
from mapping.grid import ElevationGrid
from mapping.relocalise.search import Place
from mapping.relocalise.submap import GROUND_BAND
from mapping.thin_cloud import FREE, ThinCloud, find_voxel, voxel_key

NORMAL_NEIGHBOURS = 10
"""Points behind the normal of one."""
PULL_REACH = (*(0.6,) * 6, *(0.3,) * 6)
"""Farthest partner of a point [m] in each step of the registration."""
ON_SURFACE, ON_GROUND = 0.06, 0.04
"""A point lies on a surface of the cloud within this, and on the ground within this of its heights around [m]."""
PATCH_RADIUS = 0.35
"""The surface around a point of the map reaches this far [m]."""
FACING_COSINE = 0.35
"""Cosine of ray and normal above which a ray passes through a surface and not along it."""
RAY_ENDS = 0.5
"""The two ends of a ray prove nothing [m]."""
HANGING_HEIGHT = 1.2
"""Something up to this high above known ground contradicts it [m]; what hangs higher may always hang there."""
LOW_HEIGHT, OTHER_HEIGHT = 0.25, 0.05
"""Bare ground that differs by more than OTHER_HEIGHT from what the map knows [m] is other ground: ramps and kerbs are
all that tells the two ends of a lane apart. What differs by more than LOW_HEIGHT was put there or taken away: boxes,
which are moved, are higher."""
OTHER_WEIGHT, FEW_COLUMNS = 2.0, 60
"""Of the share of other ground, and so many columns of bare ground say half of what many say."""
SQUARE_SIDE, EVEN_BAND = 0.12, 0.03
"""Side of the squares of known ground, and how far a cell may lie off the plane through its square [m]."""
COLUMN_SIDE, THIN_HEIGHT = 0.1, 0.08
"""Side of the columns of a submap, and what is higher is no bare ground [m]."""


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
        small_gicp.estimate_normals_covariances(self.target, self.tree, NORMAL_NEIGHBOURS)
        self.normals = np.ascontiguousarray(np.asarray(self.target.normals())[:, :3])
        self.ground = Ground(ground)

    def register(self, cloud: NDArray[np.float64], place: Place) -> Place:
        """The place of a submap (n, 3), exactly: point to plane in x, y, z and yaw, as gravity is known."""
        x, y, z, yaw = place.x, place.y, place.z, place.yaw
        for reach in PULL_REACH:
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

    def grip(self, cloud: NDArray[np.float64], place: Place) -> float:
        """How well the walls that a submap (n, 3) meets hold it in the plane [0..0.5]: the share of their normals along
        the direction that they hold least. 0 in a corridor without ends, along which every place fits.
        """
        pose = pose_of(place)
        there = cloud[cloud[:, 2] > GROUND_BAND] @ pose[:3, :3].T + pose[:3, 3]
        near, square = self._nearest(there)
        normal = self.normals[near[square < PATCH_RADIUS**2], :2]
        held = np.linalg.eigvalsh(normal.T @ normal)
        return float(held[0] / max(held.sum(), 1e-9))

    def _nearest(self, there: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Index (n,) of the map's point nearest to each of (n, 3), and the square of its distance (n,) [m^2]."""
        index, square = self.tree.batch_nearest_neighbor_search(there)
        return np.asarray(index, np.int64).reshape(-1), np.asarray(square, np.float64).reshape(-1)

    def evidence(
        self,
        cloud: NDArray[np.float64],
        eyes: NDArray[np.float64],
        bare: NDArray[np.bool_],
        place: Place,
    ) -> tuple[float, float]:
        """Shares [0..1] of the submap's structure that lies on surfaces of the map, and that contradicts it.

        cloud, eyes (n, 3) [m] from the ground under the robot, see `Submap.cloud`; bare (n,): which are ground, see
        `bare_ground`.
        """
        pose = pose_of(place)
        there, eye = (x @ pose[:3, :3].T + pose[:3, 3] for x in (cloud, eyes))
        near, square = self._nearest(there)
        off = np.abs(np.einsum("ij,ij->i", there - self.points[near], self.normals[near]))
        over = there[:, 2] - self.ground.below(there)
        on = ((square < PATCH_RADIUS**2) & (off < ON_SURFACE)) | self.ground.met(there)
        structure = cloud[:, 2] > GROUND_BAND
        met = np.unique(near[on & structure]).size
        gone = int(pierced(eye, there, self.points, self.normals, *self.index, self.voxel).sum())
        stands = structure & ~on & (over > GROUND_BAND) & (over < HANGING_HEIGHT)
        agree = share(on, structure) * share(on, ~structure)
        compared = bare & (np.abs(over) < LOW_HEIGHT)
        other = int((np.abs(over[compared]) > OTHER_HEIGHT).sum()) / (int(compared.sum()) + FEW_COLUMNS)
        return agree, share(stands, structure) + gone / max(1, gone + met) + OTHER_WEIGHT * other


def share(what: NDArray[np.bool_], of: NDArray[np.bool_]) -> float:
    """Of the points `of` (n,) that are `what` (n,) [0..1]; 1 where there are none."""
    return float(what[of].mean()) if of.any() else 1.0


class Ground:
    """Known ground of a map in small squares: its heights, and its plane where it is even. Blocks in, one sorted list
    of squares out: memory goes with the ground.
    """

    def __init__(self, ground: Sequence[ElevationGrid]) -> None:
        """ground: blocks of one lattice; of a square that lies in several one part is known."""
        res = ground[0].resolution
        k = max(2, round(SQUARE_SIDE / res))
        self._side = k * res
        first = [tuple(round(v / res) for v in block.origin) for block in ground]
        col, row = min(c for c, _ in first), min(r for _, r in first)
        self._corner = np.array([(col - 0.5) * res, (row - 0.5) * res])
        keys, squares = [np.empty(0, np.int64)], [np.empty((0, 5), np.float32)]
        for block, (c0, r0) in zip(ground, first, strict=True):
            skip_r, skip_c = (row - r0) % k, (col - c0) % k
            z = np.where(block.trusted, block.height, np.nan)[skip_r:, skip_c:]
            of = _squares(z, k, res)
            r, c = np.nonzero(of[..., 0] <= of[..., 1])
            keys.append(_key(r + (r0 + skip_r - row) // k, c + (c0 + skip_c - col) // k))
            squares.append(of[r, c])
        key, square = np.concatenate(keys), np.concatenate(squares)
        order = np.argsort(key)
        self._keys, self._squares = key[order], square[order]

    def _under(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Square (n, 5), see `_squares`, that each of (n, 3) lies over, NaN where there is none, and x, y (n, 2) from
        its middle [m]."""
        out = np.full((len(points), 5), np.nan)
        at = (points[:, :2] - self._corner) / self._side
        cell = np.floor(at).astype(np.int64)
        if len(self._keys):
            key = _key(cell[:, 1], cell[:, 0])
            index = np.searchsorted(self._keys, key).clip(max=len(self._keys) - 1)
            here = self._keys[index] == key
            out[here] = self._squares[index[here]]
        return out, (at - cell - 0.5) * self._side

    def below(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height (n,) [m] of the ground below each of (n, 3); NaN where it is not known or not even."""
        square, off = self._under(points)
        return np.asarray(square[:, 2] + square[:, 3] * off[:, 0] + square[:, 4] * off[:, 1])

    def met(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of (n, 3) lie on the ground or on a face between its heights, as those of a wall."""
        square, _ = self._under(points)
        return np.asarray(
            (points[:, 2] > square[:, 0] - ON_GROUND) & (points[:, 2] < square[:, 1] + ON_GROUND)
        )


def _squares(z: NDArray[np.floating], k: int, res: float) -> NDArray[np.float32]:
    """(rows, cols, 5) of the squares of k x k cells z (rows k, cols k) [m]: lowest and highest height in and beside it,
    infinite where none is known, height in its middle, slopes along x and y; NaN where the square is not known wholly
    or not even.
    """
    rows, cols = (n // k for n in z.shape)
    low, high = np.where(np.isnan(z), np.inf, z), np.where(np.isnan(z), -np.inf, z)
    out = np.empty((rows, cols, 5), np.float32)
    for n, (side, best) in enumerate(((low, np.minimum), (high, np.maximum))):
        wide = np.pad(side, 1, constant_values=np.inf if n == 0 else -np.inf)
        for axis in (0, 1):
            there = np.moveaxis(wide, axis, 0)
            there = best(best(there[:-2], there[1:-1]), there[2:])
            wide = np.moveaxis(there, 0, axis)
        whole = wide[: rows * k, : cols * k].reshape(rows, k, cols, k)
        out[..., n] = best.reduce(best.reduce(whole, axis=3), axis=1)
    across = res * (np.arange(k) - 0.5 * (k - 1))  # of each cell from the middle of its square
    inside = z[: rows * k, : cols * k].reshape(rows, k, cols, k).swapaxes(1, 2)
    mean = inside.mean(axis=(2, 3))
    x, y = (np.einsum(f"rcij,{a}->rc", inside, across) / (k * float(across @ across)) for a in "ji")
    plane = mean[..., None, None] + x[..., None, None] * across + y[..., None, None] * across[:, None]
    even = np.abs(inside - plane).max(axis=(2, 3)) < EVEN_BAND
    out[..., 2:] = np.where(even[..., None], np.stack([mean, x, y], axis=-1), np.nan)
    return out


def bare_ground(cloud: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (n,) of a submap (n, 3) [m] are ground: alone in their column, nothing higher in those around it."""
    row, col = np.floor(cloud[:, 1::-1] / COLUMN_SIDE).astype(np.int64).T
    keys, column = np.unique(_key(row, col), return_inverse=True)
    column = column.reshape(-1)
    low, high = np.full(len(keys), np.inf), np.full(len(keys), -np.inf)
    np.minimum.at(low, column, cloud[:, 2])
    np.maximum.at(high, column, cloud[:, 2])
    top = high.copy()
    for beside in _key(*np.mgrid[-1:2, -1:2].reshape(2, -1)):
        key = keys + beside
        at = np.searchsorted(keys, key).clip(max=len(keys) - 1)
        top = np.maximum(top, np.where(keys[at] == key, high[at], -np.inf))
    alone: NDArray[np.bool_] = (high - low < THIN_HEIGHT) & (top - low < LOW_HEIGHT)
    return alone[column]


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
    """(m,) bool: through which surfaces, points (m, 3) with normals (m, 3) found by their voxels, a ray from eyes to
    ends (n, 3) passes."""
    out = np.zeros(len(surfaces), np.bool_)
    for n in range(len(ends)):
        dx, dy, dz = ends[n, 0] - eyes[n, 0], ends[n, 1] - eyes[n, 1], ends[n, 2] - eyes[n, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        if length < 2.0 * RAY_ENDS:
            continue
        dx, dy, dz = dx / length, dy / length, dz / length
        s = RAY_ENDS
        last = np.int64(0)
        while s < length - RAY_ENDS:
            key = voxel_key(eyes[n, 0] + s * dx, eyes[n, 1] + s * dy, eyes[n, 2] + s * dz, voxel)
            s += 0.4 * voxel
            if key == last:
                continue
            last = key
            m = table[find_voxel(key, table, keys)]
            if m == FREE or out[m]:
                continue
            facing = dx * normals[m, 0] + dy * normals[m, 1] + dz * normals[m, 2]
            if abs(facing) < FACING_COSINE:
                continue
            px, py, pz = surfaces[m, 0] - eyes[n, 0], surfaces[m, 1] - eyes[n, 1], surfaces[m, 2] - eyes[n, 2]
            along = (px * normals[m, 0] + py * normals[m, 1] + pz * normals[m, 2]) / facing
            if along < RAY_ENDS or along > length - RAY_ENDS:
                continue
            aside = (px - along * dx) ** 2 + (py - along * dy) ** 2 + (pz - along * dz) ** 2
            out[m] = aside < (0.3 * voxel) ** 2
    return out
