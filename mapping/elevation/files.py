"""Maps on disk: the map's own .npz (versioned, exact), and prior maps from .npz grids, point clouds and meshes."""

from __future__ import annotations

import os
import secrets
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.errors import one_line
from hal.npzfile import DamagedFile, read_npz
from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import HOLE, MapError, MapPatch
from mapping.elevation.tiles import CELL, CONTACT, LIDAR, PLANTS, PRIOR, SAVED, UNKNOWN, TileStore

FORMAT = "rbtrg_elevation_map"
FILE_VERSION = 1
PRIOR_SIGMA = 0.04
"""Height noise of a prior map of unknown making [m]."""
MAX_EXTENT = 20_000.0
"""Farthest coordinate of a prior map [m]; beyond it the units are not metres."""

MAX_TILES = 4000
"""Largest prior map: about 0.7 GB."""
MAX_CELLS = 25_000_000
"""Most cells that a map of another making is entered as."""
MAX_BYTES = 1_000_000_000
"""Of the arrays in a file: a small file may claim any size."""


def save_store(
    store: TileStore, path: Path, resolution: float, cloud: NDArray[np.float32], areas: str = ""
) -> None:
    """Write all tiles, the thinned cloud (n, 3) of the same map, and a text with the areas drawn on it.

    The file appears complete or not at all. Same map, same bytes. Raises OSError."""
    path = Path(path)
    keys = store.keys
    arrays: dict[str, Any] = {
        "format": np.array(FORMAT),
        "version": np.array(FILE_VERSION),
        "frame": np.array("map"),
        "resolution": np.array(resolution),
        "tile_cells": np.array(store.size),
        "tiles": keys.astype(np.int32),
        "cloud": cloud,
        "areas": np.array(areas),
    }
    layers = {name: np.empty((len(keys), store.size, store.size), CELL[name]) for name in SAVED}
    for k, (row, col) in enumerate(keys.tolist()):
        cells = store.look_at(row, col)
        for name, layer in layers.items():
            layer[k] = cells[name]
    arrays |= layers
    part = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        with part.open("xb") as file:  # never through a link that lies there, nor together with another save
            np.savez_compressed(file, **arrays)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def check(patch: MapPatch, params: ElevationConfig) -> None:
    """Raises MapError where a store of these parameters cannot hold a read-out."""
    if abs(patch.resolution - params.resolution) > 1e-9:
        raise MapError(f"the copy has cells of {patch.resolution} m, the map {params.resolution} m")
    for name, most in (("source", HOLE), ("trusted", 1)):
        if not ((patch.layers[name] >= 0) & (patch.layers[name] <= most)).all():
            raise MapError(f"the copy has cells whose {name!r} is not 0 to {most}")


def restore_store(
    store: TileStore, patch: MapPatch, params: ElevationConfig, now: int, *, sent: bool = True
) -> int:
    """Write the cells of a read-out back into a store, as seen at `now` [ms] by enough points; returns how many are
    known.

    `sent`: they count as sent, as the reader they came from has them. Raises MapError for another resolution, and for
    cells of no known source.
    """
    check(patch, params)
    layers = patch.layers
    height, upper, source = layers["elevation"], layers["upper_bound"], layers["source"].astype(np.uint8)
    source[(source == HOLE) & (layers["trusted"] > 0.0)] = LIDAR  # its floor was seen
    known = (source == CONTACT) | (source == LIDAR) | (source == PLANTS)
    measured = np.where(known, source, UNKNOWN).astype(np.uint8)
    store.take_back(*patch.cell, (height, layers["variance"], upper), measured, params.alone_count, now)
    if sent:
        state = (source + 16 * layers["trusted"]).astype(np.uint8)
        store.differences(*patch.cell, height, upper, state, 0.0)
    return int(known.sum())


def load_into(store: TileStore, path: Path, resolution: float, enough: int) -> int:
    """Put the map in `path` into an empty store of this resolution; returns the number of cells with a height.

    Ours (.npz): exact at the same resolution, resampled at another. A grid (.npz with `height`,
    `resolution`, `origin`, optional `trusted`), a cloud or a mesh (.ply, .pcd, .stl, .obj): in the `map` frame, metres,
    z up. Raises MapError, which says what is wrong with the file.
    """
    path = Path(path)
    if not path.is_file():
        raise MapError(f"{path}: no such map file")
    if path.suffix.lower() != ".npz":
        return _import_geometry(store, path, resolution, enough)
    data = _arrays(path)
    if "format" in data:
        return _load_own(store, data, path.name, resolution, enough)
    try:
        height = np.asarray(data["height"], dtype=np.float32)
        own, origin = float(data["resolution"]), np.asarray(data["origin"], dtype=np.float64)
        if height.ndim != 2 or origin.shape != (2,) or not 0.0 < own < np.inf:
            raise ValueError(f"height {height.shape}, origin {origin.shape}, resolution {own}")
        trusted = np.asarray(data.get("trusted", np.isfinite(height)), dtype=bool)
        if trusted.shape != height.shape:
            raise ValueError(f"trusted {trusted.shape} does not fit height {height.shape}")
    except KeyError as error:
        raise MapError(
            f"{path.name}: a map .npz needs height, resolution and origin; {error} is missing"
        ) from error
    except (ValueError, TypeError) as error:
        raise MapError(f"{path.name}: height must be 2-D, origin x, y, resolution metres: {error}") from error
    return _enter(store, np.where(trusted, height, np.nan), own, (origin[0], origin[1]), resolution, enough)


def read_cloud(path: Path) -> NDArray[np.float32]:
    """(n, 3) cloud of a map [m]: what `save_store` wrote, or the points of a .ply or .pcd without a mesh; none where
    the file has none.

    Raises MapError for a cloud that is damaged.
    """
    if path.suffix.lower() in (".ply", ".pcd"):
        from hal.scenes.readers import read_geometry

        geometry = read_geometry(path)  # it was read before
        if len(geometry.triangles) == 0:
            return np.ascontiguousarray(geometry.vertices, np.float32)
    if path.suffix.lower() != ".npz":
        return np.empty((0, 3), np.float32)
    return checked_cloud(_arrays(path, ("cloud",)).get("cloud", np.empty((0, 3), np.float32)), path.name)


def areas_in(path: Path) -> str:
    """The text of what was drawn on a map; empty where the file has none. Raises MapError."""
    if path.suffix.lower() != ".npz":
        return ""
    return str(_arrays(path, ("areas",)).get("areas", ""))


def _arrays(path: Path, only: tuple[str, ...] = ()) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz file, or those of them that are named. Raises MapError."""
    try:
        return read_npz(path, MAX_BYTES, only)
    except (OSError, DamagedFile) as error:
        raise MapError(f"{path.name}: {one_line(error)}") from error


def checked_cloud(cloud: NDArray[Any], name: str) -> NDArray[np.float32]:
    """The cloud of a prior map, (n, 3) [m]. `name`: where it comes from. Raises MapError where it is none."""
    if cloud.ndim != 2 or cloud.shape[1] != 3 or cloud.dtype.kind != "f" or not np.isfinite(cloud).all():
        raise MapError(f"{name}: damaged cloud: take another copy")
    if len(cloud) and not np.abs(cloud).max() <= MAX_EXTENT:
        raise MapError(f"{name}: damaged cloud: it reaches beyond {MAX_EXTENT / 1000:.0f} km")
    return cloud.astype(np.float32)


def _load_own(store: TileStore, data: dict[str, NDArray], name: str, resolution: float, enough: int) -> int:
    if str(data["format"]) != FORMAT:
        raise MapError(f"{name}: not an elevation map but {data['format']}")
    if str(data.get("version")) != str(FILE_VERSION):
        raise MapError(
            f"{name}: map version {data.get('version')}; this program reads version {FILE_VERSION}"
        )
    try:
        own, size, tiles = float(data["resolution"]), int(data["tile_cells"]), data["tiles"]
        shape = (len(tiles), size, size)
        if tiles.shape != (len(tiles), 2) or any(data[field].shape != shape for field in SAVED):
            raise ValueError("arrays do not fit together")
        if tiles.dtype.kind != "i" or any(data[field].dtype != CELL[field] for field in SAVED):
            raise ValueError("arrays of another type")
        known = data["source"] != UNKNOWN
        height, variance = data["height"][known], data["variance"][known]
        if not 0.0 < own < np.inf or len(np.unique(tiles, axis=0)) < len(tiles):
            raise ValueError("no resolution, or a tile twice")
        if (
            not np.isin(data["source"], (UNKNOWN, CONTACT, LIDAR, PLANTS)).all()
            or not (variance >= 0.0).all()
        ):
            raise ValueError("cells that nothing measured")
        far = np.abs(tiles.astype(np.float64)).max(initial=0.0) * size * own
        if not (far <= MAX_EXTENT and (np.abs(height) <= MAX_EXTENT).all()):
            raise ValueError(f"it reaches beyond {MAX_EXTENT / 1000:.0f} km")
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise MapError(f"{name}: damaged map ({error}): take another copy") from error
    if abs(own - resolution) < 1e-9 and size == store.size:
        n = size * size
        store.reserve(store.used + len(tiles))
        for k, (row, col) in enumerate(tiles):
            slot = store.allocate(int(row), int(col))
            cells = store.cells[slot * n : (slot + 1) * n]
            for field in SAVED:
                cells[field] = data[field][k].reshape(-1)
            cells["seen"] = PRIOR
            store.touched[slot] = 1
        return int(np.count_nonzero(known))
    known = data["source"] == LIDAR
    tile, r, c = np.nonzero(known)
    x, y = (tiles[tile, 1] * size + c) * own, (tiles[tile, 0] * size + r) * own
    return _enter_points(store, x, y, data["height"][known], own, resolution, enough)


def _import_geometry(store: TileStore, path: Path, resolution: float, enough: int) -> int:
    from hal.scenes.gridding import grid
    from hal.scenes.readers import read_geometry
    from hal.scenes.scene import SceneError

    try:
        geometry = read_geometry(path)
        if len(geometry.triangles) == 0:
            x, y, z = geometry.vertices.T
            return _enter_points(store, x, y, z, resolution, resolution, enough)
        height, origin, _ = grid(geometry, resolution, path.name)
    except SceneError as error:
        raise MapError(str(error)) from error
    return _enter(store, height, resolution, origin, resolution, enough)


def _enter(
    store: TileStore,
    height: NDArray[np.float32],
    own: float,
    origin: tuple[float, float],
    resolution: float,
    enough: int,
) -> int:
    """Known cells of a dense grid."""
    r, c = np.nonzero(np.isfinite(height))
    return _enter_points(
        store, origin[0] + c * own, origin[1] + r * own, height[r, c], own, resolution, enough
    )


def _enter_points(
    store: TileStore, x: NDArray, y: NDArray, z: NDArray, own: float, resolution: float, enough: int
) -> int:
    """Square patches of side `own` around (x, y) at height z onto the lattice: the highest wins, of
    patches finer than a cell their median, the higher of two: a cell is wall only if half of it is."""
    if len(x) == 0:
        raise MapError("the prior map holds no known cell")
    far = float(max(np.abs(v).max() for v in (x, y, z)))
    if not far <= MAX_EXTENT:
        raise MapError(
            f"the prior map reaches {far:.0f} m from the origin: is it in metres and in the map frame?"
        )
    # coarser cells cover several of ours
    n = max(1.0, np.ceil(own / resolution - 1e-6))
    if n * n * len(x) > MAX_CELLS:
        raise MapError(f"the prior map has {n * n * len(x):.3g} cells, more than {MAX_CELLS:.3g}: cut it")
    n = int(n)
    offset = (np.arange(n) - (n - 1) / 2) * (own / n)
    rows, cols = ([_lattice(v + d, resolution) for d in offset] for v in (y, x))
    tiles = np.unique(np.concatenate([_tiles_of(i, j, store.shift) for i in rows for j in cols]), axis=0)
    if len(tiles) > MAX_TILES:
        raise MapError(
            f"the prior map covers {len(tiles)} tiles, more than {MAX_TILES}: cut it or use a coarser resolution"
        )
    store.reserve(store.used + len(tiles))
    for row, col in tiles.tolist():
        store.allocate(row, col)
    cell = np.concatenate([store.locate(i, j) for i in rows for j in cols])
    height = np.tile(z.astype(np.float32), len(rows) * len(cols))
    order = np.lexsort((-height, cell))
    index, begin, count = np.unique(cell[order], return_index=True, return_counts=True)
    cells = store.cells[index]
    cells["height"], cells["variance"] = (
        height[order][begin + (count - 1) // 2 * (own < resolution)],
        PRIOR_SIGMA**2,
    )
    cells["count"], cells["source"], cells["seen"] = enough, LIDAR, PRIOR
    store.cells[index] = cells
    store.changed(index)
    return len(index)


def _lattice(place: NDArray, resolution: float) -> NDArray[np.int64]:
    """Rows or columns of places [m]. The border of two cells belongs to the upper one, rounded or not: of a grid of
    half the resolution one cell took three columns and its neighbour one, and a wall one column wide was lost."""
    return np.floor(place / resolution + (0.5 + 1e-4)).astype(np.int64)


def _tiles_of(i: NDArray[np.int64], j: NDArray[np.int64], shift: int) -> NDArray[np.int64]:
    """(k, 2) rows and columns of the tiles that cells lie in, each once."""
    row, col = i >> shift, j >> shift
    # a raster gives long runs of the same tile: what is left of them is quick to sort
    new = np.ones(len(row), np.bool_)
    new[1:] = (np.diff(row) != 0) | (np.diff(col) != 0)
    found: NDArray[np.int64] = np.unique(np.column_stack([row[new], col[new]]), axis=0)
    return found
