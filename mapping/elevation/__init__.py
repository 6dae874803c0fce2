"""The elevation map: fused from scans, cleared by rays, read as a grid, exchanged in patches, saved and restored."""

from mapping.elevation.config import ElevationConfig
from mapping.elevation.exchange import FuseReport, MapError, MapPatch
from mapping.elevation.map import ElevationMap
from mapping.elevation.mirror import MapMirror

__all__ = ["ElevationConfig", "ElevationMap", "FuseReport", "MapError", "MapMirror", "MapPatch"]
