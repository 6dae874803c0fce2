"""From a path and the robot's pose to a velocity command."""

from planning.tracking.path import PathError, TrackPath
from planning.tracking.tracker import PathTracker
from planning.tracking.types import TrackerConfig, TrackOutput, TrackPhase

__all__ = ["PathError", "PathTracker", "TrackOutput", "TrackPath", "TrackPhase", "TrackerConfig"]
