"""Search over x, y, yaw and ground level: branch and bound over a map pooled coarse to fine (Hess et al., ICRA 2016).

A node is a window of places, one heading and one level. Its bound is the score of the submap on the map pooled over
that window. It is searched only while its bound may still give a place worth a closer look. Of places near each other
the best is kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hal.rotation import wrap
from hal.types import Array
from mapping.grid import ElevationGrid
from mapping.relocalise.columns import SLICE_COUNT, SLICE_HEIGHT, matched, occupy, pool, settle

CELL_SIDE = 0.125
"""Distance of the places that are tried [m]."""
MOST_CELLS = 2_000_000
"""Of the pooled maps at most, 16 MB each: the cells of a larger map are larger."""
LEVEL_COUNT = 6
"""Pooled maps: windows of 1 to 32 cells."""
KEEP_SHARE = 0.75
"""Places that match this share of what the best one does are looked at."""
LEAST_SHARE = 0.3
"""Share of the submap that a place matches at least."""
BIN_SIZE = (0.5, math.radians(15.0))
"""Size of the bins [m], [rad] of which one place is kept."""
STAND_NEAR = 3
"""Cells around known ground where the robot may stand too: a box that stood there while the map was made has gone."""
HEADING_STEP = 0.25
"""What a wrong heading moves the far part of a submap by at most, from one to the next [m]."""
BASE_DEPTH = 2.0
"""The slices begin this far below the lowest ground [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """A map as the search sees it."""

    origin: tuple[float, float]
    """x, y [m] of the centre of cell [0, 0]."""
    base: float
    """Lower end of the first slice [m]."""
    cell: float
    occupied: tuple[NDArray[np.uint64], ...]
    """(rows, cols) each, what stands there, pooled over 1, 2, 4, ... cells."""
    ground: tuple[NDArray[np.uint64], ...]
    """The same for levels on which the robot may stand."""

    @staticmethod
    def of(cloud: NDArray[np.float32], ground: Sequence[ElevationGrid]) -> Columns:
        """From the cloud (n, 3) [m] of a map and its known ground, block by block."""
        known = [block for block in ground if block.trusted.any()]
        corners = [cloud[:, :2].astype(np.float64), *map(_corners, known)] if known else [np.zeros((1, 2))]
        both = np.concatenate(corners)
        low, high = both.min(axis=0), both.max(axis=0)
        cell = CELL_SIDE
        while np.prod((high - low) / cell + 3) > MOST_CELLS:
            cell *= 2.0
        x0, y0 = low - cell
        cols, rows = (int(n) for n in np.ceil((high - low) / cell) + 3)
        base = min((float(block.height[block.trusted].min()) for block in known), default=0.0) - BASE_DEPTH
        occupied = np.zeros((rows, cols), np.uint64)
        occupy(np.asarray(cloud, np.float64), x0, y0, base, cell, occupied)
        places = np.zeros((rows, cols), np.uint64)
        for block in known:
            settle(block.height, block.trusted, *block.origin, block.resolution, x0, y0, base, cell, places)
        for axis in (0, 1):
            places = _spread(places, axis, STAND_NEAR)
        pooled = [occupied], [places]
        for fine in pooled:
            for k in range(LEVEL_COUNT - 1):
                fine.append(pool(fine[-1], 1 << k))
        return Columns((float(x0), float(y0)), base, cell, tuple(pooled[0]), tuple(pooled[1]))


def _corners(ground: ElevationGrid) -> NDArray[np.float64]:
    """(2, 2) lowest and highest x, y of the middles of the trusted cells [m]."""
    lines = np.flatnonzero(ground.trusted.any(axis=0)), np.flatnonzero(ground.trusted.any(axis=1))
    return np.stack(
        [start + line[[0, -1]] * ground.resolution for start, line in zip(ground.origin, lines, strict=True)],
        axis=1,
    )


def _spread(words: NDArray[np.uint64], axis: int, cells: int) -> NDArray[np.uint64]:
    """OR with the cells up to `cells` away along an axis."""
    out = words.copy()
    there = np.moveaxis(out, axis, 0)
    here = np.moveaxis(words, axis, 0)
    for k in range(1, cells + 1):
        there[k:] |= here[:-k]
        there[:-k] |= here[k:]
    return out


@dataclass(frozen=True, slots=True)
class Place:
    """A place where the submap may lie: x, y, z of the ground under the robot [m], yaw [rad], in `map`."""

    x: float
    y: float
    z: float
    yaw: float
    share: float
    """Of the submap that the map has there [0..1]."""


def find_places(
    columns: Columns,
    structure: NDArray[np.float64],
    near: tuple[float, float, float] | None = None,
    radius: float = 1.5,
    turn: float = math.radians(30.0),
    count: int = 12,
) -> list[Place]:
    """Places of a submap, best first, at most `count`.

    structure (n, 3) [m]: what stands above the ground, relative to the ground under the robot, z along gravity. near:
    x, y, yaw; only places within `radius` [m] and `turn` [rad] of it are tried."""
    if len(structure) == 0:
        return []
    xy, words = as_columns(structure)
    bits = int(sum(int(word).bit_count() for word in words))
    far = max(2.0, float(np.percentile(np.hypot(xy[:, 0], xy[:, 1]), 90)))
    turns = math.ceil(2.0 * math.pi * far / HEADING_STEP)
    yaws: Array = np.linspace(0.0, 2.0 * math.pi, turns, endpoint=False)
    window = np.array([0, 0, *columns.ground[0].shape], np.int64)
    if near is not None:
        yaws = yaws[np.abs(wrap(yaws - near[2])) <= turn]
        row, col = ((near[1 - k] - columns.origin[1 - k]) / columns.cell for k in (0, 1))
        n = radius / columns.cell
        window = np.array([row - n, col - n, row + n + 1, col + n + 1], np.int64)
        window = np.clip(window, 0, [*columns.ground[0].shape] * 2)
    offsets = np.empty((len(yaws), len(xy), 2), np.int32)
    for k, yaw in enumerate(yaws):
        c, s = math.cos(yaw), math.sin(yaw)
        offsets[k, :, 0] = np.rint((s * xy[:, 0] + c * xy[:, 1]) / columns.cell)
        offsets[k, :, 1] = np.rint((c * xy[:, 0] - s * xy[:, 1]) / columns.cell)
    per_bin = max(1, round(BIN_SIZE[0] / columns.cell))
    turn_bins = max(1, round(BIN_SIZE[1] / (2.0 * math.pi / turns)))
    rows, cols = columns.ground[0].shape
    bins = np.zeros((-(-len(yaws) // turn_bins), -(-rows // per_bin), -(-cols // per_bin)), np.int32)
    best = np.empty((*bins.shape, 4), np.int32)
    found = branch_and_bound(
        columns.occupied, columns.ground, offsets, words, window, int(LEAST_SHARE * bits), KEEP_SHARE, per_bin,
        turn_bins, bins, best
    )  # fmt: skip
    keep = np.argwhere(bins >= max(1, int(KEEP_SHARE * found)))
    keep = keep[np.argsort(-bins[tuple(keep.T)], kind="stable")]
    places: list[Place] = []
    for at in keep:
        k, row, col, level = (int(v) for v in best[tuple(at)])
        place = Place(
            columns.origin[0] + col * columns.cell,
            columns.origin[1] + row * columns.cell,
            columns.base + level * SLICE_HEIGHT,
            float(wrap(yaws[k])),
            float(bins[tuple(at)] / bits),
        )
        if not any(same(place, other) for other in places):
            places.append(place)
        if len(places) == count:
            break
    return places


def same(a: Place, b: Place) -> bool:
    """Whether two places are one, found twice."""
    near = math.hypot(a.x - b.x, a.y - b.y) < BIN_SIZE[0] and abs(a.z - b.z) < 1.0
    return near and abs(wrap(a.yaw - b.yaw)) < BIN_SIZE[1]


def as_columns(structure: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.uint64]]:
    """Points (n, 3) [m] as columns of half a voxel: mean x, y (m, 2), and the filled slices (m,) as words; see
    `matched`."""
    key = np.floor(structure[:, :2] / (2.0 * CELL_SIDE)).astype(np.int64)
    _, column = np.unique(key, axis=0, return_inverse=True)
    column = column.reshape(-1)
    level = np.floor(structure[:, 2] / SLICE_HEIGHT).astype(np.int64) + SLICE_COUNT // 2
    inside = (level >= 0) & (level < SLICE_COUNT)
    words = np.zeros(int(column.max()) + 1, np.uint64)
    np.bitwise_or.at(words, column[inside], np.uint64(1) << level[inside].astype(np.uint64))
    count = np.bincount(column)
    xy = np.column_stack([np.bincount(column, structure[:, k]) / count for k in (0, 1)])
    return xy[words > 0], words[words > 0]


@njit(cache=True)
def branch_and_bound(
    occupied, ground, offsets, words, window, least, keep, per_bin, turn_bins, bins, best
):  # pragma: no cover - compiled
    """Fill `bins` (turns, rows, cols) with the best score of each bin and `best` (..., 4) with its heading, row,
    column and level, where the score is at least `least` and `keep` of the best one. Returns the best score.

    occupied, ground: pooled maps, see `Columns`. offsets (headings, n, 2), words (n,): the submap. window: rows and
    columns from, to."""
    top = len(occupied) - 1
    wide = np.int64(1) << top
    # all windows of the coarsest map, one heading and one level each
    count = 0
    for _ in range(2):
        if count:
            roots = np.empty((count, 5), np.int32)
        n = 0
        for row in range(window[0], window[2], wide):
            for col in range(window[1], window[3], wide):
                levels = ground[top][row, col]
                for level in range(64):
                    if (levels >> np.uint64(level)) & np.uint64(1):
                        for k in range(len(offsets)):
                            if count:
                                roots[n, 0], roots[n, 1], roots[n, 2], roots[n, 3] = k, row, col, level
                                roots[n, 4] = matched(occupied[top], wide, row, col, level, offsets[k], words)
                            n += 1
        if n == 0:
            return 0
        count = n
    order = np.argsort(-roots[:, 4])
    found = 0
    stack = np.empty((4 * (top + 1), 4), np.int64)  # height, row, col, bound
    for n in order:
        k, lift = roots[n, 0], np.int64(roots[n, 3])
        if roots[n, 4] < max(least, keep * found):
            break
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = top, roots[n, 1], roots[n, 2], roots[n, 4]
        size = 1
        while size:
            size -= 1
            height, row, col, bound = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
            if bound < max(least, keep * found):
                continue
            if height == 0:
                a, b, c = k // turn_bins, row // per_bin, col // per_bin
                if bound > bins[a, b, c]:
                    bins[a, b, c] = bound
                    best[a, b, c, 0], best[a, b, c, 1], best[a, b, c, 2], best[a, b, c, 3] = (
                        k,
                        row,
                        col,
                        lift,
                    )
                found = max(found, bound)
                continue
            half = np.int64(1) << (height - 1)
            first = size
            for i in range(2):
                for j in range(2):
                    r, c = row + i * half, col + j * half
                    if r >= window[2] or c >= window[3]:
                        continue
                    if not (ground[height - 1][r, c] >> np.uint64(lift)) & np.uint64(1):
                        continue
                    score = matched(occupied[height - 1], half, r, c, lift, offsets[k], words)
                    # the most promising child comes last: it is taken first
                    at = size
                    size += 1
                    while at > first and stack[at - 1, 3] > score:
                        for part in range(4):  # a row at once compiles for 2 s
                            stack[at, part] = stack[at - 1, part]
                        at -= 1
                    stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3] = height - 1, r, c, score
    return found
