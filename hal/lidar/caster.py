"""What a ray hits: the terrain surface by Embree (open3d) or by numba, and moving boxes on top.

Both casters see the same triangles: vertices at the cell centres, each cell cut from [r, c] to [r+1, c+1].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hal.lidar.kernels import cast_boxes, incidence, pyramid
from hal.lidar.march import cast_surface

Float32 = NDArray[np.float32]

OPEN3D_HINT = (
    "LiDAR uses the built-in ray caster: open3d does not load ({}). "
    "For open3d's: apt-get install libusb-1.0-0 libgl1 libgomp1"
)


class CasterError(ValueError):
    """The terrain cannot be ray-cast; the message names what was expected."""


class TerrainCaster(Protocol):
    """The static terrain as the LiDAR sees it."""

    surface: Surface

    def cast(self, origins: Float32, directions: Float32) -> Float32:
        """Ranges (n,) [m], inf for a miss, along unit `directions` (n, 3) from `origins` (n, 3), world frame."""

    def returns(self, origins: Float32, directions: Float32) -> tuple[Float32, Float32]:
        """The same, and |cos| (n,) of the angle between ray and surface normal at each hit; 0 for a miss."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The height array the casters are built from."""

    height: Float32
    """(rows, cols) [m], finite."""
    resolution: float
    """[m]."""
    origin: tuple[float, float]
    """x, y [m] of the centre of cell [0, 0]."""

    def __post_init__(self) -> None:
        height = np.ascontiguousarray(self.height, np.float32)
        if height.ndim != 2 or min(height.shape) < 2:
            raise CasterError(f"height must be a 2-D array of at least 2 x 2, got shape {height.shape}")
        if not np.isfinite(height).all():
            raise CasterError("height must be finite: fill unknown cells before casting rays")
        if not self.resolution > 0.0:
            raise CasterError(f"resolution must be a positive number of metres, got {self.resolution}")
        object.__setattr__(self, "height", height)

    def cos_incidence(self, origins: Float32, directions: Float32, ranges: Float32) -> Float32:
        """|cos| (n,) of the angle between ray and surface normal at each hit; 0 for a miss."""
        out = np.empty(len(ranges), np.float32)
        x0, y0 = self.origin
        incidence(self.height, self.resolution, x0, y0, origins, directions, ranges, out)
        return out


class NumbaCaster:
    """March over the cells with a max pyramid; exact on the triangles, releases the GIL."""

    def __init__(self, surface: Surface, max_range: float = 200.0) -> None:
        self.surface = surface
        self._pyramid = pyramid(surface.height)
        self._max_range = max_range

    def cast(self, origins: Float32, directions: Float32) -> Float32:
        """See TerrainCaster."""
        return self.returns(origins, directions)[0]

    def returns(self, origins: Float32, directions: Float32) -> tuple[Float32, Float32]:
        """See TerrainCaster."""
        x0, y0 = self.surface.origin
        return cast_surface(
            self.surface.height,
            *self._pyramid,
            self.surface.resolution,
            x0,
            y0,
            np.ascontiguousarray(origins, np.float32),
            np.ascontiguousarray(directions, np.float32),
            self._max_range,
        )


class EmbreeCaster:
    """open3d's RaycastingScene on the same triangles; about as fast, holds the GIL while it casts."""

    def __init__(self, surface: Surface, open3d: Any) -> None:
        self.surface = surface
        self._core = open3d.core
        rows, cols = surface.height.shape
        x0, y0 = surface.origin
        x, y = np.meshgrid(
            x0 + surface.resolution * np.arange(cols), y0 + surface.resolution * np.arange(rows)
        )
        vertices = np.stack([x, y, surface.height], axis=-1).reshape(-1, 3).astype(np.float32)
        corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)[None, :]).reshape(-1)
        lower = np.stack([corner, corner + 1, corner + cols + 1], axis=1)
        upper = np.stack([corner, corner + cols + 1, corner + cols], axis=1)
        triangles = np.concatenate([lower, upper]).astype(np.uint32)
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(self._core.Tensor(vertices), self._core.Tensor(triangles))

    def cast(self, origins: Float32, directions: Float32) -> Float32:
        """See TerrainCaster."""
        if len(origins) == 0:
            return np.empty(0, np.float32)
        rays = self._core.Tensor(np.concatenate([origins, directions], axis=1).astype(np.float32, copy=False))
        ranges: Float32 = self._scene.cast_rays(rays, nthreads=1)["t_hit"].numpy()
        return ranges

    def returns(self, origins: Float32, directions: Float32) -> tuple[Float32, Float32]:
        """See TerrainCaster."""
        ranges = self.cast(origins, directions)
        return ranges, self.surface.cos_incidence(origins, directions, ranges)


def make_caster(
    height: Float32, resolution: float, origin: tuple[float, float], *, prefer: str = "embree"
) -> tuple[TerrainCaster, str]:
    """The caster of this machine, and one line that says which and, if need be, how to get open3d's.

    `prefer="numba"` skips open3d.
    """
    surface = Surface(height, resolution, origin)
    if prefer == "numba":
        return NumbaCaster(surface), "LiDAR uses the built-in ray caster"
    try:
        import open3d  # heavy, and needs system libraries that a bare machine may lack
    except (ImportError, OSError) as error:
        return NumbaCaster(surface), OPEN3D_HINT.format(
            str(error).splitlines()[0] if str(error) else "no reason given"
        )
    return EmbreeCaster(surface, open3d), "LiDAR uses open3d's ray caster"


@dataclass(frozen=True, slots=True)
class OrientedBox:
    """A solid box in the world: a dynamic obstacle, or in `base_link` a part of the robot's body."""

    centre: tuple[float, float, float]
    """[m]."""
    size: tuple[float, float, float]
    """Full lengths along the box's own axes [m]."""
    yaw: float = 0.0
    """[rad] about z."""


def pack_boxes(boxes: list[OrientedBox] | tuple[OrientedBox, ...]) -> NDArray[np.float64]:
    """Rows (m, 15) for `cast_boxes`."""
    out = np.zeros((len(boxes), 15))
    for row, box in zip(out, boxes, strict=True):
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        row[:3] = box.centre
        row[3:6] = 0.5 * np.asarray(box.size)
        row[6:] = [c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0]
    return out


def cast_onto_boxes(
    boxes: NDArray[np.float64], origins: Float32, directions: Float32, ranges: Float32
) -> None:
    """Lower `ranges` in place to the nearest of the packed boxes."""
    if len(boxes):
        cast_boxes(boxes, origins, directions, ranges)
