"""What the lattice keeps per cell, fixed to the ground while the map grows or shrinks around it."""

from __future__ import annotations

import copy
import math

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.errors import PlanningError
from planning.graph.params import Window

NEIGHBOUR_OFFSETS = np.array(
    [(0, 1), (0, 2)] + [(j, i) for j in (1, 2) for i in range(-2, 3)], dtype=np.int64
)
"""(12, 2) row and column steps to the lattice neighbours an edge may lead to, each pair once."""


class Cells:
    """Flags of every map cell; node and edges of every lattice cell, squares of `side` [m] fixed to the ground.

    Attributes:
        flags: (rows, cols) uint16 of the map's cells, see `planning.graph.flags`.
        faces: (rows, cols, 2) int16 rise along x and y [mm], see `planning.graph.faces`.
        drawn: (ny, nx) int16 which of the samples the candidates of a lattice cell are from; 0 until others are drawn
        there (`Lattice.redraw`).
        chosen: (ny, nx) int8 number of the candidate that is the node of a lattice cell, -1 = none.
        where: (ny, nx, 2) x, y of the node [m].
        frontier, headings: (ny, nx) as in `TraversalGraph`; turn_price: (ny, nx, 2).
        risk: (ny, nx, 12) float32 native risk of the edge to each of `NEIGHBOUR_OFFSETS`, -1 = no edge.
        price: (ny, nx, 12, 2, 2) float32 [m] what crossing it costs: there and back, driven forward and backward.
    """

    _PER_LATTICE_CELL = (
        "drawn",
        "chosen",
        "where",
        "turn_price",
        "frontier",
        "headings",
        "risk",
        "price",
    )

    def __init__(self, side: float) -> None:
        self.side = side
        self.origin = (0.0, 0.0)
        self.res = 0.0
        self.shape = (0, 0)
        self.corner = (0, 0)
        """Lattice cell [0, 0]: its number in x and in y, counted from the origin of the map frame."""
        self._allocate((0, 0), (0, 0))

    def _allocate(self, shape: tuple[int, int], cells: tuple[int, int]) -> None:
        ny, nx = cells
        self.flags = np.zeros(shape, dtype=np.uint16)
        self.faces = np.zeros((*shape, 2), dtype=np.int16)
        self.drawn = np.zeros((ny, nx), dtype=np.int16)
        self.chosen = np.full((ny, nx), -1, dtype=np.int8)
        self.where = np.zeros((ny, nx, 2))
        self.turn_price = np.zeros((ny, nx, 2), dtype=np.float32)
        self.frontier = np.zeros((ny, nx), dtype=np.bool_)
        self.headings = np.zeros((ny, nx), dtype=np.uint64)
        self.risk = np.full((ny, nx, len(NEIGHBOUR_OFFSETS)), -1.0, dtype=np.float32)
        self.price = np.zeros((ny, nx, len(NEIGHBOUR_OFFSETS), 2, 2), dtype=np.float32)

    def copy(self) -> Cells:
        """Cells of their own that hold the same."""
        out = copy.copy(self)
        for name in ("flags", "faces", *self._PER_LATTICE_CELL):
            setattr(out, name, getattr(self, name).copy())
        return out

    def fit(self, grid: ElevationGrid) -> list[Window]:
        """Take the extent of `grid`, keep what overlaps; -> windows of `grid` that were not in the map before.

        Raises PlanningError where the grid's cells are not those of before.
        """
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
        for name in ("flags", "faces"):
            getattr(self, name)[ra:rb, ca:cb] = old[name][ra - dr : rb - dr, ca - dc : cb - dc]
        di, dj = old["corner"][0] - corner[0], old["corner"][1] - corner[1]
        ja, ia = max(0, dj), max(0, di)
        jb, ib = min(cells[0], dj + old["chosen"].shape[0]), min(cells[1], di + old["chosen"].shape[1])
        for name in self._PER_LATTICE_CELL:
            getattr(self, name)[ja:jb, ia:ib] = old[name][ja - dj : jb - dj, ia - di : ib - di]
        # The map's border counts like unseen ground, so a border that moved is a change even where nothing was added.
        new = [(0, 0, ra, cols), (rb, 0, rows, cols), (ra, 0, rb, ca), (ra, cb, rb, cols)]
        lost = [(0, 0, 1, cols)] * (dr < 0) + [(rows - 1, 0, rows, cols)] * (dr + old["shape"][0] > rows)
        lost += [(0, 0, rows, 1)] * (dc < 0) + [(0, cols - 1, rows, cols)] * (dc + old["shape"][1] > cols)
        return [w for w in new if w[0] < w[2] and w[1] < w[3]] + lost

    def within(self, box: NDArray[np.float64], margin: float) -> tuple[slice, slice]:
        """Lattice rows and columns that a box x0, y0, x1, y1 [m] touches when grown by `margin` [m]."""
        ny, nx = self.chosen.shape
        i0 = math.floor((box[0] - margin) / self.side) - self.corner[0]
        j0 = math.floor((box[1] - margin) / self.side) - self.corner[1]
        i1 = math.floor((box[2] + margin) / self.side) - self.corner[0] + 1
        j1 = math.floor((box[3] + margin) / self.side) - self.corner[1] + 1
        return slice(max(0, j0), min(ny, max(j1, 0))), slice(max(0, i0), min(nx, max(i1, 0)))

    def ids(self, j: NDArray[np.int64], i: NDArray[np.int64]) -> NDArray[np.int64]:
        """Of the nodes in lattice cells j, i: the same place, sample and candidate have the same id in every map."""
        at = (
            (self.drawn[j, i].astype(np.int64) << 54)
            | ((j + self.corner[1] + (1 << 23)) << 30)
            | ((i + self.corner[0] + (1 << 23)) << 6)
        )
        return at | self.chosen[j, i]
