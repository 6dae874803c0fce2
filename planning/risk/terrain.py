"""The elevation grid made ready for footprint samples: filled, padded, with what lets whole tiles of samples be
skipped."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from mapping.filling import fill_unknown
from mapping.grid import ElevationGrid

TILE_SIDE = 3
"""Samples along a side of a tile: measured fastest at 0.02 m, equal to 4 at 0.05 m."""
NONE, ALL, SOME = 0, 1, 2
"""How much of the ground under a tile is trusted."""


Floats = NDArray[np.float32]


class Sampler(NamedTuple):
    """Terrain and footprint samples as the kernels take them."""

    height: NDArray[np.float32]
    """(rows * stride,) [m], padded."""
    pair: NDArray[np.uint64]
    """(rows * stride - 1,) the heights of a cell and its right neighbour in one number: half the loads."""
    trusted: NDArray[np.uint8]
    """(rows * stride,) 1 = trusted; 0 in the padding."""
    seen: NDArray[np.int32]
    """(rows + 1, stride + 1) trusted cells above and left of a cell corner (summed-area table)."""
    ceiling: NDArray[np.float32]
    """(rows * stride,) no sample of a tile centred in a cell is higher [m]."""
    known: NDArray[np.uint8]
    """(rows * stride,) NONE, ALL or SOME of the cells under a tile centred in a cell are trusted."""
    stride: int
    """Columns of the padded grid."""
    ox: float
    oy: float
    inv: float
    """1 / resolution [1/m]."""
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    """(n,) samples along and across the body [cells]: corners FL, FR, BL, BR, then the rest tile by tile."""
    corner: int
    """Samples per corner."""
    corner_u: NDArray[np.float32]
    corner_v: NDArray[np.float32]
    """(4,) corner centres [cells]."""
    corner_window: int
    """Cells around a corner's centre, in both directions, that hold all its samples."""
    tile: NDArray[np.int32]
    """(t + 1,) where each tile's samples begin."""
    tile_u: NDArray[np.float32]
    tile_v: NDArray[np.float32]
    """(t,) tile centres [cells]."""
    reach: int
    """Cells from the body's centre that no sample leaves."""
    width: float
    """Body width [m]."""


class Changed(NamedTuple):
    """Cells of a terrain that are not what they were."""

    row: int
    col: int
    """The first."""
    cells: NDArray[np.bool_]
    """(rows, cols) from there on."""


NO_CHANGE = Changed(0, 0, np.zeros((0, 0), np.bool_))


@dataclass(slots=True, eq=False)
class Terrain:
    """An elevation grid made ready for footprint samples: filled, padded with untrusted edge values."""

    grid: ElevationGrid
    height: NDArray[np.float32]
    """(rows, cols) [m], no NaN."""
    trusted: NDArray[np.uint8]
    """(rows, cols) 1 = trusted; 0 in the padding."""
    seen: NDArray[np.int32]
    """(rows + 1, cols + 1) summed-area table of `trusted`."""
    origin: tuple[float, float]
    """x, y [m] of the centre of padded cell [0, 0]."""
    resolution: float
    """Cell size [m]."""
    pad: int
    """Cells of padding on each side."""
    _samplers: dict[tuple[float, float], Sampler] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def from_grid(cls, grid: ElevationGrid, margin: float) -> Terrain:
        """Pad by a little more than twice `margin` [m], the footprint's circumradius.

        A body within `margin` of the grid then lies inside the padding whole, and one farther out touches no
        trusted cell: no sample ever needs a bounds check.
        """
        pad = 2 * int(np.ceil(margin / grid.resolution)) + 3
        known = np.isfinite(grid.height)
        filled = grid.height if known.all() else fill_unknown(grid.height)
        height, padded, seen = _pad(filled, grid.trusted & known, pad)
        step = pad * grid.resolution
        x, y = grid.origin
        return cls(grid, height, padded, seen, (x - step, y - step), grid.resolution, pad)

    def follow(self, grid: ElevationGrid) -> Changed | None:
        """Become the terrain of a grid that came after this one's, of the same cells: what was made for it is brought
        up to date where it has changed. -> where; None, and nothing done, where the cells are others."""
        was = self.grid
        if grid is was:
            return NO_CHANGE
        if (grid.shape, grid.origin, grid.resolution) != (was.shape, was.origin, was.resolution):
            return None
        pad, cols, stride = self.pad, grid.shape[1], self.height.shape[1]
        known, old = (
            grid.trusted.reshape(-1).view(np.uint8),
            (self.height.reshape(-1), self.trusted.reshape(-1)),
        )
        filled = grid.height
        (r0, c0, r1, c1), cells = changed_cells(filled.reshape(-1), known, cols, *old, stride, pad, pad)
        if not np.isfinite(filled[r0:r1, c0:c1]).all():  # elsewhere it is what this one has
            filled = fill_unknown(grid.height)
            (r0, c0, r1, c1), cells = changed_cells(filled.reshape(-1), known, cols, *old, stride, pad, pad)
        self.grid = grid
        if cells.size:
            box = _patch(self.height, self.trusted, self.seen, filled, grid.trusted, pad, r0, c0, r1, c1)
            for (length, width), sampler in self._samplers.items():
                self._remake(sampler, _samples(length, width, self.resolution).window, *box)
        return Changed(r0 + pad, c0 + pad, cells)

    def _remake(self, sampler: Sampler, window: int, r0: int, c0: int, r1: int, c1: int) -> None:
        """Make ceilings and what is known again where heights and trust have changed in a box of cells."""
        rows, cols = self.height.shape
        r0, c0, r1, c1 = (
            max(r0 - 2 * window, 0),
            max(c0 - 2 * window, 0),
            min(r1 + 2 * window, rows),
            min(c1 + 2 * window, cols),
        )
        inner = np.s_[r0 + window : r1 - window, c0 + window : c1 - window]
        part = np.s_[window : r1 - r0 - window, window : c1 - c0 - window]
        sampler.ceiling.reshape(rows, cols)[inner] = _dilate(self.height[r0:r1, c0:c1], window)[part]
        seen = np.ascontiguousarray(self.seen[r0 : r1 + 1, c0 : c1 + 1])
        sampler.known.reshape(rows, cols)[inner] = _known(seen, window)[part]

    def sampler(self, length: float, width: float) -> Sampler:
        """Kernel arguments for a body of this length and width [m]; made once."""
        if (length, width) not in self._samplers:
            self._samplers[length, width] = self._sample(length, width)
        return self._samplers[length, width]

    def places(self, length: float, width: float) -> tuple[Floats, Floats]:
        """`Sampler.u` and `Sampler.v` of a body, without the rest of its sampler, which takes far longer to make."""
        u, v, *_ = _samples(length, width, self.resolution).parts
        return u, v

    def _sample(self, length: float, width: float) -> Sampler:
        samples = _samples(length, width, self.resolution)
        return Sampler(
            self.height.reshape(-1),
            _pairs(self.height),
            self.trusted.reshape(-1),
            self.seen,
            _dilate(self.height, samples.window).reshape(-1),
            _known(self.seen, samples.window).reshape(-1),
            self.height.shape[1],
            self.origin[0],
            self.origin[1],
            1.0 / self.resolution,
            *samples.parts,
            int(np.ceil(0.5 * np.hypot(length, width) / self.resolution)) + 1,
            width,
        )


class _Samples(NamedTuple):
    """Samples of a body, the same on every terrain."""

    window: int
    """Cells around a tile's centre, in both directions, that hold all its samples."""
    parts: tuple[Floats, Floats, int, Floats, Floats, int, NDArray[np.int32], Floats, Floats]
    """From `Sampler.u` to `Sampler.tile_v`."""


@cache
def _samples(length: float, width: float, resolution: float) -> _Samples:
    along = offsets(length, resolution) / resolution
    across = offsets(width, resolution) / resolution
    u, v = (a.ravel() for a in np.meshgrid(along, across, indexing="ij"))
    limit_u, limit_v = along[-1] / 2 - 1e-6, across[-1] / 2 - 1e-6
    band = (np.abs(u) >= limit_u) & (np.abs(v) >= limit_v)
    tiles_across = -(-len(across) // TILE_SIDE)
    row, col = np.divmod(np.arange(len(u)), len(across))
    # Samples in the order of their part: corners FL, FR, BL, BR are 0..3, tiles of the rest follow.
    part = np.where(band, 2 * (u < 0) + (v < 0), 4 + row // TILE_SIDE * tiles_across + col // TILE_SIDE)
    order = np.argsort(part, kind="stable")
    u, v, part = u[order], v[order], part[order]
    starts = np.append(np.flatnonzero(np.diff(part, prepend=-1)), len(part))
    size = np.diff(starts)
    centre_u, centre_v = (np.add.reduceat(a, starts[:-1]) / size for a in (u, v))
    away = np.hypot(u - np.repeat(centre_u, size), v - np.repeat(centre_v, size))
    corner = int(size[0])
    # A sample reads cells less than one cell away, its part's centre lies within half a cell of a cell centre.
    corner_window = int(np.floor(away[: 4 * corner].max() + 1.5))
    parts = (
        u.astype(np.float32),
        v.astype(np.float32),
        corner,
        centre_u[:4].astype(np.float32),
        centre_v[:4].astype(np.float32),
        corner_window,
        starts[4:].astype(np.int32),
        centre_u[4:].astype(np.float32),
        centre_v[4:].astype(np.float32),
    )
    return _Samples(int(np.floor(away[4 * corner :].max(initial=0.0) + 1.5)), parts)


def offsets(side: float, resolution: float) -> NDArray[np.float64]:
    """Evenly spaced sample offsets over one side of the body, both ends in: ceil(side / resolution) + 1 of them."""
    # The small slack keeps a side that is a whole number of cells from gaining a sample by float rounding.
    return np.linspace(-side / 2, side / 2, int(np.ceil(side / resolution - 1e-9)) + 1)


def _pairs(height: NDArray[np.float32]) -> NDArray[np.uint64]:
    """View of every two neighbouring heights as one number: eight bytes, beginning every four."""
    flat = height.reshape(-1)
    return np.ndarray((flat.size - 1,), np.uint64, flat.data, strides=(4,))


def _dilate(height: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Largest value within `window` cells in both directions."""
    out: NDArray[np.float32] = ndimage.maximum_filter(height, 2 * window + 1)
    return out


@njit(cache=True)
def _known(seen: np.ndarray, window: int) -> np.ndarray:
    """NONE, ALL or SOME: trusted cells within `window` in both directions; NONE in a border of that width."""
    rows, cols = seen.shape[0] - 1, seen.shape[1] - 1
    out = np.zeros((rows, cols), np.uint8)
    full = (2 * window + 1) ** 2
    for r in range(window, rows - window):
        top, bottom = seen[r - window], seen[r + window + 1]
        for c in range(window, cols - window):
            a, b = c - window, c + window + 1
            n = bottom[b] - bottom[a] - top[b] + top[a]
            out[r, c] = (n > 0) + (0 < n < full)
    return out


@njit(cache=True)
def _pad(height: np.ndarray, trusted: np.ndarray, pad: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows, cols = height.shape
    n, m = rows + 2 * pad, cols + 2 * pad
    out = np.empty((n, m), np.float32)
    ok = np.zeros((n, m), np.uint8)
    seen = np.zeros((n + 1, m + 1), np.int32)
    for r in range(n):
        src = min(max(r - pad, 0), rows - 1)
        for c in range(m):
            out[r, c] = height[src, min(max(c - pad, 0), cols - 1)]
        if r == src + pad:
            for c in range(cols):
                ok[r, pad + c] = trusted[src, c]
        total = 0
        for c in range(m):
            total += ok[r, c]
            seen[r + 1, c + 1] = seen[r, c + 1] + total
    return out, ok, seen


@njit(cache=True)
def changed_cells(
    height: np.ndarray,
    trusted: np.ndarray,
    stride: int,
    old_height: np.ndarray,
    old_trusted: np.ndarray,
    old_stride: int,
    dr: int,
    dc: int,
) -> tuple[tuple[int, int, int, int], np.ndarray]:
    """Where cells are not what they were: the box around them, first row, first column, row and column after the last,
    and which of them in it; dr, dc: cell [0, 0] in the old."""
    rows, old_rows = height.size // stride, old_height.size // old_stride
    r0, c0, r1, c1 = rows, stride, 0, 0
    for r in range(rows):
        first, last, a = stride, -1, r + dr
        # The columns that both have, without a branch.
        begin, end = max(0, -dc), min(stride, old_stride - dc)
        if not 0 <= a < old_rows or end <= begin:
            first, last = 0, stride - 1
        else:
            i, j = r * stride, a * old_stride + dc
            here, there = height[i + begin : i + end], old_height[j + begin : j + end]
            known, knew = trusted[i + begin : i + end], old_trusted[j + begin : j + end]
            differ = 0
            for c in range(here.size):
                differ += (here[c] != there[c]) | (known[c] != knew[c])
            if differ > 0:
                for c in range(here.size):
                    if here[c] != there[c] or known[c] != knew[c]:
                        first, last = min(first, c + begin), c + begin
            if begin > 0:
                first, last = 0, max(last, begin - 1)
            if end < stride:
                first, last = min(first, end), stride - 1
        if last >= 0:
            r0, r1, c0, c1 = min(r0, r), r + 1, min(c0, first), max(c1, last + 1)
    cells = np.zeros((max(r1 - r0, 0), max(c1 - c0, 0)), np.bool_)
    for r in range(r0, r1):
        for c in range(c0, c1):
            a, b = r + dr, c + dc
            same = False
            if 0 <= a < old_rows and 0 <= b < old_stride:
                i, j = r * stride + c, a * old_stride + b
                same = height[i] == old_height[j] and trusted[i] == old_trusted[j]
            cells[r - r0, c - c0] = not same
    return (r0, c0, r1, c1), cells


@njit(cache=True)
def _patch(
    height: np.ndarray,
    trusted: np.ndarray,
    seen: np.ndarray,
    filled: np.ndarray,
    known: np.ndarray,
    pad: int,
    r0: int,
    c0: int,
    r1: int,
    c1: int,
) -> tuple[int, int, int, int]:
    """Bring what `_pad` makes up to date where cells of a box have changed: rows r0 to before r1, columns c0 to before
    c1. -> the box of padded cells."""
    rows, cols = filled.shape
    n, m = height.shape
    a, b = (0 if r0 == 0 else r0 + pad), (n if r1 == rows else r1 + pad)
    d, e = (0 if c0 == 0 else c0 + pad), (m if c1 == cols else c1 + pad)
    differ = False
    for r in range(a, b):
        src = min(max(r - pad, 0), rows - 1)
        for c in range(d, e):
            height[r, c] = filled[src, min(max(c - pad, 0), cols - 1)]
    for r in range(r0, r1):
        for c in range(c0, c1):
            differ |= trusted[pad + r, pad + c] != known[r, c]
            trusted[pad + r, pad + c] = known[r, c]
    if differ:
        for r in range(r0 + pad, n):
            total = seen[r + 1, c0 + pad] - seen[r, c0 + pad]
            for c in range(c0 + pad, m):
                total += trusted[r, c]
                seen[r + 1, c + 1] = seen[r, c + 1] + total
    return a, d, b, e


@njit(cache=True)
def _heights(height: np.ndarray, ox: float, oy: float, inv: float, xy: np.ndarray) -> np.ndarray:
    rows, cols = height.shape
    out = np.empty(xy.shape[0])
    for i in range(xy.shape[0]):
        col = min(max((xy[i, 0] - ox) * inv, 0.0), cols - 1.0)
        row = min(max((xy[i, 1] - oy) * inv, 0.0), rows - 1.0)
        c, r = min(int(col), cols - 2), min(int(row), rows - 2)
        fc, fr = col - c, row - r
        low = height[r, c] * (1.0 - fc) + height[r, c + 1] * fc
        high = height[r + 1, c] * (1.0 - fc) + height[r + 1, c + 1] * fc
        out[i] = low * (1.0 - fr) + high * fr
    return out


def heights_at(terrain: Terrain, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) bilinear ground height [m] at x, y (n, 2)."""
    return _heights(
        terrain.height,
        terrain.origin[0],
        terrain.origin[1],
        1.0 / terrain.resolution,
        np.ascontiguousarray(xy),
    )
