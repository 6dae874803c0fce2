"""LiDAR models and the ray casters behind them."""

from hal.lidar.caster import CasterError, OrientedBox, TerrainCaster
from hal.lidar.config import LidarConfig, only
from hal.lidar.simulator import GO2W_BODY, LidarSimulator
from hal.lidar.spec import LIDARS, LidarSpec

__all__ = [
    "GO2W_BODY",
    "LIDARS",
    "CasterError",
    "LidarConfig",
    "LidarSimulator",
    "LidarSpec",
    "OrientedBox",
    "TerrainCaster",
    "only",
]
