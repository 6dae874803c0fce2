"""A cloud thinned to one point per voxel, the mean of its points: what a map keeps of walls, ceilings and trees."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.kernels import for_reading

VOXEL_SIDE = 0.25
"""Edge of a voxel [m]."""
POINT_REACH = 25.0
"""Points farther from the robot than this [m] scatter too much."""
MOST_VOXELS = 400_000
"""Voxels at most: 10 MB of memory, 4.8 MB in a file, 25,000 m^2 of surface. What comes later is left out."""
HALF_RANGE = 1 << 20
"""Voxels from the origin that a key can name along an axis: 262 km."""
FREE = -1
"""Of a place in the table of keys: nothing there."""


class ThinCloud:
    """Points in, one mean a voxel out. Same calls, same bytes."""

    def __init__(self, voxel: float = VOXEL_SIDE, limit: int = MOST_VOXELS) -> None:
        self.voxel = voxel
        self._limit = limit
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._used = 0
        self._table = np.full(4096, FREE, np.int64)
        """Index of a voxel, by the hash of its key."""
        self._keys = np.empty(2048, np.int64)
        self._sums = np.zeros((2048, 4))
        """Sum of x, y, z [m], and number of points."""

    def __len__(self) -> int:
        return self._used

    @property
    def points(self) -> NDArray[np.float32]:
        """(n, 3) means [m], in the order in which the voxels were first hit."""
        sums = self._sums[: self._used]
        means: NDArray[np.float32] = (sums[:, :3] / sums[:, 3:]).astype(np.float32)
        return means

    def add(
        self, points: NDArray[np.float32], rotation: NDArray[np.float64], place: NDArray[np.float64]
    ) -> None:
        """Add points (n, 3) of a scan in base_link, at the pose `rotation` (3, 3), `place` (3,) [m]. Points that are
        not finite or farther than `POINT_REACH` are left out."""
        self._take(points, rotation, place, POINT_REACH)

    def enter(self, points: NDArray[np.float32]) -> None:
        """Points (n, 3) of another cloud [m]."""
        self._take(points, np.eye(3), np.zeros(3), np.inf)

    def _take(
        self,
        points: NDArray[np.float32],
        rotation: NDArray[np.float64],
        place: NDArray[np.float64],
        reach: float,
    ) -> None:
        points = for_reading(points)
        begin = 0
        while begin < len(points):
            begin, self._used = add_points(
                points, begin, rotation, place, self.voxel, reach, self._limit,
                self._table, self._keys, self._sums, self._used,
            )  # fmt: skip
            if begin < len(points):
                self._grow()

    def _grow(self) -> None:
        n = 2 * len(self._keys)
        keys, sums = np.empty(n, np.int64), np.zeros((n, 4))
        keys[: self._used], sums[: self._used] = self._keys[: self._used], self._sums[: self._used]
        self._keys, self._sums = keys, sums
        self._table = np.full(2 * n, FREE, np.int64)
        index_keys(self._keys, self._used, self._table)

    @property
    def index(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Table and keys, for `find_voxel`."""
        return self._table, self._keys


@njit(cache=True)
def voxel_key(x, y, z, voxel):  # pragma: no cover - compiled
    """Name of the voxel that holds a point [m]."""
    i = np.int64(np.floor(x / voxel)) + HALF_RANGE
    j = np.int64(np.floor(y / voxel)) + HALF_RANGE
    k = np.int64(np.floor(z / voxel)) + HALF_RANGE
    return (i << 42) | (j << 21) | k


@njit(cache=True)
def find_voxel(key, table, keys):  # pragma: no cover - compiled
    """Place in `table` where `key` stands or belongs: linear probing from a multiplicative hash."""
    mask = len(table) - 1
    at = ((key * np.int64(-7046029254386353131)) >> 20) & mask
    while table[at] != FREE and keys[table[at]] != key:
        at = (at + 1) & mask
    return at


@njit(cache=True)
def index_keys(keys, used, table):  # pragma: no cover - compiled
    """Fill an empty table."""
    for n in range(used):
        table[find_voxel(keys[n], table, keys)] = n


@njit(cache=True)
def add_points(
    points, begin, rotation, place, voxel, reach, limit, table, keys, sums, used
):  # pragma: no cover - compiled
    """See `ThinCloud.add`; returns the first point that found no room, and how many voxels are used."""
    for n in range(begin, len(points)):
        px, py, pz = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        if not px * px + py * py + pz * pz < reach * reach:
            continue
        x = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz + place[0]
        y = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz + place[1]
        z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + place[2]
        key = voxel_key(x, y, z, voxel)
        at = find_voxel(key, table, keys)
        if table[at] == FREE:
            if used >= limit:
                continue
            if used == len(keys):
                return n, used
            table[at] = used
            keys[used] = key
            used += 1
        m = table[at]
        sums[m, 0] += x
        sums[m, 1] += y
        sums[m, 2] += z
        sums[m, 3] += 1.0
    return len(points), used
