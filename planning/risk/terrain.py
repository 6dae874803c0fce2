"""The elevation grid made ready for footprint samples: filled, padded, with what lets whole tiles of samples be skipped."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.filling import fill_unknown
from mapping.grid import ElevationGrid

TILE = 3
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


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """An elevation grid made ready for footprint samples: filled, padded with untrusted edge values."""

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
        return cls(height, padded, seen, (x - step, y - step), grid.resolution, pad)

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
    tiles_across = -(-len(across) // TILE)
    row, col = np.divmod(np.arange(len(u)), len(across))
    # Samples in the order of their part: corners FL, FR, BL, BR are 0..3, tiles of the rest follow.
    part = np.where(band, 2 * (u < 0) + (v < 0), 4 + row // TILE * tiles_across + col // TILE)
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


@njit(cache=True)
def _dilate(height: np.ndarray, window: int) -> np.ndarray:
    """Largest value within `window` cells in both directions, away from a border of that width."""
    rows, cols = height.shape
    out = height.copy()
    width = 2 * window + 1
    line = np.empty(max(rows, cols), np.float32)
    for r in range(rows):
        for c in range(cols):
            line[c] = out[r, c]
        # line[c] becomes the maximum of `have` cells from c on; the last shift brings it to `width`.
        have = 1
        while have < width:
            shift = min(have, width - have)
            for c in range(cols - shift):
                line[c] = line[c] if line[c] > line[c + shift] else line[c + shift]
            have += shift
        for c in range(cols - 2 * window):
            out[r, window + c] = line[c]
    have = 1
    while have < width:
        shift = min(have, width - have)
        for r in range(rows - shift):
            for c in range(cols):
                out[r, c] = out[r, c] if out[r, c] > out[r + shift, c] else out[r + shift, c]
        have += shift
    for r in range(rows - window - 1, window - 1, -1):
        for c in range(cols):
            out[r, c] = out[r - window, c]
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
