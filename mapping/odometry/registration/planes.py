"""A voxel map of planes: how well a scan fits the local map, and in which directions it fits at all.

Every voxel keeps count, mean and covariance of its points, and the plane through them. KISS-ICP returns only a pose.
The plane residuals at that pose give overlap, residual and the information matrix that registration lacks.

A wall is thinner than a voxel: what is seen of it from behind is another plane, in the voxel's back side."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.kernels import borrows, inlined
from hal.types import Array

TABLE_SLOTS = 1 << 16
"""Slots of the hash table; the map is trimmed when half full."""
SETTLED_POINTS = 60
"""A voxel with this many points is settled and takes no more."""
PLANE_POINTS = 5
"""Points that make a plane."""
EARNED_SCANS = 15.0
"""Scans after which a surface counts in full; before that it counts with the square of their share. A person who
walks past at 0.5 m/s is in a voxel for 8 scans."""
BACK_COSINE = 0.2
"""A ray that meets a plane from behind at more than 12 deg sees another surface. At less the noise of the normal
decides."""
LEVEL_SHARE = 0.01
"""Share of upright surface that is only noise of level ground: level ground tells nothing of where it was seen first.
"""
LOST_SCANS = 0.5
"""Scans that each scan without the surface takes back, until the surface counts in full. A wall is seen in every scan
or every other; a place where people pass is not."""


@borrows
def _slot(keys: NDArray[np.int64], kx: int, ky: int, kz: int) -> int:
    """Index of the voxel or of the free slot for it. Free slots hold -1."""
    key = ((kx + 1048576) << 42) | ((ky + 1048576) << 21) | (kz + 1048576)
    mask = len(keys) - 1
    i = (kx * 73856093 ^ ky * 19349669 ^ kz * 83492791) & mask
    while keys[i] != -1 and keys[i] != key:
        i = (i + 1) & mask
    if keys[i] == -1:
        return -i - 1
    return i


@borrows
def _plane(stats: Array, plane: Array) -> None:
    """Plane of one voxel from its sums: unit normal (3,) towards where it was seen from, and its weight [0..1], 0 if
    there is no plane.

    `stats` (15,): count, sum x y z, sum xx xy xz yy yz zz (relative to the voxel's first point), scans earned, newest
    scan, sum of the unit rays that met it."""
    n = stats[0]
    mx, my, mz = stats[1] / n, stats[2] / n, stats[3] / n
    a, b, c = stats[4] / n - mx * mx, stats[5] / n - mx * my, stats[6] / n - mx * mz
    d, e, f = stats[7] / n - my * my, stats[8] / n - my * mz, stats[9] / n - mz * mz
    # Eigenvalues of a symmetric 3 x 3 matrix in closed form (Smith 1961).
    third = (a + d + f) / 3.0
    a0, d0, f0 = a - third, d - third, f - third
    spread = math.sqrt(max((a0 * a0 + d0 * d0 + f0 * f0 + 2.0 * (b * b + c * c + e * e)) / 6.0, 1e-30))
    det = a0 * (d0 * f0 - e * e) - b * (b * f0 - e * c) + c * (b * e - d0 * c)
    phi = math.acos(min(max(det / (2.0 * spread**3), -1.0), 1.0)) / 3.0
    large = third + 2.0 * spread * math.cos(phi)
    small = third + 2.0 * spread * math.cos(phi + 2.0 * math.pi / 3.0)
    middle = 3.0 * third - large - small
    plane[3] = 0.0
    if middle < 9.0 * max(small, 0.0) or middle < 1e-4:  # a line or a clump
        return
    # Eigenvector: the longest cross product of two rows of (matrix - small I).
    best = 0.0
    a, d, f = a - small, d - small, f - small
    for k in range(3):
        if k == 0:
            x, y, z = b * e - c * d, c * b - a * e, a * d - b * b
        elif k == 1:
            x, y, z = b * f - c * e, c * c - a * f, a * e - b * c
        else:
            x, y, z = d * f - e * e, e * c - b * f, b * e - d * c
        length = math.sqrt(x * x + y * y + z * z)
        if length > best:
            best = length
            plane[0], plane[1], plane[2] = x / length, y / length, z / length
    if best > 0.0:
        plane[3] = (stats[10] / EARNED_SCANS) ** 2
        if plane[0] * stats[12] + plane[1] * stats[13] + plane[2] * stats[14] > 0.0:
            plane[0], plane[1], plane[2] = -plane[0], -plane[1], -plane[2]


@borrows
def _renew(stats: Array, plane: Array) -> None:
    """Fit the plane of a voxel anew, where its points are enough."""
    n = stats[0]
    if n >= PLANE_POINTS:
        _plane(stats, plane)
        for k in range(3):
            plane[5 + k] = stats[1 + k] / n
        plane[4] = 0.0


@inlined
def _behind(plane: Array, s: int, x: float, y: float, z: float) -> bool:
    """Whether a ray (x, y, z) meets the back of the plane of voxel `s`."""
    along = plane[s, 0] * x + plane[s, 1] * y + plane[s, 2] * z
    return along > 0.0 and along * along > BACK_COSINE**2 * (x * x + y * y + z * z)


@njit(cache=True)
def _insert(
    keys: NDArray[np.int64],
    anchor: Array,
    stats: Array,
    plane: Array,
    points: Array,
    pose: Array,
    size: float,
    scan: float,
    earned: float,
    born: float,
) -> int:
    """Add points (n, 3) in the body frame at `pose`, of scan number `scan` that counts as `earned` scans. Returns the
    number of new voxels, which remember `born`.

    The last number of a key is twice the voxel's height, and one more for its back side."""
    new = 0
    for i in range(len(points)):
        rx = pose[0, 0] * points[i, 0] + pose[0, 1] * points[i, 1] + pose[0, 2] * points[i, 2]
        ry = pose[1, 0] * points[i, 0] + pose[1, 1] * points[i, 1] + pose[1, 2] * points[i, 2]
        rz = pose[2, 0] * points[i, 0] + pose[2, 1] * points[i, 1] + pose[2, 2] * points[i, 2]
        x, y, z = rx + pose[0, 3], ry + pose[1, 3], rz + pose[2, 3]
        kx, ky, kz = math.floor(x / size), math.floor(y / size), 2 * math.floor(z / size)
        s = _slot(keys, kx, ky, kz)
        if s >= 0 and plane[s, 3] > 0.0 and _behind(plane, s, rx, ry, rz):
            kz += 1
            s = _slot(keys, kx, ky, kz)
        if s < 0:
            s = -s - 1
            keys[s] = ((kx + 1048576) << 42) | ((ky + 1048576) << 21) | (kz + 1048576)
            anchor[s, 0], anchor[s, 1], anchor[s, 2], anchor[s, 3] = x, y, z, born
            stats[s] = 0.0
            stats[s, 11] = scan
            plane[s, 3] = 0.0
            new += 1
        if stats[s, 11] != scan or stats[s, 10] == 0.0:
            if stats[s, 10] < EARNED_SCANS:
                kept = max(stats[s, 10] - LOST_SCANS * max(scan - stats[s, 11] - 1.0, 0.0), 0.0)
                stats[s, 10] = min(kept + earned, EARNED_SCANS)
                if plane[s, 3] > 0.0:
                    plane[s, 3] = (stats[s, 10] / EARNED_SCANS) ** 2
            stats[s, 11] = scan
        if stats[s, 0] >= SETTLED_POINTS:
            continue
        x, y, z = x - anchor[s, 0], y - anchor[s, 1], z - anchor[s, 2]
        stats[s, 0] += 1.0
        stats[s, 1] += x
        stats[s, 2] += y
        stats[s, 3] += z
        stats[s, 4] += x * x
        stats[s, 5] += x * y
        stats[s, 6] += x * z
        stats[s, 7] += y * y
        stats[s, 8] += y * z
        stats[s, 9] += z * z
        away = math.sqrt(rx * rx + ry * ry + rz * rz) + 1e-9
        stats[s, 12] += rx / away
        stats[s, 13] += ry / away
        stats[s, 14] += rz / away
        plane[s, 4] = 1.0  # stale
    return new


# error_model: no test for zero before each division.
@njit(cache=True, error_model="numpy")
def _fit(
    keys: NDArray[np.int64],
    anchor: Array,
    stats: Array,
    plane: Array,
    points: Array,
    pose: Array,
    size: float,
    gate: float,
    scale: float,
    h: Array,
    b: Array,
) -> tuple[int, int, int, float, float]:
    """Plane residuals of points (n, 3) at `pose`: sums of w J^T J into h (6, 6) and of w J^T r into b (6,).

    J: position in the world, rotation about the body origin in world axes. Geman-McClure weight of width `scale` [m],
    times the weight that the surface has earned. Returns points in seen voxels, points on planes, inliers (|r| <
    gate), the sum of squared inlier residuals, and the mean `born` of the upright surfaces among them."""
    h[:] = 0.0
    b[:] = 0.0
    seen = 0
    planar = 0
    inliers = 0
    total = 0.0
    births = 0.0
    upright = 0.0
    weight = 0.0
    j = np.empty(6)
    # Copies: a compiler that cannot know that the outputs lie elsewhere reads these anew for each point.
    r00, r01, r02, tx = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    r10, r11, r12, ty = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    r20, r21, r22, tz = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    # The tables are larger than the caches. In a loop of their own several slots are on their way from memory at once.
    slot = np.empty(len(points), np.int32)
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = r00 * px + r01 * py + r02 * pz + tx
        y = r10 * px + r11 * py + r12 * pz + ty
        z = r20 * px + r21 * py + r22 * pz + tz
        slot[i] = _slot(keys, math.floor(x / size), math.floor(y / size), 2 * math.floor(z / size))
    for i in range(len(points)):
        s = slot[i]
        if s < 0:
            continue
        seen += 1
        if plane[s, 4] > 0.0:
            _renew(stats[s], plane[s])
        if plane[s, 3] == 0.0:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        rx = r00 * px + r01 * py + r02 * pz
        ry = r10 * px + r11 * py + r12 * pz
        rz = r20 * px + r21 * py + r22 * pz
        x, y, z = rx + tx, ry + ty, rz + tz
        if _behind(plane, s, rx, ry, rz):
            kx, ky, kz = math.floor(x / size), math.floor(y / size), 2 * math.floor(z / size) + 1
            s = _slot(keys, kx, ky, kz)
            if s < 0:
                continue
            if plane[s, 4] > 0.0:
                _renew(stats[s], plane[s])
            if plane[s, 3] == 0.0:
                continue
        planar += 1
        nx, ny, nz = plane[s, 0], plane[s, 1], plane[s, 2]
        r = (
            nx * (x - anchor[s, 0] - plane[s, 5])
            + ny * (y - anchor[s, 1] - plane[s, 6])
            + nz * (z - anchor[s, 2] - plane[s, 7])
        )
        if abs(r) > gate:
            continue
        inliers += 1
        total += r * r
        w = scale * scale / (scale * scale + r * r)
        w *= w * plane[s, 3]
        weight += w
        upright += w * (1.0 - nz * nz)
        births += w * (1.0 - nz * nz) * anchor[s, 3]
        j[0], j[1], j[2] = nx, ny, nz
        j[3], j[4], j[5] = ry * nz - rz * ny, rz * nx - rx * nz, rx * ny - ry * nx
        for k in range(6):
            b[k] += w * j[k] * r
            for m in range(k + 1):
                h[k, m] += w * j[k] * j[m]
    for k in range(6):
        for m in range(k):
            h[m, k] = h[k, m]
    return seen, planar, inliers, total, births / max(upright + LEVEL_SHARE * weight, 1e-12)


@njit(cache=True)
def _trim(
    keys: NDArray[np.int64],
    anchor: Array,
    stats: Array,
    plane: Array,
    size: float,
    centre: Array,
    radius: float,
) -> int:
    """Rebuild the table with the voxels within `radius` [m] of `centre` (3,); returns how many stay."""
    old_keys, old_anchor, old_stats, old_plane = keys.copy(), anchor.copy(), stats.copy(), plane.copy()
    keys[:] = -1
    kept = 0
    for i in range(len(old_keys)):
        if old_keys[i] == -1:
            continue
        d = 0.0
        for k in range(3):
            d += (old_anchor[i, k] - centre[k]) ** 2
        if d > radius * radius:
            continue
        kx = (old_keys[i] >> 42) - 1048576
        ky = ((old_keys[i] >> 21) & 2097151) - 1048576
        kz = (old_keys[i] & 2097151) - 1048576
        s = -_slot(keys, kx, ky, kz) - 1
        keys[s] = old_keys[i]
        for k in range(anchor.shape[1]):
            anchor[s, k] = old_anchor[i, k]
        for k in range(stats.shape[1]):
            stats[s, k] = old_stats[i, k]
        for k in range(plane.shape[1]):
            plane[s, k] = old_plane[i, k]
        kept += 1
    return kept


class VoxelPlanes:
    """Planes of the local map around the robot, in `odom`."""

    def __init__(self, size: float, radius: float) -> None:
        """`size`: voxel edge [m]; voxels further than `radius` [m] are forgotten when space runs short."""
        self.size, self.radius = size, radius
        self._keys = np.full(TABLE_SLOTS, -1, np.int64)
        self._anchor = np.zeros((TABLE_SLOTS, 4))
        """First point [m], and what was said of its birth."""
        self._stats = np.zeros((TABLE_SLOTS, 15))
        self._plane = np.zeros((TABLE_SLOTS, 8))
        """Unit normal, weight, whether points came since, mean of the points relative to the anchor. What a fit reads
        lies together."""
        self._used = 0
        self._scans = 0

    @property
    def empty(self) -> bool:
        """Whether no scan was inserted."""
        return not self._scans

    def insert(self, points: Array, pose: Array, born: float = 0.0, settled: bool = False) -> None:
        """Add points (n, 3) [m] of a scan, body frame, at `pose` (4, 4), whose planar position has the variance
        `born` [m^2].

        Its surfaces have yet to earn their weight, unless they are `settled`."""
        self._scans += 1
        radius = self.radius
        while self._used + len(points) > TABLE_SLOTS // 2 and radius > 1.0:
            self._used = _trim(
                self._keys, self._anchor, self._stats, self._plane, self.size, pose[:3, 3].copy(), radius
            )
            radius *= 0.7
        room = max(TABLE_SLOTS * 3 // 4 - self._used, 0)
        self._used += _insert(
            self._keys, self._anchor, self._stats, self._plane, points[:room], pose, self.size,
            float(self._scans), EARNED_SCANS if settled else 1.0, born,
        )  # fmt: skip

    def fade(self, share: float) -> None:
        """Let inserted points count for this share, at least enough for a plane, so that new points move settled
        surfaces again."""
        n = self._stats[:, 0]
        kept = np.maximum(share * n, np.minimum(n, PLANE_POINTS))
        self._stats[:, 1:10] *= (kept / np.maximum(n, 1.0))[:, None]
        self._stats[:, 0] = kept

    def fit(
        self, points: Array, pose: Array, gate: float, scale: float
    ) -> tuple[Array, Array, int, int, int, float, float]:
        """Information h (6, 6), gradient b (6,), and counts seen, planar, inliers, sum of squared residuals, variance
        at birth; see `_fit`."""
        h, b = np.empty((6, 6)), np.empty(6)
        counts = _fit(
            self._keys, self._anchor, self._stats, self._plane, points, pose, self.size, gate, scale, h, b
        )
        return h, b, *counts
