"""The corrected graph as a function of the map, in four steps: flags, nodes, edges, describe.

Everything is kept per cell (`Cells`), so that the work and the memory of an update depend on what changed and on the
size of the map, never on how many updates came before. A part that is computed again is exactly what a full build
gives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.blind import assume_blind
from planning.graph.cells import NEIGHBOUR_OFFSETS, Cells
from planning.graph.describe import UNKNOWN_RUN, describe_nodes
from planning.graph.edge_price import TRACK_BEYOND
from planning.graph.edge_risk import F32
from planning.graph.edges import CORRIDOR_MARGIN, SECTION_LENGTH, connect
from planning.graph.faces import update_faces
from planning.graph.fields import mark_fields, reach
from planning.graph.flags import PLANTS, TIP, halo, update_flags
from planning.graph.nodes import CLEAR_LEVELS, place_nodes
from planning.graph.params import GraphParams, Window, merge_windows
from planning.graph.prices import prices_of
from planning.graph.reachable import Built, reachable

EDGE_REACH = 2.0
"""Longest edge, in lattice cells: expand_dist + robot_size, the native bound. Long edges keep narrow passages
connected."""
SAMPLE_COUNT = 512
"""As many as node ids tell apart; the next one is the first again."""
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Lattice:
    """Nodes and edges of all terrain in the map, reachable or not."""

    def __init__(self, params: GraphParams, seed: int, first_xy: tuple[float, float]) -> None:
        self.params = params
        self.seed = seed
        self.first = first_xy
        self.cells = Cells(0.5 * (params.expand_dist + params.robot_size))
        self.side = self.cells.side
        self.prices = prices_of(params)

    def refresh(self, grid: ElevationGrid, changed: Sequence[Window]) -> bool:
        """Compute again what depends on the changed windows or on new extent; False if there was nothing to do."""
        windows = [*self.cells.fit(grid), *changed]
        if not windows:
            return False
        boxes = self._flags(grid, windows)
        moved = self._nodes(boxes)
        self._edges(grid, boxes, moved)
        self._describe(grid, boxes, moved)
        return True

    def redraw(self, grid: ElevationGrid, boxes: Array, sample: int) -> None:
        """Nodes from another sample, and their edges, in the lattice cells that `boxes` touch (k, 4: x0, y0, x1, y1
        [m])."""
        for box in boxes:
            self.cells.drawn[self.cells.within(box, 0.0)] = sample % SAMPLE_COUNT
        moved, unchanged = self._nodes(boxes), np.empty((0, 4))
        self._edges(grid, unchanged, moved)
        self._describe(grid, unchanged, moved)

    def reachable(self, grid: ElevationGrid, start: tuple[float, float], before: NDArray[np.int64]) -> Built:
        """See `planning.graph.reachable`: within the longest straight move from `start`."""
        return reachable(self.cells, grid, start, EDGE_REACH * self.cells.side, before)

    def _flags(self, grid: ElevationGrid, windows: Sequence[Window]) -> Array:
        """Step 1: what is a face, what was not seen. -> (k, 4) boxes x0, y0, x1, y1 [m] in which flags may have
        changed."""
        p, cells, (rows, cols) = self.params, self.cells, grid.shape
        pad = halo(cells.res, p.max_gap)
        virtual = np.zeros(grid.shape, np.bool_) if grid.virtual is None else grid.virtual
        touched: list[Window] = []
        for r0, c0, r1, c1 in merge_windows(windows, pad + 8):
            grown = (max(0, r0 - pad), max(0, c0 - pad), min(rows, r1 + pad), min(cols, c1 + pad))
            update_flags(
                cells.flags,
                grid.height,
                grid.trusted,
                virtual,
                cells.res,
                grown,
                p.max_step,
                p.max_slope,
                p.max_gap,
                p.keep_step,
            )
            update_faces(cells.faces, grid.height, grid.trusted, cells.res, *grown)
            if p.max_posts is not None:
                wide = pad + reach(cells.res)
                grown = (max(0, r0 - wide), max(0, c0 - wide), min(rows, r1 + wide), min(cols, c1 + wide))
                mark_fields(cells.flags, cells.faces, grid.trusted, cells.res, grown, p.max_posts)
            here = np.s_[grown[0] : grown[2], grown[1] : grown[3]]
            for mask, flag in ((grid.plants, PLANTS), (grid.holes, TIP)):
                if mask is not None:
                    cells.flags[here] |= np.where(mask[here], np.uint16(flag), np.uint16(0))
            touched.append(grown)
        assumed = assume_blind(cells.flags, *cells.origin, cells.res, *self.first, p.blind_radius)
        if assumed[0] < assumed[2]:
            touched.append(assumed)
        (x0, y0), res = cells.origin, cells.res
        return np.array(
            [(x0 + c0 * res, y0 + r0 * res, x0 + c1 * res, y0 + r1 * res) for r0, c0, r1, c1 in touched]
        )

    def _nodes(self, boxes: Array) -> Mask:
        """Step 2: one node in each lattice cell near `boxes`. -> (ny, nx) where the node is not what it was."""
        p, cells = self.params, self.cells
        before = (cells.chosen.copy(), cells.where.copy())
        todo = np.zeros(cells.chosen.shape, dtype=np.bool_)
        for box in boxes:
            js, is_ = cells.within(box, max(CLEAR_LEVELS[0], p.robot_size) + 2.0 * cells.res)
            todo[:] = False
            todo[js, is_] = True
            place_nodes(
                cells.flags, *cells.origin, cells.res, *cells.corner, self.side, self.seed, cells.drawn, p.sample_num,
                todo, 0.5 * p.width, p.min_coverage, cells.chosen, cells.where,
            )  # fmt: skip
        return (before[0] != cells.chosen) | (before[1] != cells.where).any(axis=2)

    def _edges(self, grid: ElevationGrid, boxes: Array, moved: Mask) -> None:
        """Step 3: test every edge with a moved end or near `boxes`."""
        p, cells = self.params, self.cells
        xs, ys = _axes(grid)
        rank = math.ceil((EDGE_REACH * self.side + p.length + 2.0 * CORRIDOR_MARGIN) / SECTION_LENGTH) + 2
        connect(
            grid.height, cells.flags, cells.faces, xs, ys, *cells.origin, cells.res, cells.chosen, cells.where,
            NEIGHBOUR_OFFSETS, EDGE_REACH * self.side, moved, boxes, self._beside, rank, p.length, p.width,
            math.tan(p.max_slope), p.max_gap, p.min_coverage, F32(p.robot_size), self.prices, cells.risk, cells.price,
        )  # fmt: skip

    def _describe(self, grid: ElevationGrid, boxes: Array, moved: Mask) -> None:
        """Step 4: what else is known at a node: frontier, headings that fit, edges under the wheels in a turn."""
        p, cells = self.params, self.cells
        todo, near = moved.copy(), moved.copy()
        ring = 0.5 * p.length + p.expand_dist
        for box in boxes:
            todo[cells.within(box, ring + UNKNOWN_RUN + 2.0 * cells.res)] = True
            near[cells.within(box, self._around)] = True
        describe_nodes(
            grid.height, grid.trusted, cells.flags, cells.faces, *cells.origin, cells.res, cells.chosen, cells.where,
            todo, near, ring, p.length, p.width, cells.frontier, cells.headings, cells.turn_price, self.prices,
            p.climbed,
        )  # fmt: skip

    @property
    def _around(self) -> float:
        """[m] from a node within which terrain matters to it."""
        p = self.params
        return max(0.5 * math.hypot(p.length, p.width) + 2.0 * CORRIDOR_MARGIN, p.robot_size) + self.cells.res

    @property
    def _beside(self) -> float:
        """[m] from an edge's end within which terrain matters to it: the wheels' tracks are looked at before and after
        it."""
        p = self.params
        return max(self._around, math.hypot(p.axle + TRACK_BEYOND, p.tread) + self.cells.res)


def _axes(grid: ElevationGrid) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """x of the columns and y of the rows [m]."""
    rows, cols = grid.shape
    xs = (grid.origin[0] + np.arange(cols) * grid.resolution).astype(np.float32)
    return xs, (grid.origin[1] + np.arange(rows) * grid.resolution).astype(np.float32)
