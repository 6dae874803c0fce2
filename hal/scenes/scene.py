"""A scene: the terrain a simulated robot stands on, where it starts and where it may be sent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hal.errors import OperatorError

if TYPE_CHECKING:
    from hal.lidar.caster import TerrainCaster
    from hal.lidar.plants import Clump

Pose = tuple[float, float, float]
"""x, y [m], yaw [rad]."""
Goal = tuple[float, float, float | None]
"""x, y [m], yaw [rad] or None for any heading."""
Pair = tuple[tuple[float, float], tuple[float, float]]
"""x, y [m] of a start and of a goal."""


class SceneError(OperatorError):
    """The scene does not exist or cannot be read; the message tells what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Vertices (n, 3) [m] and, for a mesh, triangles (m, 3) as indices into them."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]

    def finite(self, name: str) -> Geometry:
        """Without vertices that are no numbers, and without their triangles. Raises SceneError: nothing is left of file
        `name`."""
        good = np.asarray(np.isfinite(self.vertices).all(axis=1))
        if not good.any():
            raise SceneError(f"{name}: holds no points")
        whole = self.triangles[good[self.triangles].all(axis=1)]
        return Geometry(self.vertices[good], (np.cumsum(good) - 1)[whole])


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Terrain in the `world` frame; rows grow with y, columns with x, as in `ElevationGrid`."""

    name: str
    height: NDArray[np.float32]
    """(rows, cols) [m], finite."""
    resolution: float
    """Cell size [m]."""
    origin: tuple[float, float]
    """x, y [m] of the CENTRE of cell [0, 0]."""
    start: Pose
    goals: Mapping[str, Goal]
    friction: float = 0.8
    """Sliding friction of the ground."""
    description: str = ""
    taken: str = ""
    """What had to be guessed to read the file, such as its units: the operator must hear it."""
    allowed_area: tuple[tuple[float, float], ...] | None = None
    """Polygon x, y [m] outside which goals are refused; None: everywhere."""
    survey: NDArray[np.float32] | None = None
    """(rows, cols) heights as scanner stations measured them: with noise, NaN where none saw the cell. None: as
    `height`."""
    pairs: tuple[Pair, ...] = field(default=())
    """Start and goal of each benchmark query, frozen. Studies take the first ten unless told otherwise."""
    mesh: Geometry | None = None
    """What the LiDAR sees instead of `height` where surfaces lie above one another; the robot stands on `height`."""

    plants: tuple[Clump, ...] = ()
    """Grass and bushes: the LiDAR sees them, the robot drives through them."""

    def __post_init__(self) -> None:
        height = np.ascontiguousarray(self.height, np.float32)
        if height.ndim != 2 or min(height.shape) < 2:
            raise SceneError(f"{self.name}: height must be 2-D and at least 2 x 2, got {height.shape}")
        if not np.isfinite(height).all():
            raise SceneError(
                f"{self.name}: height has unknown cells; import it with load_scene, which fills them"
            )
        if not (np.isfinite(self.resolution) and self.resolution > 0.0):
            raise SceneError(f"{self.name}: resolution must be positive [m], got {self.resolution}")
        if self.survey is not None and self.survey.shape != height.shape:
            raise SceneError(f"{self.name}: survey has shape {self.survey.shape}, height {height.shape}")
        object.__setattr__(self, "height", height)
        for name, (x, y, _) in {"start": self.start, **self.goals}.items():
            if not self.contains(x, y):
                x0, y0, x1, y1 = self.extent
                raise SceneError(
                    f"{self.name}: {name} ({x:.2f}, {y:.2f}) lies outside the terrain, which reaches from "
                    f"({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f})"
                )

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of the outermost cell centres [m]."""
        rows, cols = self.height.shape
        x0, y0 = self.origin
        return x0, y0, x0 + (cols - 1) * self.resolution, y0 + (rows - 1) * self.resolution

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """(rows, cols) bool: cells that the survey has seen; all without a survey."""
        if self.survey is None:
            return np.ones(self.height.shape, np.bool_)
        return np.isfinite(self.survey)

    def with_apron(self, width: float) -> Scene:
        """The same scene with level ground at height 0 for `width` [m] around it, which no survey has seen."""
        cells = round(width / self.resolution)
        x, y = self.origin
        survey = None if self.survey is None else np.pad(self.survey, cells, constant_values=np.nan)
        origin = (x - cells * self.resolution, y - cells * self.resolution)
        return replace(self, height=np.pad(self.height, cells), origin=origin, survey=survey)

    def caster(self) -> TerrainCaster:
        """The surface that a LiDAR's rays hit. Raises CasterError where a mesh needs open3d and it does not load."""
        from hal.lidar.caster import MeshCaster, NumbaCaster, Surface  # only a simulator casts rays

        if self.mesh is not None:
            return MeshCaster(self.mesh.vertices, self.mesh.triangles)
        return NumbaCaster(Surface(self.height, self.resolution, self.origin))

    def contains(self, x: float, y: float) -> bool:
        """True inside the extent."""
        x0, y0, x1, y1 = self.extent
        return bool(x0 <= x <= x1 and y0 <= y <= y1)

    def z(self, x: float, y: float) -> float:
        """Terrain height [m] at x, y [m], bilinear; the edge value outside."""
        rows, cols = self.height.shape
        c = min(max((x - self.origin[0]) / self.resolution, 0.0), cols - 1.0)
        r = min(max((y - self.origin[1]) / self.resolution, 0.0), rows - 1.0)
        i, j = min(int(r), rows - 2), min(int(c), cols - 2)
        v, u = r - i, c - j
        h = self.height
        return float(
            (1 - v) * ((1 - u) * h[i, j] + u * h[i, j + 1])
            + v * ((1 - u) * h[i + 1, j] + u * h[i + 1, j + 1])
        )
