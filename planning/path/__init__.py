"""From a route over the graph to a path the robot can follow."""

from planning.path.confirmed import ahead_of, backs_up, confirmed, creeping, drivable, is_hidden
from planning.path.path import make_path, rest_of
from planning.path.spline import smooth_route
from planning.path.types import Path, PathLimits
from planning.path.watch import face_in_the_way, in_fields, new_field, still_safe

__all__ = [
    "Path",
    "PathLimits",
    "ahead_of",
    "backs_up",
    "confirmed",
    "creeping",
    "drivable",
    "face_in_the_way",
    "in_fields",
    "is_hidden",
    "make_path",
    "new_field",
    "rest_of",
    "smooth_route",
    "still_safe",
]
