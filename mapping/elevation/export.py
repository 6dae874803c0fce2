"""Maps for other programs: GeoTIFF, a cloud of cell centres, and an occupancy grid that Nav2's map_server reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mapping.elevation.exchange import MapError
from mapping.elevation.map import ElevationMap
from mapping.filling import slope_and_step
from mapping.grid import ElevationGrid

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
"""Grey values of map_server's mode `trinary`."""
NODATA = -9999.0


@dataclass(frozen=True, slots=True)
class Limits:
    """What the robot drives over."""

    max_step: float
    """[m]"""
    max_slope: float
    """[rad]"""


def traversal_cost(grid: ElevationGrid, limits: Limits) -> NDArray[np.int8]:
    """(rows, cols) int8 as in nav_msgs/OccupancyGrid: slope and step of each cell as a share of what the robot drives
    over, 0 to 100 (100: at or beyond a limit), -1 where the ground is not trusted."""
    height = np.where(grid.trusted, grid.height, np.float32(np.nan))
    slope, step = slope_and_step(height, grid.resolution)
    share = np.fmax(slope / limits.max_slope, step / limits.max_step)
    cost = np.clip(np.rint(100.0 * np.nan_to_num(share)), 0, 100).astype(np.int8)
    cost[~grid.trusted] = -1
    return cost


def whole(elevation: ElevationMap) -> ElevationGrid:
    """The whole map as one grid, cut to what is known. Raises MapError while it is empty."""
    patches = [elevation.read(box) for box in elevation.boxes()]
    cells = [(*patch.cell, *patch.shape) for patch in patches]
    r0, c0 = min(c[0] for c in cells), min(c[1] for c in cells)
    rows, cols = max(c[0] + c[2] for c in cells) - r0, max(c[1] + c[3] for c in cells) - c0
    height, trusted = np.full((rows, cols), np.nan, np.float32), np.zeros((rows, cols), np.bool_)
    for patch, (r, c, n, m) in zip(patches, cells, strict=True):
        part = slice(r - r0, r - r0 + n), slice(c - c0, c - c0 + m)
        height[part] = patch.layers["elevation"]
        trusted[part] = patch.layers["trusted"] > 0.5
    known = np.isfinite(height)
    if not known.any():
        raise MapError("the map holds no ground yet")
    along, across = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    cut = slice(along[0], along[-1] + 1), slice(across[0], across[-1] + 1)
    size = elevation.params.resolution
    return ElevationGrid(
        height[cut], trusted[cut], (float(c0 + across[0]) * size, float(r0 + along[0]) * size), size
    )


def write(elevation: ElevationMap, out: Path, limits: Limits) -> int:
    """Write a map by the end of the name: `.npz` (what `--map` reads, nothing is lost), `.tif`, `.pcd`, `.png` with a
    `.yaml` beside it. Returns its known cells. Raises OSError, MapError."""
    if out.suffix not in WRITERS:
        raise MapError(f"{out} must end in {', '.join(WRITERS)}")
    grid = whole(elevation)
    writer = WRITERS[out.suffix]
    if writer is None:
        elevation.save(out)
    else:
        writer(grid, out, limits)
    return int(np.isfinite(grid.height).sum())


def _tif(grid: ElevationGrid, out: Path, _limits: Limits) -> None:
    try:
        import tifffile
    except ImportError as error:
        raise MapError(f"{out.name} needs tifffile: `uv sync --extra files` installs it") from error
    r, (west, south) = grid.resolution, grid.origin
    north = south + (grid.height.shape[0] - 0.5) * r
    tags: list[tuple[int, str, int, Any, bool]] = [
        (33550, "d", 3, (r, r, 0.0), True),
        (33922, "d", 6, (0.0, 0.0, 0.0, west - 0.5 * r, north, 0.0), True),
        (34735, "H", 8, (1, 1, 0, 1, 1025, 0, 1, 1), True),  # a cell is an area
        (42113, "s", 0, f"{NODATA:g}", True),
    ]
    height = np.where(np.isfinite(grid.height), grid.height, np.float32(NODATA))
    tifffile.imwrite(out, height[::-1], compression=None, extratags=tags, metadata=None)


def _pcd(grid: ElevationGrid, out: Path, _limits: Limits) -> None:
    row, col = np.nonzero(np.isfinite(grid.height))
    points = np.empty((len(row), 3), "<f4")
    points[:, 0] = grid.origin[0] + col * grid.resolution
    points[:, 1] = grid.origin[1] + row * grid.resolution
    points[:, 2] = grid.height[row, col]
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    out.write_bytes(head.encode() + points.tobytes())


def _png(grid: ElevationGrid, out: Path, limits: Limits) -> None:
    cost = traversal_cost(grid, limits)
    pixels = np.full(cost.shape, FREE, np.uint8)
    pixels[cost >= 100] = OCCUPIED
    pixels[cost < 0] = UNKNOWN
    Image.fromarray(pixels[::-1]).save(out)
    corner = [value - grid.resolution / 2 for value in grid.origin]
    out.with_suffix(".yaml").write_text(
        f"image: {out.name}\nmode: trinary\nresolution: {grid.resolution:g}\norigin: [{corner[0]:.4f}, "
        f"{corner[1]:.4f}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


WRITERS: dict[str, Callable[[ElevationGrid, Path, Limits], None] | None] = {
    ".npz": None,
    ".png": _png,
    ".tif": _tif,
    ".pcd": _pcd,
}
"""By the end of a file's name; None: the map's own."""
