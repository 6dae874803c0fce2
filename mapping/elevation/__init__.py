"""The elevation map: fused from scans, cleared by rays, read as a grid, exchanged in patches, saved and restored."""

from mapping.elevation.exchange import MapError, MapMirror, MapPatch
from mapping.elevation.map import ElevationMap, FuseReport
from mapping.elevation.params import ElevationParams

__all__ = ["ElevationMap", "ElevationParams", "FuseReport", "MapError", "MapMirror", "MapPatch"]
