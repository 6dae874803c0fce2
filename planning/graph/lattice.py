"""The corrected graph as a function of the map: lattice nodes, corridor edges, and their local recomputation.

Everything here is kept per lattice cell, so that the work and the memory of an update depend on what changed and on
the size of the map, never on how many updates came before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.errors import PlanningError
from planning.graph.blind import grant_blind
from planning.graph.describe import UNKNOWN_RUN, describe_nodes, in_sight
from planning.graph.edges import MARGIN, SECTION, connect
from planning.graph.flags import halo, update_flags
from planning.graph.nodes import CLEAR_LEVELS, place_nodes
from planning.graph.params import GraphParams, Window, merge_windows
from planning.graph.risk import F32, nearest_height, window_minmax

OFFSETS = np.array([(0, 1), (0, 2)] + [(j, i) for j in (1, 2) for i in range(-2, 3)], dtype=np.int64)
"""(12, 2) row and column steps to the lattice neighbours an edge may lead to, each pair once."""
REACH = 2.0
"""Longest edge, in lattice cells: expand_dist + robot_size, the native bound. Long edges keep narrow passages connected."""


class Built(NamedTuple):
    """What the lattice publishes: the part of the graph that the robot can reach."""

    nodes: NDArray[np.float64]
    edges: NDArray[np.int64]
    risk: NDArray[np.float32]
    frontier: NDArray[np.bool_]
    turn_edge: NDArray[np.float32]
    free_headings: NDArray[np.uint64]
    ids: NDArray[np.int64]
    node_revision: NDArray[np.int64]
    edge_revision: NDArray[np.int64]


@njit(cache=True)
def components(n, edges):
    """(n,) int64: the lowest node index of each node's connected component."""
    parent = np.arange(n)
    for e in range(len(edges)):
        a = edges[e, 0]
        b = edges[e, 1]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a < b:
            parent[b] = a
        else:
            parent[a] = b
    for v in range(n):
        a = v
        while parent[a] != a:
            a = parent[a]
        parent[v] = a
    return parent


class Lattice:
    """Nodes and edges of all terrain in the map, reachable or not."""

    def __init__(self, params: GraphParams, seed: int, start_xy: tuple[float, float]) -> None:
        self.params = params
        self.seed = seed
        self.start = start_xy
        self.side = 0.5 * (params.expand_dist + params.robot_size)
        self.origin = (0.0, 0.0)
        self.res = 0.0
        self.shape = (0, 0)
        self.corner = (0, 0)
        self._allocate((0, 0), (0, 0))

    def _allocate(self, shape: tuple[int, int], cells: tuple[int, int]) -> None:
        ny, nx = cells
        self.flags = np.zeros(shape, dtype=np.uint8)
        self.chosen = np.full((ny, nx), -1, dtype=np.int8)
        self.where = np.zeros((ny, nx, 2))
        self.turn_edge = np.zeros((ny, nx), dtype=np.float32)
        self.frontier = np.zeros((ny, nx), dtype=np.bool_)
        self.headings = np.zeros((ny, nx), dtype=np.uint64)
        self.node_revision = np.zeros((ny, nx), dtype=np.int32)
        self.risk = np.full((ny, nx, len(OFFSETS)), -1.0, dtype=np.float32)
        self.edge_revision = np.zeros((ny, nx, len(OFFSETS)), dtype=np.int32)

    def _fit(self, grid: ElevationGrid) -> list[Window]:
        """Take the extent of `grid`, keep what overlaps; -> windows of `grid` that were not in the map before."""
        if grid.shape == self.shape and grid.origin == self.origin and grid.resolution == self.res:
            return []
        rows, cols = grid.shape
        x0, y0, x1, y1 = grid.extent
        corner = (math.floor(x0 / self.side), math.floor(y0 / self.side))
        cells = (math.floor(y1 / self.side) - corner[1] + 1, math.floor(x1 / self.side) - corner[0] + 1)
        old = self.__dict__.copy()
        self.origin, self.res, self.shape, self.corner = grid.origin, grid.resolution, grid.shape, corner
        self._allocate(grid.shape, cells)
        if old["res"] == 0.0:
            return [(0, 0, rows, cols)]
        shift_x = (old["origin"][0] - x0) / self.res
        shift_y = (old["origin"][1] - y0) / self.res
        dc, dr = round(shift_x), round(shift_y)
        if abs(old["res"] - self.res) > 1e-9 or abs(shift_x - dc) > 0.01 or abs(shift_y - dr) > 0.01:
            raise PlanningError(
                "the map's cells moved: an updated grid must keep the resolution and align its cells"
            )
        ra, ca = max(0, dr), max(0, dc)
        rb, cb = min(rows, dr + old["shape"][0]), min(cols, dc + old["shape"][1])
        if ra >= rb or ca >= cb:
            return [(0, 0, rows, cols)]
        self.flags[ra:rb, ca:cb] = old["flags"][ra - dr : rb - dr, ca - dc : cb - dc]
        di, dj = old["corner"][0] - corner[0], old["corner"][1] - corner[1]
        ja, ia = max(0, dj), max(0, di)
        jb, ib = min(cells[0], dj + old["chosen"].shape[0]), min(cells[1], di + old["chosen"].shape[1])
        for name in (
            "chosen",
            "where",
            "turn_edge",
            "frontier",
            "headings",
            "node_revision",
            "risk",
            "edge_revision",
        ):
            getattr(self, name)[ja:jb, ia:ib] = old[name][ja - dj : jb - dj, ia - di : ib - di]
        # The map's border counts like unseen ground, so a border that moved is a change even where nothing was added.
        new = [(0, 0, ra, cols), (rb, 0, rows, cols), (ra, 0, rb, ca), (ra, cb, rb, cols)]
        lost = [(0, 0, 1, cols)] * (dr < 0) + [(rows - 1, 0, rows, cols)] * (dr + old["shape"][0] > rows)
        lost += [(0, 0, rows, 1)] * (dc < 0) + [(0, cols - 1, rows, cols)] * (dc + old["shape"][1] > cols)
        return [w for w in new if w[0] < w[2] and w[1] < w[3]] + lost

    def refresh(self, grid: ElevationGrid, changed: Sequence[Window], version: int) -> bool:
        """Recompute what depends on the changed windows or on new extent; False if there was nothing to do."""
        p = self.params
        windows = merge_windows([*self._fit(grid), *changed], halo(grid.resolution, p.max_gap) + 8)
        if not windows:
            return False
        res, (x0, y0) = self.res, self.origin
        rows, cols = self.shape
        pad = halo(res, p.max_gap)
        xs = (x0 + np.arange(cols) * res).astype(np.float32)
        ys = (y0 + np.arange(rows) * res).astype(np.float32)
        k = math.floor(p.robot_size / res + 0.5) + 1
        touched: list[Window] = []
        for r0, c0, r1, c1 in windows:
            grown = (max(0, r0 - pad), max(0, c0 - pad), min(rows, r1 + pad), min(cols, c1 + pad))
            update_flags(
                self.flags, grid.height, grid.trusted, res, grown, p.max_step, p.max_slope, p.max_gap
            )
            touched.append(grown)
        granted = grant_blind(self.flags, x0, y0, res, *self.start, p.blind_radius)
        if granted[0] < granted[2]:
            touched.append(granted)
        boxes = np.array(
            [(x0 + c0 * res, y0 + r0 * res, x0 + c1 * res, y0 + r1 * res) for r0, c0, r1, c1 in touched]
        )
        before = (self.chosen.copy(), self.where.copy())
        todo = np.zeros(self.chosen.shape, dtype=np.bool_)
        for box in boxes:
            j0, i0, j1, i1 = self._cells(box, max(CLEAR_LEVELS[0], p.robot_size) + 2.0 * res)
            todo[:] = False
            todo[j0:j1, i0:i1] = True
            ra = max(0, math.floor(((self.corner[1] + j0) * self.side - y0) / res) - 2 * k)
            rb = min(rows, math.ceil(((self.corner[1] + j1) * self.side - y0) / res) + 2 * k)
            ca = max(0, math.floor(((self.corner[0] + i0) * self.side - x0) / res) - 2 * k)
            cb = min(cols, math.ceil(((self.corner[0] + i1) * self.side - x0) / res) + 2 * k)
            low, high = window_minmax(np.ascontiguousarray(grid.height[ra:rb, ca:cb]), k)
            place_nodes(
                grid.height, self.flags, xs, ys, x0, y0, res, low, high, k, ra, ca,
                *self.corner, self.side, self.seed, p.sample_num, todo, F32(p.robot_size), F32(p.height_threshold),
                F32(p.collision_threshold), 0.5 * p.width, p.min_coverage,
                self.chosen, self.where,
            )  # fmt: skip
        moved = (before[0] != self.chosen) | (before[1] != self.where).any(axis=2)
        around = max(0.5 * math.hypot(p.length, p.width) + 2.0 * MARGIN, p.robot_size) + res
        rank = math.ceil((REACH * self.side + p.length + 2.0 * MARGIN) / SECTION) + 2
        connect(
            grid.height, self.flags, xs, ys, x0, y0, res, self.chosen, self.where, OFFSETS, REACH * self.side, moved,
            boxes, around, rank, p.length, p.width, math.tan(p.max_slope), p.max_gap, p.min_coverage,
            F32(p.robot_size), self.risk, self.edge_revision, version,
        )  # fmt: skip
        todo[:] = moved
        ring = 0.5 * p.length + p.expand_dist
        for box in boxes:
            j0, i0, j1, i1 = self._cells(box, ring + UNKNOWN_RUN + 2.0 * res)
            todo[j0:j1, i0:i1] = True
            j0, i0, j1, i1 = self._cells(box, around)
            self.node_revision[j0:j1, i0:i1] = version
        self.node_revision[moved] = version
        describe_nodes(
            grid.height, grid.trusted, self.flags, x0, y0, res, self.chosen, self.where, todo, ring,
            p.length, p.width, self.frontier, self.headings, self.turn_edge,
        )  # fmt: skip
        return True

    def _cells(self, box: NDArray[np.float64], margin: float) -> Window:
        """Lattice rows and columns that a box in metres touches when grown by `margin`."""
        ny, nx = self.chosen.shape
        i0 = math.floor((box[0] - margin) / self.side) - self.corner[0]
        j0 = math.floor((box[1] - margin) / self.side) - self.corner[1]
        i1 = math.floor((box[2] + margin) / self.side) - self.corner[0] + 1
        j1 = math.floor((box[3] + margin) / self.side) - self.corner[1] + 1
        return max(0, j0), max(0, i0), min(ny, max(j1, 0)), min(nx, max(i1, 0))

    def reachable(
        self, grid: ElevationGrid, start: tuple[float, float], snap: float, before: NDArray[np.int64]
    ) -> Built:
        """The component at `start`, or, where no node is in reach of it, the one with most of the ids in `before`."""
        j, i = np.nonzero(self.chosen >= 0)
        index = np.full(self.chosen.shape, -1, dtype=np.int64)
        index[j, i] = np.arange(len(j))
        ej, ei, eo = np.nonzero(self.risk >= 0.0)
        edges = np.stack([index[ej, ei], index[ej + OFFSETS[eo, 0], ei + OFFSETS[eo, 1]]], axis=1)
        xy = self.where[j, i]
        ids = (
            ((j + self.corner[1] + (1 << 23)) << 30)
            | ((i + self.corner[0] + (1 << 23)) << 6)
            | self.chosen[j, i]
        )
        label = components(len(j), edges)
        x0, y0 = self.origin
        near = np.flatnonzero(in_sight(self.flags, x0, y0, self.res, *start, xy, snap))
        roots = label[near] if len(near) else label[np.isin(ids, before)]
        size = np.bincount(label, minlength=1) if len(near) else np.bincount(roots, minlength=1)
        keep = label == (roots[np.argmax(size[roots])] if len(roots) else -1)
        new = np.cumsum(keep) - 1
        kept = keep[edges[:, 0]]
        nodes = np.empty((int(keep.sum()), 3))
        nodes[:, :2] = xy[keep]
        nearest_height(grid.height, x0, y0, self.res, nodes)
        return Built(
            nodes,
            new[edges[kept]],
            self.risk[ej, ei, eo][kept],
            self.frontier[j, i][keep],
            self.turn_edge[j, i][keep],
            self.headings[j, i][keep],
            ids[keep],
            self.node_revision[j, i][keep].astype(np.int64),
            self.edge_revision[ej, ei, eo][kept].astype(np.int64),
        )
