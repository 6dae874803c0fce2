"""Grass and bushes: leaves are a volume in which rays stop and through which rays pass. They are no step.

The share of rays that pass through a cell tells a clump neither from a chair nor from a fence. So small voxels around
the robot count the length of rays that passed and the number of rays that stopped, where the map would have a step.
Their quotient is the density of leaves (Beer-Lambert law).

A column is leafy if it has the density of leaves from the ground to its top. Plants begin where discs of 0.3 m are
full of leafy columns without anything solid. A fence and a row of posts are thin in one direction, a post in both.
The legs of a chair stand apart, its seat is one layer, and a box lets no ray through.

    sectors(candidates) -> add(rays of a scan) -> columns -> spread -> cells of the map that are plants"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.elevation.tiles import LIDAR, PLANTS, UNKNOWN
from mapping.elevation.walk import first_cell, next_cell

PLANT_REACH = 2.3
"""[m] around the LiDAR in which plants are looked for."""
TALLEST_PLANT = 0.45
"""[m] above the ground: what is taller is no grass."""
LAYER_HEIGHT, LAYER_COUNT = 0.05, 16
"""Height [m] and number of the voxels of a column. A voxel is as wide as a cell of the map."""
VOLUME_DEPTH = 0.75
"""[m] from the LiDAR down to the lowest voxel."""
FOOT_HEIGHT = 0.05
"""[m] above the ground up to which a ray may have met the ground."""
BLOCK_SIDE = 8
"""Cells of the side of the squares whose lowest ground is compared."""
GROUND_BAND = 0.05
"""[m] above the lowest ground around that is ground, too."""
EVEN_RISE = 0.04
"""[m] that the ground of neighbouring squares may differ by: on slopes and beside kerbs nothing is taken for plants."""
GROUND_CELLS = 12
"""Cells of ground that must be known around."""
LEAF_DENSITY = (1.2, 8.0)
"""Leaves per metre of way [1/m] in a column of plants: less is the scatter behind an edge, more is solid."""
SOLID_DENSITY = 20.0
"""[1/m] from which a voxel is solid: a surface stops all rays on half a voxel."""
LEAST_WAY, LEAST_STOPS = 0.15, 2.0
"""[m] of rays through a voxel, and rays that stopped in it, that tell of it."""
SOLID_STOPS = 4.0
"""Rays that stopped in a voxel that is called solid."""
AT_ONCE = 10.0
"""Stops in a voxel that make it solid if they are too dense for leaves. If one scan brings them, the voxel is solid
for HOLD_TIME: a thing that moves must leave nothing behind that looks like leaves."""
HOLD_TIME = 5000
"""[ms] for which such a voxel is solid."""
EMPTY_SHARE = 0.34
"""Of a column's layers that may be empty, or not known."""
DISC_WIDTH, FILLED_SHARE = 0.3, 0.9
"""Width of a disc [m], and share of its columns that must be leafy where plants begin: a fence is not so wide in
every direction."""
HIGH_SHARE = 0.5
"""Share of such a disc that must be high at all: rays past walls, posts and bars are not counted."""
BORDER_RINGS = 2
"""Cells around such discs that are plants too, if they are neither solid nor empty: the border of a clump does not
follow the cells."""
HALVING_WAY = 5.0
"""[m] of way in a voxel from which on old rays count half: a box that was put there shows within a second."""
SECTOR_COUNT = 128
MOTION_MARGIN = 0.2
"""[m] that the robot moves at most between two looks."""
EMPTY, LEAFY, HARD, LOOSE = 0, 1, 2, 3
"""Of a column: nothing known, or no leaves; leaves; something solid; a few leaves."""


class Rays(NamedTuple):
    """Where rays of a scan count: nearest and farthest [m] from the LiDAR, by sector (SECTOR_COUNT,), and the highest
    [m] in `map`."""

    near: NDArray[np.float64]
    far: NDArray[np.float64]
    top: float


class PlantVolume:
    """Voxels around the LiDAR, on the lattice of the map. They wrap around: voxel (i, j, k) lies at [i & mask, j &
    mask, k & 15]."""

    def __init__(self, resolution: float) -> None:
        self.resolution = resolution
        self.reach = int(PLANT_REACH / resolution)
        """Cells."""
        n = 1 << (2 * self.reach + 2 * math.ceil(MOTION_MARGIN / resolution)).bit_length()
        self._shape = n, n, LAYER_COUNT
        self.rays: Rays | None = None
        """None where nothing is high: rays are not looked at."""
        self._made = False

    def warm_up(self) -> None:
        """Compile (or load) every kernel; what was counted is forgotten."""
        height = np.zeros((16, 16), np.float32)
        height[8:, 8:] = 0.3
        source = np.full(height.shape, LIDAR, np.uint8)
        sensor = np.array([0.0, 0.0, 0.5])
        for _ in range(2):
            self.look(height, source + np.uint8(1), source, (0, 0), sensor, 0.1, 3, 0)
            self.add(np.full((2, 3), 0.4, np.float32), 2, sensor, 0)
        self.rays = None

    def _make(self) -> None:
        """Memory is taken when something high is met first."""
        if not self._made:
            self.way, self.stops = np.zeros(self._shape, np.float32), np.zeros(self._shape, np.float32)
            self.until = np.zeros(self._shape, np.int32)
            self._way, self._stops = np.zeros(self._shape, np.float32), np.zeros(self._shape, np.float32)
            self._met = np.empty(self.way.size, np.int32)
            self._made = True
        self.forget()

    def forget(self) -> None:
        """Count anew."""
        self._corner: tuple[int, int, int] | None = None

    def centre(self, sensor: NDArray[np.float64]) -> None:
        """Move the voxels with the LiDAR at `sensor` (3,) [m] in `map`; those left behind start from zero on the
        other side."""
        n = self._shape[0]
        row, col = (math.floor(v / self.resolution + 0.5) - n // 2 for v in (sensor[1], sensor[0]))
        layer = math.floor((sensor[2] - VOLUME_DEPTH) / LAYER_HEIGHT)
        was = self._corner
        if was is not None and abs(layer - was[2]) < 2:
            layer = was[2]  # a body that bobs
        self._corner = here = row, col, layer
        for axis, (size, new) in enumerate(zip(self._shape, here, strict=True)):
            moved = size if was is None else min(size, abs(new - was[axis]))
            first = new + size - moved if was is None or new > was[axis] else new
            gone = (np.arange(first, first + moved)) % size
            if moved:
                at = (slice(None),) * axis + (gone,)
                for counts in (self.way, self.stops, self.until):
                    counts[at] = 0
            if was is None:
                break

    def add(self, ends: NDArray[np.float32], n: int, sensor: NDArray[np.float64], now: int) -> None:
        """Count the rays from `sensor` (3,) to `ends[:n]` [m] in `map` of one scan at `now` [ms]."""
        if self.rays is None:
            return
        self.centre(sensor)
        assert self._corner is not None
        add_rays(
            ends, n, sensor, *self.rays, self.resolution, *self._corner, now,
            self.way, self.stops, self.until, self._way, self._stops, self._met,
        )  # fmt: skip

    def look(
        self,
        height: NDArray[np.float32],
        count: NDArray[np.uint8],
        source: NDArray[np.uint8],
        corner: tuple[int, int],
        sensor: NDArray[np.float64],
        above: float,
        settled: int,
        now: int,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]] | None:
        """Which cells (rows, cols) from lattice row and column `corner` on hold plants: LEAFY, or HARD where
        something solid stands; their ground and the top of the leaves [m]. None if nothing is higher than `above`
        [m].

        height, count, source: of the cells, see `tiles.CELL`. `settled`: points of an established cell."""
        ground, high, found = high_cells(height, count, source, above, settled)
        radius = 0.5 * DISC_WIDTH / self.resolution
        if found == 0 or not drop_thin(high, source, radius, HIGH_SHARE):
            self.rays = None
            return None
        if self.rays is None:
            self._make()
            self.centre(sensor)
        assert self._corner is not None
        near, far, top = sectors_of(high, ground, *corner, sensor, self.resolution)
        self.rays = Rays(near, far, float(top))
        state, tops = columns(high, ground, *corner, self._corner[2], now, self.way, self.stops, self.until)
        return spread(state, radius, FILLED_SHARE), ground, tops


@njit(cache=True)
def high_cells(height, count, source, above, settled):  # pragma: no cover - compiled
    """Ground around each cell (rows, cols) [m]; which cells are higher by `above` to TALLEST_PLANT or were called
    plants; their number.

    The ground is the mean of what lies within GROUND_BAND of the lowest cell in the surrounding squares of BLOCK_SIDE
    cells. It is NaN where little is known or squares differ."""
    rows, cols = height.shape
    nr, nc = (rows + BLOCK_SIDE - 1) // BLOCK_SIDE, (cols + BLOCK_SIDE - 1) // BLOCK_SIDE
    least = np.full((nr + 2, nc + 2), np.inf, np.float32)
    most = np.float32(-np.inf)
    lowest = np.float32(np.inf)
    plants = 0
    for r in range(rows):
        for c in range(cols):
            h = height[r, c]
            if source[r, c] == UNKNOWN or (source[r, c] == LIDAR and count[r, c] < settled):
                continue
            b = least[1 + r // BLOCK_SIDE, 1 + c // BLOCK_SIDE]
            least[1 + r // BLOCK_SIDE, 1 + c // BLOCK_SIDE] = h if h < b else b
            most = h if h > most else most
            lowest = h if h < lowest else lowest
            plants += source[r, c] == PLANTS
    ground = np.empty((rows, cols), np.float32)
    high = np.zeros((rows, cols), np.bool_)
    if not most - lowest > above and plants == 0:
        return ground, high, 0
    around = np.full((nr + 2, nc + 2), np.inf, np.float32)
    for r in range(1, nr + 1):
        for c in range(1, nc + 1):
            around[r, c] = least[r - 1 : r + 2, c - 1 : c + 2].min()
    total = np.zeros((nr + 2, nc + 2))
    cells = np.zeros((nr + 2, nc + 2), np.int32)
    for r in range(rows):
        for c in range(cols):
            if source[r, c] == UNKNOWN or (source[r, c] == LIDAR and count[r, c] < settled):
                continue
            a, b = 1 + r // BLOCK_SIDE, 1 + c // BLOCK_SIDE
            # of the squares around, those whose ground it is
            for i in range(a - 1, a + 2):
                for j in range(b - 1, b + 2):
                    if height[r, c] < around[i, j] + np.float32(GROUND_BAND):
                        total[i, j] += height[r, c]
                        cells[i, j] += 1
    level = np.full((nr + 2, nc + 2), np.nan, np.float32)
    for a in range(1, nr + 1):
        for b in range(1, nc + 1):
            if cells[a, b] >= GROUND_CELLS:
                level[a, b] = total[a, b] / cells[a, b]
    found = 0
    for r in range(rows):
        for c in range(cols):
            a, b = 1 + r // BLOCK_SIDE, 1 + c // BLOCK_SIDE
            g = level[a, b]
            ground[r, c] = g
            if source[r, c] == PLANTS:
                ground[r, c] = height[r, c]
                high[r, c] = True
            elif source[r, c] == LIDAR and g + above < height[r, c] < g + TALLEST_PLANT:
                even = True
                for i in range(a - 1, a + 2):
                    for j in range(b - 1, b + 2):
                        even &= not abs(level[i, j] - g) > EVEN_RISE
                high[r, c] = even
            found += high[r, c]
    return ground, high, found


@njit(cache=True)
def in_discs(mask, radius, share):  # pragma: no cover - compiled
    """Cells of `mask` (rows, cols) that lie in a disc of `radius` cells with at least `share` of its cells in the
    mask, and whether there are any."""
    rows, cols = mask.shape
    out = np.zeros((rows, cols), np.bool_)
    reach = int(radius)
    wide = np.empty(2 * reach + 1, np.int64)  # half the width of the disc in each of its rows
    need = 0.0
    for a in range(-reach, reach + 1):
        wide[a + reach] = int(math.sqrt(radius * radius - a * a))
        need += share * (2 * wide[a + reach] + 1)
    before = np.zeros((rows, cols + 1), np.int32)  # cells of the mask before each one of a row
    for r in range(rows):
        for c in range(cols):
            before[r, c + 1] = before[r, c] + mask[r, c]
    found = False
    for r in range(reach, rows - reach):
        if before[r, cols] == 0:
            continue
        for c in range(reach, cols - reach):
            n = 0
            for a in range(-reach, reach + 1):
                w = wide[a + reach]
                n += before[r + a, c + w + 1] - before[r + a, c - w]
            if n >= need:
                found = True
                for a in range(-reach, reach + 1):
                    w = wide[a + reach]
                    for b in range(c - w, c + w + 1):
                        out[r + a, b] |= mask[r + a, b]
    return out, found


@njit(cache=True)
def drop_thin(high, source, radius, share):  # pragma: no cover - compiled
    """Clear the cells of `high` (rows, cols) that lie in no disc of `radius` cells with a share `share` of high
    cells. Cells called plants stay. Returns whether one is left."""
    broad, left = in_discs(high, radius, share)
    for r in range(high.shape[0]):
        for c in range(high.shape[1]):
            plants = source[r, c] == PLANTS
            high[r, c] = plants or broad[r, c]
            left |= plants
    return left


@njit(cache=True)
def sector(dx, dy):  # pragma: no cover - compiled
    """Of a direction in the plane: sectors are as wide as 1.8 to 3.6 deg, and take no trigonometry."""
    a = dy / (abs(dx) + abs(dy))
    return math.floor((a if dx >= 0.0 else 2.0 - a) * (SECTOR_COUNT // 4)) % SECTOR_COUNT


@njit(cache=True)
def sectors_of(high, ground, row, col, sensor, resolution):  # pragma: no cover - compiled
    """See `Rays`: `high` cells (rows, cols) from lattice `row` and `col` on, seen from `sensor` (3,) [m]."""
    near, far = np.full(SECTOR_COUNT, np.inf), np.zeros(SECTOR_COUNT)
    top = -np.inf
    for r in range(high.shape[0]):
        for c in range(high.shape[1]):
            if not high[r, c]:
                continue
            dx, dy = (col + c) * resolution - sensor[0], (row + r) * resolution - sensor[1]
            away = math.sqrt(dx * dx + dy * dy)
            if away < 2.0 * resolution:
                continue
            top = max(top, ground[r, c] + TALLEST_PLANT + LAYER_HEIGHT)
            # as wide as the cell, and as far as the robot moves until the next look
            wide = 1 + math.ceil((resolution + 0.25 * MOTION_MARGIN) / away * SECTOR_COUNT / 4.0)
            at = sector(dx, dy)
            for k in range(at - wide, at + wide + 1):
                k %= SECTOR_COUNT
                near[k] = min(near[k], away - MOTION_MARGIN)
                far[k] = max(far[k], away + MOTION_MARGIN)
    return near, far, top


@njit(cache=True)
def add_rays(
    ends, m, sensor, near, far, top, resolution, row, col, layer, now, way, stops, until, way_now, stops_now, met
):  # fmt: skip  # pragma: no cover - compiled
    """See `PlantVolume.add`. Voxels from (row, col, layer) on; way_now, stops_now: zeros, of the shape of `way`; met:
    scratch, one for each voxel."""
    n, _, layers = way.shape
    mask, up = n - 1, layers - 1
    inv, thick = 1.0 / resolution, 1.0 / LAYER_HEIGHT
    flat_way, flat_stops, flat_until = way.ravel(), stops.ravel(), until.ravel()
    new_way, new_stops = way_now.ravel(), stops_now.ravel()
    k = 0
    for p in range(m):
        dx, dy = ends[p, 0] - sensor[0], ends[p, 1] - sensor[1]
        away = math.sqrt(dx * dx + dy * dy)
        if not resolution < away < 1e6:
            continue
        s = sector(dx, dy)
        at = max(near[s], 0.0)
        if not at < min(far[s], away):
            continue
        slope = (ends[p, 2] - sensor[2]) / away
        if sensor[2] + slope * at > top:
            if slope >= 0.0:
                continue
            at = (top - sensor[2]) / slope
        end = min(far[s], away)
        if not at < end:
            continue
        longer = math.sqrt(1.0 + slope * slope)
        ux, uy = dx / away, dy / away
        # lattice coordinates in which cell k spans [k, k+1)
        x, y = (sensor[0] + ux * at) * inv + 0.5, (sensor[1] + uy * at) * inv + 0.5
        gap_i = resolution / abs(uy) if uy != 0.0 else np.inf
        gap_j = resolution / abs(ux) if ux != 0.0 else np.inf
        i, j, next_i, next_j = first_cell(x, y, ux, uy, at, resolution)
        while at < end:
            leave = min(next_i, next_j, end)
            z = math.floor((sensor[2] + slope * 0.5 * (at + leave)) * thick)
            if 0 <= i - row < n and 0 <= j - col < n and 0 <= z - layer < layers:
                v = (((i & mask) * n) + (j & mask)) * layers + (z & up)
                if new_way[v] == 0.0 and new_stops[v] == 0.0:
                    met[k] = v
                    k += 1
                new_way[v] += (leave - at) * longer
            at = leave
            i, j, next_i, next_j = next_cell(i, j, next_i, next_j, ux, uy, gap_i, gap_j)
        if away <= far[s]:
            j = math.floor(ends[p, 0] * inv + 0.5)
            i = math.floor(ends[p, 1] * inv + 0.5)
            z = math.floor(ends[p, 2] * thick)
            if 0 <= i - row < n and 0 <= j - col < n and 0 <= z - layer < layers:
                v = (((i & mask) * n) + (j & mask)) * layers + (z & up)
                if new_way[v] == 0.0 and new_stops[v] == 0.0:
                    met[k] = v
                    k += 1
                new_stops[v] += 1.0
    for v in met[:k]:
        if new_stops[v] >= AT_ONCE and new_stops[v] > SOLID_DENSITY * new_way[v]:
            flat_until[v] = now + HOLD_TIME
            flat_way[v] = flat_stops[v] = 0.0
        else:
            flat_way[v] += new_way[v]
            flat_stops[v] += new_stops[v]
            if flat_way[v] > HALVING_WAY:
                flat_way[v] *= np.float32(0.5)
                flat_stops[v] *= np.float32(0.5)
        new_way[v] = new_stops[v] = 0.0


@njit(cache=True)
def columns(high, ground, row, col, layer, now, way, stops, until):  # pragma: no cover - compiled
    """What stands on each `high` cell (rows, cols) uint8, and the top of it [m]; see `PlantVolume.look`."""
    n, _, layers = way.shape
    mask, up = n - 1, layers - 1
    state = np.zeros(high.shape, np.uint8)
    tops = np.full(high.shape, np.nan, np.float32)
    for r in range(high.shape[0]):
        for c in range(high.shape[1]):
            if not high[r, c]:
                continue
            i, j = (row + r) & mask, (col + c) & mask
            first = max(layer, math.floor((ground[r, c] + FOOT_HEIGHT) / LAYER_HEIGHT + 0.5))
            last = min(layer + layers - 1, math.floor((ground[r, c] + TALLEST_PLANT) / LAYER_HEIGHT))
            top = first - 1
            hard = False
            for k in range(first, last + 1):
                s, w = stops[i, j, k & up], way[i, j, k & up]
                top = k if s >= LEAST_STOPS else top
                hard |= until[i, j, k & up] > now or (s >= SOLID_STOPS and s > SOLID_DENSITY * w)
                hard |= s >= AT_ONCE and s > LEAF_DENSITY[1] * w
            leafy = empty = unknown = 0
            dense = False
            for k in range(first, top + 1):
                s, w = stops[i, j, k & up], way[i, j, k & up]
                dense |= s >= SOLID_STOPS and s > LEAF_DENSITY[1] * w
                if w < LEAST_WAY:
                    unknown += 1
                elif s < LEAST_STOPS or s < LEAF_DENSITY[0] * w:
                    empty += 1
                elif s <= LEAF_DENSITY[1] * w:
                    leafy += 1
            every = top + 1 - first
            if hard:
                state[r, c] = HARD
            elif leafy >= 2 and empty <= EMPTY_SHARE * every and unknown <= EMPTY_SHARE * every:
                state[r, c] = LEAFY
            elif every > 0 and not dense and empty + unknown < every:
                state[r, c] = LOOSE
            tops[r, c] = (top + 1) * LAYER_HEIGHT
    return state, tops


@njit(cache=True)
def spread(state, radius, filled):  # pragma: no cover - compiled
    """Keep LEAFY in `state` (rows, cols) only in discs of `radius` cells of which the share `filled` is leafy, and in
    BORDER_RINGS around them where something loose stands. HARD stays, the rest becomes EMPTY."""
    rows, cols = state.shape
    inside, _ = in_discs(state == LEAFY, radius, filled)
    out = np.zeros((rows, cols), np.uint8)
    for r in range(rows):
        for c in range(cols):
            if state[r, c] == HARD:
                out[r, c] = HARD
            elif inside[r, c]:
                out[r, c] = LEAFY
    for _ in range(BORDER_RINGS):
        was = out.copy()
        for r in range(1, rows - 1):
            for c in range(1, cols - 1):
                if was[r, c] == EMPTY and (state[r, c] == LEAFY or state[r, c] == LOOSE):
                    for a in range(r - 1, r + 2):
                        for b in range(c - 1, c + 2):
                            if was[a, b] == LEAFY:
                                out[r, c] = LEAFY
    return out
