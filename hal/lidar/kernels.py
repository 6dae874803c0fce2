"""Ray kernels: oriented boxes, incidence, and the max pyramid that the march over the surface climbs
(`hal.lidar.march`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

BLOCK_SIDE = 8
"""Cells per side of one entry of the max pyramid."""

BLOCK_REACH = 4
"""Blocks around a block whose highest vertex tells how far a ray may jump."""


class Pyramid(NamedTuple):
    """Highest vertices of ever larger parts of a height array (rows, cols), float32."""

    cells: NDArray[np.float32]
    """(rows - 1, cols - 1): of each cell."""
    blocks: NDArray[np.float32]
    """(ceil((rows - 1) / BLOCK_SIDE), ceil((cols - 1) / BLOCK_SIDE)): of BLOCK_SIDE x BLOCK_SIDE cells."""
    around: NDArray[np.float32]
    """As `blocks`: of all blocks up to BLOCK_REACH rows and columns away."""
    highest: float
    """Of all."""


def pyramid(height: NDArray[np.float32]) -> Pyramid:
    """The pyramid over the vertices `height`."""
    pairs = np.maximum(height[1:], height[:-1])
    cells = np.ascontiguousarray(np.maximum(pairs[:, 1:], pairs[:, :-1]))
    fill = [(0, -n % BLOCK_SIDE) for n in cells.shape]
    padded = np.pad(cells, fill, constant_values=-np.inf)
    rows, cols = (n // BLOCK_SIDE for n in padded.shape)
    blocks = np.ascontiguousarray(padded.reshape(rows, BLOCK_SIDE, cols, BLOCK_SIDE).max(axis=(1, 3)))
    window = (2 * BLOCK_REACH + 1, 2 * BLOCK_REACH + 1)
    views = np.lib.stride_tricks.sliding_window_view(np.pad(blocks, BLOCK_REACH, mode="edge"), window)
    return Pyramid(cells, blocks, np.ascontiguousarray(views.max(axis=(2, 3))), float(blocks.max()))


@njit(cache=True, nogil=True, error_model="numpy")
def cast_boxes(
    boxes: NDArray[np.float64],
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    ranges: NDArray[np.float32],
) -> None:
    """Lower `ranges` (n,) to the nearest box. Rows of `boxes`: centre (3), half size (3), rotation world <- box (9).

    A ray that starts inside a box leaves it unseen.
    """
    for k in range(boxes.shape[0]):
        b = boxes[k]
        for i in range(origins.shape[0]):
            near = -np.inf
            far = np.inf
            for a in range(3):
                o = 0.0
                d = 0.0
                for w in range(3):
                    axis = b[6 + 3 * w + a]
                    o += axis * (origins[i, w] - b[w])
                    d += axis * directions[i, w]
                if abs(d) < 1e-12:
                    if abs(o) > b[3 + a]:
                        near = np.inf
                    continue
                p = (-b[3 + a] - o) / d
                q = (b[3 + a] - o) / d
                near = max(near, min(p, q))
                far = min(far, max(p, q))
            if 0.0 < near <= far and near < ranges[i]:
                ranges[i] = near


@njit(cache=True, nogil=True, error_model="numpy")
def incidence(
    height: NDArray[np.float32],
    resolution: float,
    x0: float,
    y0: float,
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    ranges: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """|cos| of the angle between ray and surface normal at each hit, into `out` (n,); 0 for a miss."""
    rows, cols = height.shape
    for i in range(ranges.shape[0]):
        t = ranges[i]
        if not np.isfinite(t):
            out[i] = 0.0
            continue
        gx = (origins[i, 0] + directions[i, 0] * t - x0) / resolution
        gy = (origins[i, 1] + directions[i, 1] * t - y0) / resolution
        c = min(max(int(gx), 0), cols - 2)
        r = min(max(int(gy), 0), rows - 2)
        h00 = height[r, c]
        h11 = height[r + 1, c + 1]
        if gx - c >= gy - r:
            sx = height[r, c + 1] - h00
            sy = h11 - height[r, c + 1]
        else:
            sx = h11 - height[r + 1, c]
            sy = height[r + 1, c] - h00
        sx /= resolution
        sy /= resolution
        dot = -sx * directions[i, 0] - sy * directions[i, 1] + directions[i, 2]
        out[i] = abs(dot) / np.sqrt(1.0 + sx * sx + sy * sy)
