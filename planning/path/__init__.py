"""From a route over the graph to a path the robot can follow."""

from planning.path.path import Path, PathLimits, face_in_the_way, make_path, still_safe

__all__ = ["Path", "PathLimits", "face_in_the_way", "make_path", "still_safe"]
