"""Does a path still hold on a newer map?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.grid import ElevationGrid
from planning.graph.fields import ENTERED_WAY
from planning.graph.flags import FIELD
from planning.graph.graph import TraversalGraph
from planning.path.confirmed import at_places
from planning.path.types import Path
from planning.risk.body import BodyModel, terrain_of
from planning.risk.steps import steps_under
from planning.risk.terrain import Terrain

Array = NDArray[np.float64]
STRIP_SIDE = 0.5
"""[m] beside the corners of a route that its path, its corridor and what lies under the body's rim stay within."""
FACE_TOLERANCE = 0.02
"""[m] by which a new face must exceed the robot's limit."""
GROWTH_NOISE = 0.04
"""[m] by which a face must have grown: four standard deviations of its change, when each height is known to 5 mm."""


def still_safe(path: Path, graph: TraversalGraph, grid: ElevationGrid, body: BodyModel) -> tuple[bool, str]:
    """Whether a path made on an earlier map still holds on this one, and if not, what is in the way.

    It does not hold when `face_in_the_way` finds one, or when the graph lost the ground around a corner of the route.
    """
    face = face_in_the_way(path, grid, body)
    if face:
        return False, face
    for x, y in path.route.tolist():
        if graph.nearest_node((x, y)) is None:
            return False, f"no drivable ground left around ({x:.2f}, {y:.2f})"
    return True, ""


def face_in_the_way(path: Path, grid: ElevationGrid, body: BodyModel) -> str:
    """The face under the body that is most too high, on that part of the path which lies on `grid`; empty without one.

    Too high is a face above the robot's limit and above what was under the body at the same place when the path was
    made. A path that passes close to a wall has high faces there, and may have them there only.
    """
    x0, y0, x1, y1 = grid.extent
    at = path.watched[:, :2]
    inside = ((at >= (x0, y0)) & (at <= (x1, y1))).all(axis=1)
    poses = path.watched[inside]
    if not len(poses):
        return ""
    step = steps_under(terrain_around(grid, poses[:, :2], body), poses, body.length, body.width)
    excess = step - np.maximum(path.limits.max_step + FACE_TOLERANCE, path.faces[inside] + GROWTH_NOISE)
    bad = int(np.argmax(excess))
    if excess[bad] <= 0.0:
        return ""
    return f"a {step[bad]:.2f} m face at ({poses[bad, 0]:.2f}, {poses[bad, 1]:.2f})"


def terrain_around(grid: ElevationGrid, xy: Array, body: BodyModel) -> Terrain:
    """Terrain that a body on a path near the points (n, 2) can touch: the cost of a path must not grow with the map."""
    return terrain_of(grid.around(xy, body.circumradius + STRIP_SIDE), body)


def in_fields(path: Path, graph: TraversalGraph) -> NDArray[np.bool_]:
    """(k,) where the poses that are watched lie in a stepfield with high posts."""
    cells = graph.cells
    if cells is None:
        return np.zeros(len(path.watched), np.bool_)
    x, y = path.watched[:, 0], path.watched[:, 1]
    return at_places(cells.flags & FIELD > 0, x, y, cells.origin, cells.res)


def new_field(path: Path, graph: TraversalGraph, before: NDArray[np.bool_]) -> str:
    """The stepfield ahead that was not known when the path was made; empty without one, or for a robot that is in a
    field already: it does not turn there.

    before: (k,) or more, `in_fields` of then; its last k belong to the poses that are still watched.
    """
    now = in_fields(path, graph)
    if not len(now) or now[0]:
        return ""
    new = now & ~before[-len(now) :]
    step = np.hypot(*np.diff(path.watched[:, :2], axis=0, append=path.watched[-1:, :2]).T)
    if float(step[new].sum()) < ENTERED_WAY:
        return ""
    x, y, _ = path.watched[int(np.argmax(new))]
    return f"a stepfield begins at ({x:.2f}, {y:.2f})"
