"""Files that need a library of the extra `files`: LAS and LAZ clouds, GeoTIFF. Also the guess of units and up axis,
which no file tells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hal.scenes.scene import Geometry, SceneError

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
"""Metres of a unit."""
UPS = ("z", "y")
BROAD_FILE = 1000.0
"""A file without a place on earth that is broader than this [m] is taken for millimetres."""
THIN_SHARE = 0.4
"""Ground is thin along its up axis: y is up where its extent is below this share of both others'."""
NODATA_HEIGHTS = (-9999.0, -32768.0, -32767.0, -99999.0)
"""Heights that stand for none in elevation models whose file does not say so; beyond 1e6 nothing is a height."""
FAR_COORDINATE = 5000.0
"""Coordinates beyond [m] are of a country's grid: they are counted from the corner of the file."""


@dataclass(frozen=True, slots=True)
class Taken:
    """How a file was understood."""

    geometry: Geometry
    words: str
    """What was guessed, for the operator; empty where nothing was."""


def needs(package: str, path: Path) -> Any:
    """A package of the extra. Raises SceneError, which says how to install it."""
    from importlib import import_module

    try:
        return import_module(package)
    except ImportError as error:
        raise SceneError(
            f"{path.name}: reading {path.suffix} needs {package}: `uv sync --extra files` (or `pip install "
            "'rbtrg-robot[files]'`)"
        ) from error


def read_las(path: Path) -> NDArray[np.float64]:
    """(n, 3) points of a .las or .laz [units of the file]. Raises SceneError."""
    laspy = needs("laspy", path)
    try:
        with laspy.open(path) as reader:
            return np.column_stack([np.asarray(v, np.float64) for v in _xyz(reader.read())])
    except Exception as error:  # whatever a broken file trips the library over
        raise SceneError(
            f"{path.name}: broken or unreadable {path.suffix[1:].upper()} file ({error})"
        ) from error


def _xyz(las: Any) -> tuple[Any, Any, Any]:
    return las.x, las.y, las.z


def read_tif(
    path: Path, resolution: float | None
) -> tuple[NDArray[np.float32], float, tuple[float, float], str]:
    """Heights (rows, cols) with row 0 in the south and NaN where the model has none, resolution [m], origin, words.
    Raises SceneError."""
    tifffile = needs("tifffile", path)
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages[0]
            try:
                pixels = page.asarray()
            except (
                ValueError
            ):  # a packing that tifffile leaves to another package, as LZW: libtiff in Pillow has it
                with Image.open(path) as image:
                    pixels = np.asarray(image)
            height = np.asarray(pixels, np.float64)
            tags = {tag.code: tag.value for tag in page.tags.values()}
    except Exception as error:
        raise SceneError(
            f"{path.name}: not a readable TIFF ({error}); "
            f"`gdal_translate -co COMPRESS=DEFLATE {path.name} NEW.tif` repacks one"
        ) from error
    if height.ndim != 2:
        raise SceneError(
            f"{path.name}: heights are one number per cell, this picture has {height.shape}: export one band"
        )
    scale, tie, words = tags.get(33550), tags.get(33922), ""
    if scale is not None and abs(scale[0] - scale[1]) > 1e-6 * abs(scale[0]):
        raise SceneError(f"{path.name}: its cells are {scale[0]} x {scale[1]}: resample it to square ones")
    if scale is not None and scale[0] < 1e-3:
        raise SceneError(f"{path.name}: its cells are {scale[0]} degrees: project it to metres, such as UTM")
    if resolution is None:
        if scale is None:
            raise SceneError(
                f"{path.name}: it does not say how large its cells are: give --resolution METRES"
            )
        resolution = float(scale[0])
    holes = ~np.isfinite(height) | (np.abs(height) > 1e6)
    try:
        holes |= height == float(str(tags[42113]).strip("\0 "))
    except (KeyError, ValueError):
        holes |= np.isin(height, NODATA_HEIGHTS)
    height[holes] = np.nan
    if holes.all():
        raise SceneError(f"{path.name}: holds no height: every cell is nodata")
    origin = (0.0, 0.0)
    if tie is not None and scale is not None:
        west, north = (
            float(tie[3]) + (0.5 - float(tie[0])) * resolution,
            float(tie[4]) - (0.5 - float(tie[1])) * resolution,
        )
        south = north - (height.shape[0] - 1) * resolution
        origin = (west, south)
        if max(abs(west), abs(south)) > FAR_COORDINATE:
            words, origin = f"x, y count from ({west:.2f}, {south:.2f}) of its grid", (0.0, 0.0)
    return height[::-1].astype(np.float32), resolution, origin, words


def understood(geometry: Geometry, units: str | None, up: str | None, local: bool = False) -> Taken:
    """Bring geometry to metres, z up, near the origin. `units`, `up`: from the operator; None: guessed from the
    extent. `local`: the file has a place on earth, so it is metres with z up. Raises SceneError."""
    if units is not None and units not in UNITS:
        raise SceneError(f"units are {', '.join(UNITS)}, got {units!r}")
    if up is not None and up not in UPS:
        raise SceneError(f"up is {' or '.join(UPS)}, got {up!r}")
    vertices, words = np.asarray(geometry.vertices, np.float64), []
    low, high = np.quantile(vertices, [0.01, 0.99], axis=0) if len(vertices) else (np.zeros(3), np.zeros(3))
    size = high - low
    if up is None and not local and 0.0 < size[1] < THIN_SHARE * min(size[0], size[2]):
        up = "y"
        words.append("y is up, by its extent (--up z for z)")
    if up == "y":
        vertices = np.column_stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]])
        size = size[[0, 2, 1]]
    if units is None and not local and max(size[0], size[1]) > BROAD_FILE:
        units = "mm"
        words.append(f"its {max(size[0], size[1]):.0f} units are millimetres (--units m for metres)")
    vertices = vertices * UNITS[units or "m"]
    corner = vertices.min(axis=0)[:2]
    if np.abs(corner).max() > FAR_COORDINATE:
        shift = np.floor(corner)
        vertices = vertices - [*shift, 0.0]
        words.append(f"x, y count from ({shift[0]:.0f}, {shift[1]:.0f}) of its grid")
    return Taken(Geometry(vertices, geometry.triangles), "; ".join(words))


def resolution_for(points: NDArray[np.float64], least: float) -> float:
    """Cells that the points (n, 3) [m] of a cloud fill: `least` [m], or coarser where they lie further apart."""
    cells = np.unique(np.floor(points[:, :2] / 0.5).astype(np.int64), axis=0)
    spacing = float(np.sqrt(0.25 * len(cells) / max(len(points), 1)))
    return least if 1.2 * spacing <= least else min(0.5, float(np.ceil(1.2 * spacing / least)) * least)
