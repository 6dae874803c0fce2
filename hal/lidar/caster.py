"""Ray casting: on the terrain, a height surface (numba) or a mesh (Embree), and on moving boxes.

A height surface has its vertices at the cell centres; each cell is cut in two triangles from [r, c] to [r+1, c+1].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hal.errors import OperatorError
from hal.lidar.kernels import cast_boxes, incidence, pyramid
from hal.lidar.march import cast_surface
from hal.optional import open3d_hint

Float32 = NDArray[np.float32]


class CasterError(OperatorError):
    """The terrain cannot be ray-cast; the message names what was expected or what is missing."""


class TerrainCaster(Protocol):
    """The static terrain as the LiDAR sees it."""

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


class MeshCaster:
    """Embree, by open3d, on the triangles of a mesh: surfaces above one another, which a height array cannot hold.

    It holds the GIL while it casts.
    """

    def __init__(self, vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> None:
        """`vertices` (n, 3) [m], `triangles` (m, 3) indices into them. Raises CasterError where open3d does not
        load."""
        try:
            import open3d  # heavy, and needs system libraries that a bare machine may lack
        except (ImportError, OSError) as error:
            raise CasterError(
                f"the scene has surfaces above one another; rays on them need open3d. {open3d_hint(error)}"
            ) from error
        core: Any = open3d.core  # its stubs do not know that a Tensor takes an array
        self._tensor = core.Tensor
        self._scene: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(vertices, np.float32)),
            self._tensor(np.ascontiguousarray(triangles, np.uint32)),
        )

    def cast(self, origins: Float32, directions: Float32) -> Float32:
        """See TerrainCaster."""
        return self.returns(origins, directions)[0]

    def returns(self, origins: Float32, directions: Float32) -> tuple[Float32, Float32]:
        """See TerrainCaster."""
        if len(origins) == 0:
            return np.empty(0, np.float32), np.empty(0, np.float32)
        rays = np.concatenate([origins, directions], axis=1).astype(np.float32, copy=False)
        hits = self._scene.cast_rays(self._tensor(rays), nthreads=1)
        ranges: Float32 = hits["t_hit"].numpy()
        cosine = np.abs(np.einsum("ij,ij->i", hits["primitive_normals"].numpy(), rays[:, 3:]))
        return ranges, np.where(np.isfinite(ranges), cosine, np.float32(0.0))


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
