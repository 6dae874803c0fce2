"""LiDAR-inertial odometry around KISS-ICP."""

from mapping.odometry.pipeline import LidarInertialOdometry
from mapping.odometry.types import FastPose, OdometryParams, ScanOdometry

__all__ = ["FastPose", "LidarInertialOdometry", "OdometryParams", "ScanOdometry"]
