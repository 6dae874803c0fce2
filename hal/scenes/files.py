"""Scenes from files: arrays, height pictures, point clouds and meshes; and scenes to files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hal.npzfile import DamagedFile, read_npy, read_npz
from hal.regular import open_regular
from hal.scenes.barn import read_world
from hal.scenes.foreign import NODATA_HEIGHTS, read_las, read_tif, resolution_for, understood
from hal.scenes.gridding import fill, grid, place_start
from hal.scenes.readers import read_geometry
from hal.scenes.scene import Geometry, Goal, Pose, Scene, SceneError

DEFAULT_RESOLUTION = 0.05
"""Cell size for clouds and meshes [m]."""
BAGS = (".bag", ".db3", ".mcap")
ENDINGS = (".npz", ".npy", ".png", ".tif", ".tiff", ".ply", ".pcd", ".las", ".laz", ".stl", ".obj")


def read_scene(
    path: Path,
    *,
    resolution: float | None = None,
    height_range: tuple[float, float] | None = None,
    start: Pose | None = None,
    units: str | None = None,
    up: str | None = None,
) -> Scene:
    """A scene from `path`. Raises SceneError. `units` (m, cm, mm, ft) and `up` (z, y) of a cloud or mesh, None: guessed
    from its extent; the guess stands in `Scene.taken`.

    `resolution` [m] is needed for a picture and optional for clouds and meshes; `height_range` [m] (black, white) is
    needed for a picture. Unknown cells are filled for the physics and stay NaN in `Scene.survey`. Without `start` a
    level place is chosen.
    """
    if not path.is_file():
        raise SceneError(f"{path}: no such file")
    if resolution is not None and not resolution > 0.0:
        raise SceneError(f"resolution must be a positive number of metres, got {resolution}")
    ending, mesh, words = path.suffix.lower(), None, ""
    if ending == ".world":
        if not resolution is height_range is start is units is up is None:
            raise SceneError(f"{path.name}: a world of the BARN challenge needs no options: leave them out")
        return read_world(path)
    if ending == ".npz":
        if resolution is not None or height_range is not None:
            raise SceneError(
                f"{path.name}: an .npz file brings its own resolution and heights: leave the options out"
            )
        return _read_npz(path, start)
    if ending == ".png":
        height, origin = _read_png(path, resolution, height_range)
        assert resolution is not None
    elif ending in (".tif", ".tiff"):
        height, resolution, origin, words = read_tif(path, resolution)
    elif ending == ".npy" and (array := _read_npy(path)).shape[1:] != (3,):
        if resolution is None:
            raise SceneError(f"{path.name}: heights without a cell size: give --resolution METRES")
        height, origin = _heights(array), (0.0, 0.0)
    elif ending in ENDINGS:
        local = ending in (".las", ".laz")
        if local or ending == ".npy":
            points = read_las(path) if local else array
            geometry = Geometry(points, np.empty((0, 3), np.int64)).finite(path.name)
        else:
            geometry = read_geometry(path)
        taken = understood(geometry, units, up, local)
        geometry, words = taken.geometry, taken.words
        if resolution is None and not len(geometry.triangles):
            resolution = resolution_for(geometry.vertices, DEFAULT_RESOLUTION)
        resolution = resolution or DEFAULT_RESOLUTION
        height, origin, overhangs = grid(geometry, resolution, path.name)
        mesh = geometry if overhangs else None
    elif ending in BAGS:
        raise SceneError(
            f"{path.name} is a bag; `rbtrg-robot map convert {path} OUT.npz` reads a grid map in it"
        )
    else:
        raise SceneError(
            f"{path.name}: cannot read {ending or 'a file without ending'}: use {', '.join(ENDINGS)}"
        )
    return _scene(path, height, resolution, origin, start, None, words, mesh)


def _scene(
    path: Path,
    height: NDArray[np.float32],
    resolution: float,
    origin: tuple[float, float],
    start: Pose | None,
    goals: Mapping[str, Goal] | None,
    taken: str = "",
    mesh: Geometry | None = None,
) -> Scene:
    known = np.isfinite(height)
    filled = fill(height)
    if start is None:
        start, found = place_start(filled, known, resolution, origin, path.stem)
        goals = {**found, **(goals or {})}
    return Scene(
        name=path.stem,
        height=filled,
        resolution=resolution,
        origin=origin,
        start=start,
        goals=goals or {"home": start},
        description=f"from {path.name}",
        taken=taken,
        survey=None if known.all() else height,
        mesh=mesh,
    )


def _read_npy(path: Path) -> NDArray[np.float64]:
    """Heights (rows, cols), row 0 in the south, or points (n, 3): in double precision, since they may be of a country's
    grid."""
    try:
        array = np.asarray(read_npy(path), np.float64)
    except (OSError, ValueError) as error:  # a damaged file, or one of texts
        raise SceneError(f"{path.name}: not a readable .npy ({error})") from error
    if array.ndim != 2 or min(array.shape) < 2:
        raise SceneError(f"{path.name}: heights are (rows, cols) and points (n, 3), this is {array.shape}")
    return array


def _heights(array: NDArray[np.float64]) -> NDArray[np.float32]:
    """With NaN where the model says that there is none."""
    return np.where(np.isin(array, NODATA_HEIGHTS) | (np.abs(array) > 1e6), np.nan, array).astype(np.float32)


def _read_png(
    path: Path, resolution: float | None, height_range: tuple[float, float] | None
) -> tuple[NDArray[np.float32], tuple[float, float]]:
    if resolution is None or height_range is None:
        raise SceneError(
            f"{path.name}: a picture needs the heights of black and white, --height-range LOW HIGH, and "
            "--resolution METRES"
        )
    low, high = height_range
    if not (np.isfinite([low, high]).all() and low < high):
        raise SceneError(f"{path.name}: height range must be two growing numbers of metres, got {low} {high}")
    try:
        with open_regular(path) as file, Image.open(file) as image:
            deep = image.mode.startswith("I")  # 16 bit
            pixels = np.asarray(image if deep else image.convert("L"), np.float64)
    except Exception as error:  # whatever a broken file trips the library over
        raise SceneError(f"{path.name}: not a readable PNG ({error})") from error
    height = low + (high - low) * pixels[::-1] / (65535.0 if deep else 255.0)  # row 0 of a picture is north
    rows, cols = height.shape
    return height.astype(np.float32), (-0.5 * (cols - 1) * resolution, -0.5 * (rows - 1) * resolution)


def _read_npz(path: Path, start: Pose | None) -> Scene:
    try:
        data = read_npz(path)
    except (OSError, DamagedFile) as error:
        raise SceneError(f"{path.name}: not a readable .npz file ({error})") from error
    missing = [key for key in ("height", "resolution", "origin") if key not in data]
    if missing:
        raise SceneError(
            f"{path.name}: lacks {', '.join(missing)}; an .npz scene holds height, resolution and origin"
        )
    height = np.asarray(data["height"])
    if height.ndim != 2 or not np.issubdtype(height.dtype, np.number) or min(height.shape) < 2:
        raise SceneError(
            f"{path.name}: height must be a 2-D array of numbers, got {height.dtype} {height.shape}"
        )
    try:
        resolution = float(data["resolution"])
        x, y = (float(v) for v in np.asarray(data["origin"], float).reshape(-1)[:2])
        if start is None and "start" in data:
            sx, sy, yaw = (float(v) for v in np.asarray(data["start"], float).reshape(3))
            start = (sx, sy, yaw)
        goals: dict[str, Goal] | None = None
        if "goal_names" in data:
            poses = np.asarray(data["goal_poses"], float).reshape(-1, 3).tolist()
            names = np.asarray(data["goal_names"]).astype(str).tolist()
            goals = {
                n: (p[0], p[1], None if np.isnan(p[2]) else p[2]) for n, p in zip(names, poses, strict=True)
            }
    except (ValueError, TypeError, KeyError) as error:
        raise SceneError(
            f"{path.name}: resolution, origin, start or goals are malformed ({error})"
        ) from error
    if not (np.isfinite([resolution, x, y]).all() and resolution > 0.0):
        raise SceneError(f"{path.name}: resolution must be positive and origin finite [m]")
    if np.isinf(height.astype(np.float64)).any():
        raise SceneError(f"{path.name}: height holds infinities; use NaN where it is unknown")
    return _scene(path, height.astype(np.float32), resolution, (x, y), start, goals)


def save_scene(scene: Scene, path: Path) -> None:
    """Write an .npz that `read_scene` reads back. Unsurveyed cells are stored as NaN."""
    names = list(scene.goals)
    poses = [[x, y, np.nan if yaw is None else yaw] for x, y, yaw in scene.goals.values()]
    np.savez_compressed(
        path,
        height=scene.height if scene.survey is None else scene.survey,
        resolution=scene.resolution,
        origin=np.array(scene.origin),
        start=np.array(scene.start),
        goal_names=np.array(names, dtype=np.str_),
        goal_poses=np.array(poses, np.float64).reshape(-1, 3),
    )
