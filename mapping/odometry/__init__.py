"""LiDAR-inertial odometry around KISS-ICP."""

from mapping.odometry.pipeline import LidarInertialOdometry
from mapping.odometry.types import FastPose, OdometryConfig, ScanOdometry

__all__ = ["FastPose", "LidarInertialOdometry", "OdometryConfig", "ScanOdometry"]
